"""Drawing on stereo pictures: colours of disparities, labels, captions, two views in one."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from filters.geometry.arrays import FloatArray
from stereo_slam_env.rendering.images import Image

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
    """From blue (far) to red (near), even in the logarithm of the disparity; (M,) px -> (M, 3) RGB."""
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
