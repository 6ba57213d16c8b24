"""Picture of features that were tracked, on the images they were tracked in."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from filters.geometry.arrays import FloatArray

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
    shown = []
    for image, way, caption in zip(images, ways, words, strict=True):
        view = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        for places, (r, g, b) in zip(way.transpose(1, 0, 2), colours, strict=True):
            pixels = np.ascontiguousarray(np.rint(places), dtype=np.int32)
            cv2.polylines(view, [pixels], False, (b, g, r), 1, cv2.LINE_AA)
            cv2.circle(view, (int(pixels[-1, 0]), int(pixels[-1, 1])), RADIUS, (b, g, r), 2, cv2.LINE_AA)
        cv2.rectangle(view, (0, 0), (440, 40), (0, 0, 0), cv2.FILLED)
        cv2.putText(view, caption, (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 1, cv2.LINE_AA)
        shown.append(view)
    done, encoded = cv2.imencode(".png", np.concatenate(shown))
    if not done:
        raise RuntimeError("OpenCV cannot write PNG files")
    return bytes(encoded.tobytes())
