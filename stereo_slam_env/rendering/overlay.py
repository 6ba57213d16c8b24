"""The picture of `render()`: both views, the observed landmarks, a caption and maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from filters.contract.inputs import StereoObservation
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from stereo_slam_env.rendering.drawing import (
    INK,
    PAPER,
    SUBPIXEL,
    Color,
    both_views,
    caption_bar,
    disparity_colors,
    even_sides,
    fixed_point,
    label,
    line_scale,
    shade,
)
from stereo_slam_env.rendering.images import Image, StereoImages

_ROUTE: Color = (170, 178, 188)
_CAR: Color = (255, 196, 60)
_VIEW: Color = (120, 200, 255)
_RING: Color = (104, 112, 122)
_REACH = 40.0
"""From the car to the rim of the view around it, m; what is farther is drawn on the rim."""
_FAINT = 0.35


def inset_map(image: Image, path: FloatArray, pose: Pose, pan: float = 0.0) -> None:
    """Draw the route (K, 3) from above (forward is up), with the car on it, into the lower right corner.

    `pan` is how far the camera at `pose` is turned from the car, positive to the right, rad.
    """
    window = _window(image)
    size = len(window)
    plan = path[:, [0, 2]] * [1.0, -1.0]
    low, high = plan.min(axis=0), plan.max(axis=0)
    zoom = (size - 2 * _pad(size)) / max(float((high - low).max()), 1.0)

    def pixel(points: FloatArray) -> NDArray[np.int32]:
        offset = (points - 0.5 * (low + high)) * zoom + 0.5 * size
        return fixed_point(offset)

    _draw_line(window, pixel(plan))
    _draw_car(
        window, pixel, pose.position[[0, 2]] * [1.0, -1.0], _heading(pose, pan) * [1.0, -1.0], 0.075 * size / zoom
    )


def inset_gaze(
    image: Image, path: FloatArray, pose: Pose, camera: StereoCamera, uvd: FloatArray, pan: float = 0.0
) -> None:
    """Draw the surroundings of the car from above (its direction is up), the field of view and the landmarks `uvd`.

    Into the lower right corner; `path` and `pan` as for `inset_map`.
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
    _draw_line(window, pixel((near - pose.position)[:, [0, 2]] @ axes.T))
    cv2.circle(
        window, pixel(np.zeros(2)).tolist(), int(_REACH * zoom * (1 << SUBPIXEL)), _RING, 1, cv2.LINE_AA, SUBPIXEL
    )
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
    for dot, color in zip(dots.tolist(), disparity_colors(uvd[:, 2]).tolist(), strict=True):
        cv2.circle(window, dot, radius, color, -1, cv2.LINE_AA, SUBPIXEL)
    _draw_car(window, pixel, np.zeros(2), np.array([0.0, -1.0]), 0.075 * size / zoom)
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


def _draw_line(window: Image, pixels: NDArray[np.int32]) -> None:
    cv2.polylines(window, [pixels.reshape(-1, 1, 2)], False, _ROUTE, 2, cv2.LINE_AA, SUBPIXEL)


def _draw_car(
    window: Image, pixel: Callable[[FloatArray], NDArray[np.int32]], at: FloatArray, nose: FloatArray, length: float
) -> None:
    """A triangle of so many metres."""
    side = np.array([-nose[1], nose[0]])
    corners = np.stack(
        [at + length * nose, *(at - 0.7 * length * nose + sign * 0.7 * length * side for sign in (1, -1))]
    )
    cv2.fillConvexPoly(window, pixel(corners), _CAR, cv2.LINE_AA, SUBPIXEL)


def annotated_pair(
    pair: StereoImages,
    observation: StereoObservation,
    caption: Sequence[str],
    path: FloatArray,
    pose: Pose,
    *,
    camera: StereoCamera | None = None,
    pan: float = 0.0,
) -> Image:
    """Both views with the landmarks drawn in, under a caption; RGB of even sides, wide views one above the other.

    Warm colours are near, cold ones far. The maps show the nominal `path` (K, 3) in W, m, and the `pose` of the left
    camera; with a `camera`, also where it looks, `pan` rad to the right of the direction of the car.
    """
    uvd = observation.uvd
    v_right = uvd[:, 1] if observation.v_right is None else observation.v_right
    right_pixels = np.stack([uvd[:, 0] - uvd[:, 2], v_right], axis=1)
    left = _with_landmarks(pair.left, uvd[:, :2], uvd[:, 2])
    right = _with_landmarks(pair.right, right_pixels, uvd[:, 2])
    for image, name in ((left, "left"), (right, "right")):
        label(image, name)
    inset_map(right, path, pose, pan)
    if camera is not None:
        inset_gaze(left, path, pose, camera, uvd, pan)
    views = both_views(left, right)
    return even_sides(np.concatenate([caption_bar(views.shape[1], caption), views]))


def _with_landmarks(image: Image, pixels: FloatArray, disparities: FloatArray) -> Image:
    drawn = image.copy()
    radius = max(3.0, 6.0 * line_scale(image.shape[1]))
    centers, colors = fixed_point(pixels).tolist(), disparity_colors(disparities).tolist()
    for i in np.argsort(disparities):  # near ones on top
        for reach, color, thickness in ((radius, INK, 4), (radius, colors[i], 2), (1.0, colors[i], -1)):
            cv2.circle(drawn, centers[i], int(reach * (1 << SUBPIXEL)), color, thickness, cv2.LINE_AA, SUBPIXEL)
    return drawn
