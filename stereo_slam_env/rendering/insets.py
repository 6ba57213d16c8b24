"""Small maps in the corner of a picture: the whole drive, and where a head that turns looks."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from filters import rotations
from filters.camera import StereoCamera
from filters.validation import FloatArray
from stereo_slam_env.recording.recording import Pose
from stereo_slam_env.rendering.drawing import PAPER, SUBPIXEL, Color, disparity_colors, fixed_point, shade
from stereo_slam_env.rendering.images import Image

_ROUTE: Color = (170, 178, 188)
_CAR: Color = (255, 196, 60)
_VIEW: Color = (120, 200, 255)
_RING: Color = (104, 112, 122)
_REACH = 40.0
"""From the car to the rim of the view around it, m; what is farther is drawn on the rim."""
_FAINT = 0.35


def inset_map(image: Image, path: FloatArray, pose: Pose, pan: float = 0.0) -> None:
    """The route from above (forward is up), with the car on it, in the lower right corner.

    Parameters
    ----------
    image : (H, W, 3) uint8
        Is drawn on.
    path : (K, 3)
        The route in W, m.
    pose : Pose
        Of the camera.
    pan : float
        How far the camera is turned from the car, positive to the right, rad.
    """
    window = _window(image)
    size = len(window)
    plan = path[:, [0, 2]] * [1.0, -1.0]
    low, high = plan.min(axis=0), plan.max(axis=0)
    zoom = (size - 2 * _pad(size)) / max(float((high - low).max()), 1.0)

    def pixel(points: FloatArray) -> NDArray[np.int32]:
        offset = (points - 0.5 * (low + high)) * zoom + 0.5 * size
        return fixed_point(offset)

    _line(window, pixel(plan))
    nose = _heading(pose, pan) * [1.0, -1.0]
    _arrow(window, pixel(_triangle(pose.position[[0, 2]] * [1.0, -1.0], nose, 0.075 * size / zoom)))


def inset_gaze(
    image: Image, path: FloatArray, pose: Pose, camera: StereoCamera, uvd: FloatArray, pan: float = 0.0
) -> None:
    """What is around the car from above (its direction is up) and which part the camera sees; lower right corner.

    Parameters
    ----------
    image : (H, W, 3) uint8
        Is drawn on.
    path : (K, 3)
        The route in W, m.
    pose : Pose
        Of the camera.
    camera : StereoCamera
        Its field of view, and how far the landmarks are.
    uvd : (M, 3)
        The landmarks seen now, px.
    pan : float
        How far the camera is turned from the car, positive to the right, rad.
    """
    window = _window(image)
    size = len(window)
    zoom = (0.5 * size - 3.0) / _REACH
    ahead = _heading(pose, pan)
    axes = np.stack([np.array([ahead[1], -ahead[0]]), -ahead])  # to the right and backwards: as the picture's axes

    def pixel(points: FloatArray) -> NDArray[np.int32]:
        """Of points (N, 2) relative to the car, to the right and backwards, m."""
        offset = points * zoom + 0.5 * size - 0.5
        return fixed_point(offset)

    near = path[np.linalg.norm(path - pose.position, axis=1) < 1.4 * _REACH]
    _line(window, pixel((near - pose.position)[:, [0, 2]] @ axes.T))
    middle = pixel(np.zeros(2))
    cv2.circle(window, _pair(middle), int(_REACH * zoom * (1 << SUBPIXEL)), _RING, 1, cv2.LINE_AA, SUBPIXEL)
    edges = pan + np.arctan((np.array([0.0, camera.width - 1.0]) - camera.cx) / camera.fx)
    bearings = np.linspace(edges[0], edges[1], 24)
    wedge = np.concatenate([np.zeros((1, 2)), _REACH * np.column_stack([np.sin(bearings), -np.cos(bearings)])])
    faint = window.copy()
    cv2.fillConvexPoly(faint, pixel(wedge), _VIEW, cv2.LINE_AA, SUBPIXEL)
    window[:] = np.rint((1.0 - _FAINT) * window + _FAINT * faint).astype(np.uint8)
    cv2.polylines(window, [pixel(wedge).reshape(-1, 1, 2)], True, _VIEW, 1, cv2.LINE_AA, SUBPIXEL)

    uvd = uvd[uvd[:, 2] > 0.0]
    seen = camera.backproject(uvd) @ rotations.matrix(pose.orientation).T
    plan = seen[:, [0, 2]] @ axes.T
    away = np.linalg.norm(plan, axis=1, keepdims=True)
    dots = pixel(plan * np.minimum(1.0, _REACH / np.maximum(away, 1e-9)))
    radius = int(max(1.2, 0.016 * size) * (1 << SUBPIXEL))
    for dot, color in zip(dots, disparity_colors(uvd[:, 2]), strict=True):
        cv2.circle(window, _pair(dot), radius, tuple(int(c) for c in color), -1, cv2.LINE_AA, SUBPIXEL)
    _arrow(window, pixel(_triangle(np.zeros(2), np.array([0.0, -1.0]), 0.075 * size / zoom)))
    cv2.putText(window, f"{_REACH:.0f} m", (3, size - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.003 * size, PAPER, 1, cv2.LINE_AA)


def _window(image: Image) -> Image:
    """A darkened square in the lower right corner."""
    size = int(min(130, 0.34 * image.shape[0]))
    rows = columns = slice(-size - _pad(size), -_pad(size))
    shade(image, rows, columns)
    return image[rows, columns]


def _pad(size: int) -> int:
    return max(4, size // 10)


def _heading(pose: Pose, pan: float) -> FloatArray:
    """Direction (x, z) in W of the car that carries a camera turned by `pan`."""
    forward = rotations.matrix(pose.orientation)[:, 2]
    yaw = np.arctan2(forward[0], forward[2]) - pan
    return np.array([np.sin(yaw), np.cos(yaw)])


def _triangle(at: FloatArray, nose: FloatArray, length: float) -> FloatArray:
    side = np.array([-nose[1], nose[0]])
    return np.stack([at + length * nose, at - 0.7 * length * nose + 0.7 * length * side,
                     at - 0.7 * length * nose - 0.7 * length * side])  # fmt: skip


def _line(window: Image, pixels: NDArray[np.int32]) -> None:
    cv2.polylines(window, [pixels.reshape(-1, 1, 2)], False, _ROUTE, 2, cv2.LINE_AA, SUBPIXEL)


def _arrow(window: Image, pixels: NDArray[np.int32]) -> None:
    cv2.fillConvexPoly(window, pixels, _CAR, cv2.LINE_AA, SUBPIXEL)


def _pair(pixel: NDArray[np.int32]) -> tuple[int, int]:
    return int(pixel[0]), int(pixel[1])
