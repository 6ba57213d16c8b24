"""The picture of `render()` and of tracked features: both views, landmarks, labels, captions and maps."""

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
from stereo_slam_env.rendering.pinhole import Image, StereoImages

Color = tuple[int, int, int]

INK: Color = (28, 32, 38)
PAPER: Color = (245, 246, 248)
FONT = cv2.FONT_HERSHEY_SIMPLEX
SUBPIXEL = 4
"""Fractional bits of the coordinates that OpenCV draws at."""
_NEAR_DISPARITY, _FAR_DISPARITY = 60.0, 4.0


def line_scale(width: int) -> float:
    """Size of text and marks for a picture that is `width` px wide, 1 at full size."""
    return float(np.clip(width / 1344, 0.5, 1.0))


def fixed_point(pixels: FloatArray) -> NDArray[np.int32]:
    """Pixel coordinates as OpenCV takes them together with `shift=SUBPIXEL`."""
    fixed: NDArray[np.int32] = np.rint(np.asarray(pixels) * (1 << SUBPIXEL)).astype(np.int32)
    return fixed


def both_views(left: Image, right: Image) -> Image:
    """Wide images one above the other, others side by side."""
    height, width = left.shape[:2]
    stacked = width > 2 * height
    gap = np.full((3, width, 3) if stacked else (height, 3, 3), PAPER, dtype=np.uint8)
    return np.concatenate([left, gap, right], axis=0 if stacked else 1)


def even_sides(picture: Image) -> Image:
    """The picture with its last row or column repeated where it is odd: video codecs need even ones."""
    height, width = picture.shape[:2]
    return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def disparity_colors(disparities: FloatArray) -> NDArray[np.uint8]:
    """Colours from blue (far) to red (near), even in the logarithm of the disparity; (M,) px -> (M, 3) RGB."""
    bounds = np.log([_FAR_DISPARITY, _NEAR_DISPARITY])
    level = (np.log(np.maximum(disparities, 1e-3)) - bounds[0]) / (bounds[1] - bounds[0])
    grey = np.rint(255 * (0.08 + 0.84 * np.clip(level, 0.0, 1.0))).astype(np.uint8).reshape(-1, 1)
    if len(grey) == 0:
        return np.zeros((0, 3), dtype=np.uint8)
    mapped = cv2.applyColorMap(grey, cv2.COLORMAP_TURBO)
    return np.ascontiguousarray(np.asarray(mapped).reshape(-1, 3)[:, ::-1])


def label(image: Image, text: str) -> None:
    """Write a name into the upper left corner."""
    scale = max(0.75, line_scale(image.shape[1]))
    (w, h), _ = cv2.getTextSize(text, FONT, 0.55 * scale, 1)
    pad = int(7 * scale)
    shade(image, slice(0, h + 2 * pad), slice(0, w + 2 * pad))
    cv2.putText(image, text, (pad, h + pad), FONT, 0.55 * scale, PAPER, 1, cv2.LINE_AA)


def shade(image: Image, rows: slice, columns: slice) -> None:
    """Darken a part, for text to be read on."""
    patch = image[rows, columns].astype(np.float32)
    image[rows, columns] = (0.35 * patch + 0.65 * np.array(INK)).astype(np.uint8)


def caption_bar(width: int, caption: Sequence[str]) -> Image:
    """Short texts in a row, and what the colours of disparities mean, if there is room."""
    scale = line_scale(width)
    bar = np.full((int(40 * scale), width, 3), INK, dtype=np.uint8)
    baseline, x = int(26 * scale), int(12 * scale)
    for text in caption:
        cv2.putText(bar, text, (x, baseline), FONT, 0.6 * scale, PAPER, 1, cv2.LINE_AA)
        x += cv2.getTextSize(text, FONT, 0.6 * scale, 1)[0][0] + int(28 * scale)
    _color_key(bar, scale, left_edge=x)
    return bar


def _color_key(bar: Image, scale: float, left_edge: int) -> None:
    """The colours of the disparities, at the right end of the bar, if there is room."""
    length, thick = int(150 * scale), int(12 * scale)
    far, near = f"{_FAR_DISPARITY:.0f}", f"{_NEAR_DISPARITY:.0f} px disparity"
    far_width, near_width = (cv2.getTextSize(text, FONT, 0.5 * scale, 1)[0][0] for text in (far, near))
    space = int(8 * scale)
    x = bar.shape[1] - near_width - 2 * space - length
    if x - far_width - space < left_edge:
        return
    y = (bar.shape[0] - thick) // 2
    ramp = np.exp(np.linspace(np.log(_FAR_DISPARITY), np.log(_NEAR_DISPARITY), length))
    bar[y : y + thick, x : x + length] = disparity_colors(ramp)
    for text, at in ((far, x - far_width - space), (near, x + length + space)):
        cv2.putText(bar, text, (at, int(25 * scale)), FONT, 0.5 * scale, PAPER, 1, cv2.LINE_AA)


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
        """Pixels of points (N, 2) relative to the car, to the right and backwards, m."""
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
    points_c = camera.backproject(uvd) @ rotations.matrix(pose.orientation).T
    plan = points_c[:, [0, 2]] @ axes.T
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


Colour = tuple[int, int, int]
RADIUS = 6
"""Radius of a ring, px."""


def tracks_picture(
    images: Sequence[NDArray[np.uint8]] | NDArray[np.uint8],
    ways: Sequence[FloatArray],
    colours: Sequence[Colour],
    words: Sequence[str],
) -> bytes:
    """Draw rings at features and lines along their ways, one image above the other, as a PNG file.

    Parameters
    ----------
    images : sequence of (H, W) uint8
        Grey images.
    ways : sequence of (K, M, 2)
        For each image the pixels of M features in K frames, of which the last is that of the image.
    colours : sequence of M (r, g, b)
        One for each feature.
    words : sequence of str
        Caption of each image.
    """
    lines = []
    for image, way, caption in zip(images, ways, words, strict=True):
        view = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        for places, (r, g, b) in zip(way.transpose(1, 0, 2), colours, strict=True):
            pixels = np.ascontiguousarray(np.rint(places), dtype=np.int32)
            cv2.polylines(view, [pixels], False, (b, g, r), 1, cv2.LINE_AA)
            cv2.circle(view, (int(pixels[-1, 0]), int(pixels[-1, 1])), RADIUS, (b, g, r), 2, cv2.LINE_AA)
        cv2.rectangle(view, (0, 0), (440, 40), (0, 0, 0), cv2.FILLED)
        cv2.putText(view, caption, (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 1, cv2.LINE_AA)
        lines.append(view)
    done, encoded = cv2.imencode(".png", np.concatenate(lines))
    if not done:
        raise RuntimeError("OpenCV cannot write PNG files")
    return bytes(encoded.tobytes())
