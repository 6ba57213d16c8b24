"""The picture of `render()`: both views, the observed landmarks, a caption and a map."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from filters import rotations
from filters.interface import StereoObservation
from filters.validation import FloatArray
from stereo_slam_env.recording import Pose
from stereo_slam_env.rendering.images import Image, StereoImages

_INK, _PAPER = (28, 32, 38), (245, 246, 248)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_NEAR_DISPARITY, _FAR_DISPARITY = 60.0, 4.0
_SUBPIXEL = 4
"""Fractional bits of the coordinates that OpenCV draws at."""


def annotated_pair(
    pair: StereoImages, observation: StereoObservation, caption: Sequence[str], path: FloatArray, pose: Pose
) -> Image:
    """Both views with the landmarks drawn in, under a caption.

    Parameters
    ----------
    pair : StereoImages
        The views.
    observation : StereoObservation
        What the sensor measured; warm colours are near, cold ones far.
    caption : sequence of str
        Short texts for the bar at the top.
    path : (K, 3)
        Nominal positions in W, m, for the map.
    pose : Pose
        Where the camera is on it.

    Returns
    -------
    (H', W', 3) uint8
        Wide images one above the other, others side by side.
    """
    height, width = pair.left.shape[:2]
    uvd = observation.uvd
    v_right = uvd[:, 1] if observation.v_right is None else observation.v_right
    right_pixels = np.stack([uvd[:, 0] - uvd[:, 2], v_right], axis=1)
    left = _with_landmarks(pair.left, uvd[:, :2], uvd[:, 2])
    right = _with_landmarks(pair.right, right_pixels, uvd[:, 2])
    for image, name in ((left, "left"), (right, "right")):
        _label(image, name)
    stacked = width > 2 * height
    _inset_map(right, path, pose)
    gap = np.full((3, width, 3) if stacked else (height, 3, 3), _PAPER, dtype=np.uint8)
    views = np.concatenate([left, gap, right], axis=0 if stacked else 1)
    return np.concatenate([_caption_bar(views.shape[1], caption), views])


def _scale(width: int) -> float:
    return float(np.clip(width / 1344, 0.5, 1.0))


def _with_landmarks(image: Image, pixels: FloatArray, disparities: FloatArray) -> Image:
    drawn = image.copy()
    radius = max(3.0, 6.0 * _scale(image.shape[1]))
    fixed = 1 << _SUBPIXEL
    centers = np.rint(pixels * fixed).astype(int)
    colors = _colors(disparities)
    order = np.argsort(disparities)  # near ones on top
    for i in order:
        center = (int(centers[i, 0]), int(centers[i, 1]))
        color = tuple(int(c) for c in colors[i])
        cv2.circle(drawn, center, int(radius * fixed), _INK, 4, cv2.LINE_AA, _SUBPIXEL)
        cv2.circle(drawn, center, int(radius * fixed), color, 2, cv2.LINE_AA, _SUBPIXEL)
        cv2.circle(drawn, center, int(1.0 * fixed), color, -1, cv2.LINE_AA, _SUBPIXEL)
    return drawn


def _colors(disparities: FloatArray) -> NDArray[np.uint8]:
    """From blue (far) to red (near), even in the logarithm of the disparity; (M,) px -> (M, 3) RGB."""
    bounds = np.log([_FAR_DISPARITY, _NEAR_DISPARITY])
    level = (np.log(np.maximum(disparities, 1e-3)) - bounds[0]) / (bounds[1] - bounds[0])
    grey = np.rint(255 * (0.08 + 0.84 * np.clip(level, 0.0, 1.0))).astype(np.uint8).reshape(-1, 1)
    if len(grey) == 0:
        return np.zeros((0, 3), dtype=np.uint8)
    mapped = cv2.applyColorMap(grey, cv2.COLORMAP_TURBO)
    return np.ascontiguousarray(np.asarray(mapped).reshape(-1, 3)[:, ::-1])


def _label(image: Image, text: str) -> None:
    scale = max(0.75, _scale(image.shape[1]))
    (w, h), _ = cv2.getTextSize(text, _FONT, 0.55 * scale, 1)
    pad = int(7 * scale)
    _shade(image, slice(0, h + 2 * pad), slice(0, w + 2 * pad))
    cv2.putText(image, text, (pad, h + pad), _FONT, 0.55 * scale, _PAPER, 1, cv2.LINE_AA)


def _shade(image: Image, rows: slice, columns: slice) -> None:
    patch = image[rows, columns].astype(np.float32)
    image[rows, columns] = (0.35 * patch + 0.65 * np.array(_INK)).astype(np.uint8)


def _caption_bar(width: int, caption: Sequence[str]) -> Image:
    scale = _scale(width)
    bar = np.full((int(40 * scale), width, 3), _INK, dtype=np.uint8)
    baseline, x = int(26 * scale), int(12 * scale)
    for text in caption:
        cv2.putText(bar, text, (x, baseline), _FONT, 0.6 * scale, _PAPER, 1, cv2.LINE_AA)
        x += cv2.getTextSize(text, _FONT, 0.6 * scale, 1)[0][0] + int(28 * scale)
    _color_key(bar, scale, left_edge=x)
    return bar


def _color_key(bar: Image, scale: float, left_edge: int) -> None:
    """The colours of the disparities, at the right end of the bar, if there is room."""
    length, thick = int(150 * scale), int(12 * scale)
    words = [(f"{_FAR_DISPARITY:.0f}", True), (f"{_NEAR_DISPARITY:.0f} px disparity", False)]
    sizes = [cv2.getTextSize(text, _FONT, 0.5 * scale, 1)[0] for text, _ in words]
    space = int(8 * scale)
    x = bar.shape[1] - sizes[1][0] - 2 * space - length
    if x - sizes[0][0] - space < left_edge:
        return
    y = (bar.shape[0] - thick) // 2
    ramp = np.exp(np.linspace(np.log(_FAR_DISPARITY), np.log(_NEAR_DISPARITY), length))
    bar[y : y + thick, x : x + length] = _colors(ramp)
    baseline = int(25 * scale)
    cv2.putText(bar, words[0][0], (x - sizes[0][0] - space, baseline), _FONT, 0.5 * scale, _PAPER, 1, cv2.LINE_AA)
    cv2.putText(bar, words[1][0], (x + length + space, baseline), _FONT, 0.5 * scale, _PAPER, 1, cv2.LINE_AA)


def _inset_map(image: Image, path: FloatArray, pose: Pose) -> None:
    """The route from above (forward is up), with the camera on it, in the lower right corner."""
    size = int(min(130, 0.34 * image.shape[0]))
    pad = max(4, size // 10)
    rows, columns = slice(-size - pad, -pad), slice(-size - pad, -pad)
    _shade(image, rows, columns)
    window = image[rows, columns]
    plan = path[:, [0, 2]] * [1.0, -1.0]
    low, high = plan.min(axis=0), plan.max(axis=0)
    zoom = (size - 2 * pad) / max(float((high - low).max()), 1.0)

    def pixel(points: FloatArray) -> NDArray[np.int32]:
        offset = (points - 0.5 * (low + high)) * zoom + 0.5 * size
        fixed: NDArray[np.int32] = np.rint(offset * (1 << _SUBPIXEL)).astype(np.int32)
        return fixed

    cv2.polylines(window, [pixel(plan).reshape(-1, 1, 2)], False, (170, 178, 188), 2, cv2.LINE_AA, _SUBPIXEL)
    forward = rotations.matrix(pose.orientation)[:, 2]
    at = pose.position[[0, 2]] * [1.0, -1.0]
    nose = forward[[0, 2]] * [1.0, -1.0]
    side = np.array([-nose[1], nose[0]])
    length = 0.075 * size / zoom
    arrow = np.stack([at + length * nose, at - 0.7 * length * nose + 0.7 * length * side,
                      at - 0.7 * length * nose - 0.7 * length * side])  # fmt: skip
    cv2.fillConvexPoly(window, pixel(arrow), (255, 196, 60), cv2.LINE_AA, _SUBPIXEL)
