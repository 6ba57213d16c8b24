"""New corners, spread over the image."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from filters.validation import BoolArray, FloatArray, IntArray, finite_array
from stereo_slam_env.frontend.patches import Image

_BLOCK = 5
"""Side of the window that a corner is judged by, px of the half-size image: 10 px, about a patch."""
_REFINE = 4
"""Half the side of the window of the sub-pixel position, px."""
_MOVES = 3.0
"""A corner that refinement moves further than this was none; it stays where it was found, px."""
_TERMINATION = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 10, 0.01)


def detect_corners(
    image: Image,
    wanted: int,
    occupied: ArrayLike,
    *,
    cell: int = 48,
    margin: int = 12,
    min_distance: float = 12.0,
    mask: BoolArray | None = None,
    min_gradient: float = 1.5,
) -> FloatArray:
    """Shi-Tomasi corners where there are few landmarks yet.

    The image is divided into cells. Of the corners, those come first that fill the emptiest cells (landmarks already
    there and better corners of the same cell count), of these the strongest. Corners are looked for at half the size
    (a window of the size of a patch, a quarter of the time) and placed at full size.

    Parameters
    ----------
    image : (H, W) uint8
        Grey image.
    wanted : int
        At most this many.
    occupied : (K, 2) array_like
        Landmarks that are there already, (u, v) px; none is returned within `min_distance` of them.
    cell : int
        Side of a cell, px.
    margin : int
        Distance kept from the border of the image, px.
    min_distance : float
        Between any two, px.
    mask : (H, W) bool, optional
        Where corners may be.
    min_gradient : float
        Root mean square of the gradient along its weakest direction, grey levels / px. With s grey levels of noise, a
        patch is located to about sqrt(2) s / (11 min_gradient) px.

    Returns
    -------
    (M, 2) ndarray
        (u, v), px, M <= wanted, best first; the same for the same arguments.
    """
    taken = finite_array("occupied", np.zeros((0, 2)) if np.size(occupied) == 0 else occupied, ("K", 2))
    height, width = image.shape
    if wanted <= 0 or min(height, width) <= 2 * max(margin, _REFINE + 2):
        return np.zeros((0, 2))
    min_distance = min(min_distance, float(np.hypot(height, width)))
    strength = _strength(image)
    strength[~_free(strength.shape, image.shape, taken, max(margin, _REFINE + 2), min_distance, mask)] = 0.0
    side = max(3, 2 * int(np.ceil(0.5 * min_distance)) - 1)
    highest = np.asarray(cv2.dilate(strength, np.ones((side, side), dtype=np.uint8)))
    peaks = np.flatnonzero((strength == highest) & (strength > min_gradient**2))
    v, u = np.unravel_index(peaks, strength.shape)
    found, value = np.stack([2.0 * u, 2.0 * v], axis=1), strength[v, u]
    order = _emptiest_first(found, value, taken, cell, width, height)[: wanted + wanted // 4]
    corners = _refined(image, found[order])
    return corners[_apart(corners, taken, min_distance)][:wanted]


def _strength(image: Image) -> NDArray[np.float32]:
    """Smaller eigenvalue of the mean gradient matrix, (grey levels / px of the full image)^2, at half the size."""
    strength = np.asarray(cv2.cornerMinEigenVal(cv2.pyrDown(image), _BLOCK), dtype=np.float32)
    # cornerMinEigenVal has gradients of 2 / 255 grey levels per pixel, and a pixel here is two of the image.
    strength *= np.float32((255.0 / 2.0 / 2.0) ** 2)
    return strength


def _free(
    half: tuple[int, ...],
    full: tuple[int, ...],
    taken: FloatArray,
    margin: int,
    min_distance: float,
    mask: BoolArray | None,
) -> BoolArray:
    """Pixels of the half-size image at which a corner may be."""
    used = np.zeros(half, dtype=np.uint8)
    at = np.rint(0.5 * taken).astype(np.int64)
    at = at[((at >= 0) & (at < (half[1], half[0]))).all(axis=1)]
    used[at[:, 1], at[:, 0]] = 1
    radius = max(1, int(np.ceil(0.5 * min_distance)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    free: BoolArray = np.asarray(cv2.dilate(used, disc)) == 0
    edge = margin // 2 + 1
    free[:edge] = free[:, :edge] = False
    free[(full[0] - margin) // 2 :] = free[:, (full[1] - margin) // 2 :] = False
    if mask is not None:
        free &= np.asarray(mask, dtype=bool)[::2, ::2]
    return free


def _emptiest_first(
    found: FloatArray, value: NDArray[np.float32], taken: FloatArray, cell: int, width: int, height: int
) -> IntArray:
    """Order of the corners: by how many are in the cell before them, then by strength."""
    columns, rows = -(-width // cell), -(-height // cell)

    def cell_of(points: FloatArray) -> IntArray:
        at = np.clip(points // cell, 0, (columns - 1, rows - 1)).astype(np.int64)
        number: IntArray = at[:, 1] * columns + at[:, 0]
        return number

    own, others = cell_of(found), np.bincount(cell_of(taken), minlength=columns * rows)
    by_cell = np.lexsort((-value, own))
    starts = np.searchsorted(own[by_cell], own[by_cell])
    rank = np.empty(len(found), dtype=np.int64)
    rank[by_cell] = np.arange(len(found)) - starts
    order: IntArray = np.lexsort((-value, rank + others[own]))
    return order


def _refined(image: Image, found: FloatArray) -> FloatArray:
    """Positions between the pixels."""
    if len(found) == 0:
        return found
    start = found.astype(np.float32).reshape(-1, 1, 2)
    moved = cv2.cornerSubPix(image, start.copy(), (_REFINE, _REFINE), (-1, -1), _TERMINATION)
    moved = np.asarray(moved, dtype=np.float64).reshape(-1, 2)
    return np.where(np.abs(moved - found).max(axis=1, keepdims=True) <= _MOVES, moved, found)


def _apart(corners: FloatArray, taken: FloatArray, min_distance: float) -> BoolArray:
    """Those that are near neither a landmark nor a better corner."""
    points = np.concatenate([taken, corners])
    squared = sum((corners[:, axis, None] - points[:, axis]) ** 2 for axis in (0, 1))
    before = np.arange(len(points)) < len(taken) + np.arange(len(corners))[:, None]
    apart: BoolArray = ~((squared < min_distance**2) & before).any(axis=1)
    return apart
