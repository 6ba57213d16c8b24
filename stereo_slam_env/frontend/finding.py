"""Finding landmarks in a stereo pair: expected ones and new corners."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from filters import StereoCamera
from filters.contract.noise import gate_limit
from filters.contract.validation import finite_array
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.matching import match_rows, search
from stereo_slam_env.frontend.patches import Image, local_affine, parallax, warped_patches
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import Expectation, Outcome, Tracks, rows_from
from stereo_slam_env.recording.recording import GreyImage

_CELL = 48
"""Side of a cell, px."""
_MIN_GRADIENT = 1.5
"""Least root mean square of the gradient of a corner along its weakest direction, grey levels / px. With s grey levels
of noise, a patch is located to about sqrt(2) s / (11 * 1.5) px."""
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
    margin: int = 12,
    min_distance: float = 12.0,
) -> FloatArray:
    """Up to `wanted` Shi-Tomasi corners (M, 2) (u, v) px where there are few landmarks yet, best first.

    The image is divided into cells. Of the corners, those come first that fill the emptiest cells (landmarks already
    there and better corners of the same cell count), of these the strongest. Corners are looked for at half the size
    (a window of the size of a patch, a quarter of the time) and placed at full size. They keep `min_distance` px from
    each other and from the landmarks `occupied` (K, 2), and `margin` px from the border.
    """
    taken = finite_array("occupied", np.zeros((0, 2)) if np.size(occupied) == 0 else occupied, ("K", 2))
    height, width = image.shape
    if wanted <= 0 or min(height, width) <= 2 * max(margin, _REFINE + 2):
        return np.zeros((0, 2))
    min_distance = min(min_distance, float(np.hypot(height, width)))
    strength = _strength(image)
    strength[~_free(strength.shape, image.shape, taken, max(margin, _REFINE + 2), min_distance)] = 0.0
    side = max(3, 2 * int(np.ceil(0.5 * min_distance)) - 1)
    highest = np.asarray(cv2.dilate(strength, np.ones((side, side), dtype=np.uint8)))
    peaks = np.flatnonzero((strength == highest) & (strength > _MIN_GRADIENT**2))
    v, u = np.unravel_index(peaks, strength.shape)
    found, value = np.stack([2.0 * u, 2.0 * v], axis=1), strength[v, u]
    order = _emptiest_first(found, value, taken, width, height)[: wanted + wanted // 4]
    corners = _refined(image, found[order])
    return corners[_apart(corners, taken, min_distance)][:wanted]


def _strength(image: Image) -> NDArray[np.float32]:
    """Smaller eigenvalue of the mean gradient matrix, (grey levels / px of the full image)^2, at half the size."""
    strength = np.asarray(cv2.cornerMinEigenVal(cv2.pyrDown(image), _BLOCK), dtype=np.float32)
    # cornerMinEigenVal has gradients of 2 / 255 grey levels per pixel, and a pixel here is two of the image.
    strength *= np.float32((255.0 / 2.0 / 2.0) ** 2)
    return strength


def _free(
    half: tuple[int, ...], full: tuple[int, ...], taken: FloatArray, margin: int, min_distance: float
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
    return free


def _emptiest_first(
    found: FloatArray, value: NDArray[np.float32], taken: FloatArray, width: int, height: int
) -> IntArray:
    """Order of the corners: by how many are in the cell before them, then by strength."""
    columns, rows = -(-width // _CELL), -(-height // _CELL)

    def cell_of(points: FloatArray) -> IntArray:
        at = np.clip(points // _CELL, 0, (columns - 1, rows - 1)).astype(np.int64)
        number: IntArray = at[:, 1] * columns + at[:, 0]
        return number

    own_cells, taken_counts = cell_of(found), np.bincount(cell_of(taken), minlength=columns * rows)
    by_cell = np.lexsort((-value, own_cells))
    starts = np.searchsorted(own_cells[by_cell], own_cells[by_cell])
    rank = np.empty(len(found), dtype=np.int64)
    rank[by_cell] = np.arange(len(found)) - starts
    order: IntArray = np.lexsort((-value, rank + taken_counts[own_cells]))
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
    """Corners that are near neither a landmark nor a better corner."""
    points = np.concatenate([taken, corners])
    squared = sum((corners[:, axis, None] - points[:, axis]) ** 2 for axis in (0, 1))
    before = np.arange(len(points)) < len(taken) + np.arange(len(corners))[:, None]
    apart: BoolArray = ~((squared < min_distance**2) & before).any(axis=1)
    return apart


_ROW_SLACK = 1.0
"""Added to the range of disparities that is searched, px."""
_UNDERSTATED = 1.8
"""The errors of a correlation are so much larger than its covariance says, whose noise is white: measured where neither
noise nor relief matters, on rendered streets (`stereo-slam scenes noise`), in u, v and d, from 0.03 to 0.3 px alike."""


@dataclass(frozen=True, eq=False)
class Found:
    """Results of a search for N landmarks: uvd (N, 3) px (NaN: nothing), R (N, 3, 3) px^2, an `Outcome` each (N,)."""

    uvd: FloatArray
    R: FloatArray
    outcome: IntArray

    @property
    def matched(self) -> BoolArray:
        """Found in both images; (N,)."""
        return np.asarray(self.outcome == Outcome.MATCHED)

    def merged(self, other: Found, rows: BoolArray) -> Found:
        """This one, with `rows` (N,) from the other."""
        return Found(*rows_from(other, self, rows, "uvd", "R", "outcome"))


@dataclass(frozen=True, eq=False)
class PairFinder:
    """Search for landmarks in one pair."""

    camera: StereoCamera
    settings: TrackerSettings
    left: GreyImage
    right: GreyImage

    def find(
        self, tracks: Tracks, expected: Expectation, R_vn: FloatArray, position_v: FloatArray, which: BoolArray
    ) -> Found:
        """Look for the tracks `which` (N,) from the expected camera pose R_vn, position_v in the front end's world."""
        count, settings = len(tracks), self.settings
        uvd, R = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
        outcome = np.full(count, int(Outcome.OUT_OF_VIEW), dtype=np.int64)
        expected_rows = np.flatnonzero(expected.in_view & which)
        if len(expected_rows) == 0:
            return Found(uvd, R, outcome)
        sought = tracks.select(expected_rows)
        R_now_then = R_vn.T @ sought.first_R
        t_now_then = (sought.first_position - position_v) @ R_vn
        affine = local_affine(self.camera, sought.first_uvd, R_now_then, t_now_then)
        templates = warped_patches(sought.patches, affine, image_blur=settings.image_blur)
        result = search(
            self.left,
            templates,
            expected.uvd[expected_rows, :2],
            expected.S[expected_rows, :2, :2],
            gate=float(np.sqrt(gate_limit(settings.search_gate, 2))),
            max_radius=settings.max_radius,
        )
        good = (result.score >= settings.min_score) & (result.second <= settings.uniqueness * result.score)
        good &= ~result.on_border & self.inside(result.position)
        outcome[expected_rows] = np.where(good, Outcome.NO_DISPARITY, Outcome.NO_MATCH)
        hit = np.flatnonzero(good)
        at = expected_rows[hit]
        reach = _ROW_SLACK + np.sqrt(gate_limit(settings.search_gate, 1) * expected.S[at, 2, 2])
        disparity, variance, accepted = self.disparities(
            result.position[hit], expected.uvd[at, 2] - reach, expected.uvd[at, 2] + reach
        )
        hit, at = hit[accepted], at[accepted]
        uvd[at] = np.column_stack([result.position[hit], disparity[accepted]])
        moved = parallax(self.camera, sought.first_uvd[hit], R_now_then[hit], t_now_then[hit])
        R[at] = self._noise(result.covariance[hit], variance[accepted], moved, disparity[accepted])
        outcome[at] = Outcome.MATCHED
        return Found(uvd, R, outcome)

    def corners(self, wanted: int, occupied: FloatArray) -> tuple[FloatArray, FloatArray]:
        """New corners away from `occupied` (K, 2), with a disparity: (u, v, d) (M, 3) px and R (M, 3, 3) px^2."""
        settings = self.settings
        uv = detect_corners(self.left, wanted, occupied, margin=settings.margin, min_distance=settings.min_distance)
        low = np.full(len(uv), settings.min_disparity)
        high = np.full(len(uv), min(self.camera.disparity_constant / settings.nearest, self.camera.width))
        disparity, variance, accepted = self.disparities(uv, low, high, left_right_check=True)
        uvd = np.column_stack([uv, disparity])[accepted]
        count = len(uvd)
        exact, unmoved = np.zeros((count, 2, 2)), np.zeros((count, 2))  # the corner itself is the landmark
        return uvd, self._noise(exact, variance[accepted], unmoved, uvd[:, 2])

    def disparities(
        self, uv: FloatArray, low: FloatArray, high: FloatArray, *, left_right_check: bool = False
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Disparities of left pixels (M, 2) in low..high (M,), their variances, and which matches are accepted."""
        if len(uv) == 0:
            return np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool)
        offset = self.settings.disparity_offset
        rows = match_rows(
            self.left,
            self.right,
            uv,
            low - offset,
            high - offset,
            min_score=self.settings.min_score,
            ratio=self.settings.uniqueness,
            left_right_check=left_right_check,
        )
        return rows.disparity + offset, rows.variance, rows.accepted

    def inside(self, uv: FloatArray) -> BoolArray:
        """Mask of pixels (M, 2) that are off the edge of the left image by the margin."""
        margin = self.settings.margin
        high = [self.camera.width - 1 - margin, self.camera.height - 1 - margin]
        return np.asarray(((uv >= margin) & (uv <= high)).all(axis=1))

    def _noise(
        self, covariance_uv: FloatArray, variance_d: FloatArray, moved: FloatArray, disparity: FloatArray
    ) -> FloatArray:
        """R of each measurement, from that of the correlations and from what was `moved` (M, 2) px by parallax.

        What was found in the left image and the match along the row have independent noise. But both compare a patch
        that is taken for a plane; where it is off that plane by r, a match is displaced by the share r / z of all
        parallax: that since the landmark was first seen, and that between the cameras, the disparity.
        """
        floor = self.settings.sigma_floor**2
        R = np.zeros((len(disparity), 3, 3))
        R[:, :2, :2] = _UNDERSTATED**2 * covariance_uv + floor * np.eye(2)
        R[:, 2, 2] = _UNDERSTATED**2 * variance_d + floor
        share = self.settings.sigma_relief * disparity / self.camera.disparity_constant
        displaced = share[:, None] * np.column_stack([moved, disparity])
        return R + displaced[:, :, None] * displaced[:, None, :]
