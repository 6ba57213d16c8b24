"""Errors of a rectification as images show them: rows of corners in both images, and an offset of all disparities.

A yaw of a quarter of a milliradian between the cameras, far below what a calibration promises, shifts every disparity
by 0.2 px: 1 % of the depth, and so of the distance driven, at 20 px. A moving camera shows it: between two pairs,
points come nearer by what the step says, the same for all, while a wrong offset brings near and far ones nearer by
different amounts.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from filters import StereoCamera
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.frontend.ego_motion import Pairs, Step, most_likely_step, robust_step
from stereo_slam_env.frontend.finding import detect_corners
from stereo_slam_env.frontend.matching import best_peaks, refine
from stereo_slam_env.frontend.patches import PATCH, cut_patches
from stereo_slam_env.frontend.settings import TrackerSettings, settings_for
from stereo_slam_env.frontend.tracker import StereoTracker
from stereo_slam_env.frontend.tracks import MEMORY
from stereo_slam_env.recording.recording import GreyImage, ImageSequence

_CORNERS = 60
"""Of a pair."""
_MARGIN = 12
"""Distance of corners to the edge, px."""
_ROWS = 0.1
"""Rows that are searched above and below, as a share of the height; a raw camera is off by less at most corners."""
_FEWEST_ROWS = 8
_COLUMNS = 0.25
"""Largest disparity that is searched, as a share of the width."""
_NEGATIVE = 0.1
"""Largest negative disparity that is searched, as a share of the width."""
_MIN_SCORE, _RIVAL = 0.85, 0.85
"""Least correlation of a match, and most that the second best peak has of it."""
_RETURNS_WITHIN = 1.0
"""How far a match back may end from where it began, px."""
FEWEST = 30
"""Fewer matches say nothing."""
_SIGNIFICANT = 5.0
_LEFT = np.array([0.33, 3e-3, 1e-3])
"""Standard deviations of what a careful calibration leaves: of the rows, px (as the matcher supposes), and yaw and roll
between the cameras as their rows show them, rad. The rows of KITTI 06 show 0.2 px, 9 mrad and 0.4 mrad."""
_SWAPPED, _TURNED = 0.5, 0.03
"""Shares of corners beyond infinity by which left and right are swapped, or the cameras are turned to each other: of
rendered and real pairs that are rectified there are none among 1,500."""
_FEWEST_BEYOND = 4
_SAME_IMAGE = 0.05
"""Nine of ten corners are no further apart, px, in one image that is given twice."""
_HUBER = 1.5
_STEPS = 10


@dataclass(frozen=True, eq=False)
class RowOffsets:
    """Corners of the left images that were found in the right ones."""

    uv: FloatArray
    """(N, 2): in the left image, px."""
    disparity: FloatArray
    """(N,): u_left - u_right, px."""
    offset: FloatArray
    """(N,): v_left - v_right, px."""
    corners: int
    """Number of corners that were looked for."""

    @property
    def spread(self) -> float:
        """Median distance of the rows, px; infinite without a match."""
        return float(np.median(np.abs(self.offset))) if len(self.offset) else np.inf

    @property
    def beyond_infinity(self) -> float:
        """Share of disparities below -1 px: none, but for a yaw between the cameras."""
        return float(np.mean(self.disparity < -1.0)) if len(self.disparity) else 0.0


def row_offsets(pairs: Sequence[tuple[GreyImage, GreyImage]]) -> RowOffsets:
    """Match corners of pairs (left, right) in both directions, without supposing that their rows agree."""
    offsets = [_of_pair(left, right) for left, right in pairs]
    uv, disparity, offset = (np.concatenate([one[i] for one in offsets]) for i in range(3)) if offsets else (_NONE,) * 3
    return RowOffsets(uv.reshape(-1, 2), disparity, offset, sum(one[3] for one in offsets))


def require_rectified(rows: RowOffsets, camera: StereoCamera, name: str) -> None:
    """Raise a `ValueError` that names the recording where rows or disparities are those of no rectified pair."""
    if len(rows.offset) < FEWEST:
        return
    remedy = (
        "calibrate the pair again, or give the calibration of these images as rig (--rig), which rectifies raw ones"
    )
    beyond, count = rows.beyond_infinity, int(np.count_nonzero(rows.disparity < -1.0))
    if beyond > _SWAPPED:
        raise ValueError(
            f"{name}: {100 * beyond:.0f} % of its disparities are negative: are left and right swapped, the images of "
            "both upside down, or the cameras turned to each other (yaw)?"
        )
    if np.quantile(np.hypot(rows.disparity, rows.offset), 0.9) < _SAME_IMAGE:
        raise ValueError(f"{name}: left and right images are the same: name the topic or folder of each camera")
    if count >= _FEWEST_BEYOND and beyond > _TURNED:
        raise ValueError(
            f"{name}: {count} of {len(rows.offset)} corners lie beyond infinity, with disparities down to "
            f"{rows.disparity.min():.1f} px, so the cameras are turned to each other (yaw), or the images raw: {remedy}"
        )
    turns, sigma = turns_of_rows(rows, camera)
    if (np.abs(turns) > _SIGNIFICANT * np.hypot(sigma, _LEFT)).any():
        words = ", ".join(
            f"{what} {scale * value:+.2f} ± {scale * error:.2f} {unit}"
            for what, scale, unit, value, error in zip(
                ("pitch", "yaw", "roll"), (1.0, 1e3, 1e3), ("px", "mrad", "mrad"), turns, sigma, strict=True
            )
        )
        raise ValueError(f"{name}: the rows of its images are those of no rectified pair ({words}): {remedy}")


def turns_of_rows(rows: RowOffsets, camera: StereoCamera) -> tuple[FloatArray, FloatArray]:
    """Pitch, px, yaw and roll, rad, of the right camera that explain the rows best, and their standard errors.

    A small turn moves the row of a point (x, y, 1) of the right camera by f (1 + y^2), f x y and f x.
    """
    x, y = (rows.uv[:, 0] - rows.disparity - camera.cx) / camera.fx, (rows.uv[:, 1] - camera.cy) / camera.fy
    A = np.column_stack([1.0 + y * y, camera.fy * x * y, camera.fy * x])
    weights, turns_found, sigma = np.ones(len(x)), np.zeros(3), 1.0
    for _ in range(_STEPS):
        root = np.sqrt(weights)
        turns_found = np.asarray(
            np.linalg.lstsq(A * root[:, None], rows.offset * root, rcond=None)[0], dtype=np.float64
        )
        errors = np.abs(rows.offset - A @ turns_found)
        sigma = 1.4826 * float(np.median(errors)) + 1e-9
        weights = np.minimum(1.0, _HUBER * sigma / np.maximum(errors, 1e-9)).astype(np.float64)
    information = (A * weights[:, None]).T @ A / sigma**2
    return turns_found, np.sqrt(np.diag(np.linalg.pinv(information)))


_NONE = np.zeros(0)


def _of_pair(left: GreyImage, right: GreyImage) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    height, width = left.shape
    uv = detect_corners(left, _CORNERS, np.zeros((0, 2)), margin=_MARGIN)
    rows = max(_FEWEST_ROWS, round(_ROWS * height))
    low, high = np.array([-_COLUMNS * width, -rows]), np.array([_NEGATIVE * width, rows])
    uv_right, good = _matched(left, right, uv, low, high)
    back, again = _matched(right, left, uv_right, -high, -low)
    good &= again & (np.abs(back - uv).max(axis=1, initial=0.0) <= _RETURNS_WITHIN)
    moved = uv[good] - uv_right[good]
    return uv[good], moved[:, 0], moved[:, 1], len(uv)


def _matched(
    one: GreyImage, other: GreyImage, uv: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Matches of the surroundings of `uv` (N, 2) in the other image, within a box, and whether they are sure."""
    if not len(uv):
        return uv, np.zeros(0, dtype=bool)
    templates, nearest = cut_patches(one, uv, PATCH), np.rint(uv)
    peaks = best_peaks(other, templates, np.rint(nearest + low), np.rint(nearest + high))
    has_peak = peaks.score > -1.0
    position, score = uv.copy(), np.full(len(uv), -1.0)
    refined = refine(other, templates[has_peak], peaks.pixel[has_peak], peaks.offset[has_peak])
    position[has_peak], score[has_peak] = refined.position, refined.score
    good = (score >= _MIN_SCORE) & (peaks.second < _RIVAL * peaks.score)
    return position, np.asarray(good)


PRIOR_SIGMA = 0.25
"""What a careful calibration leaves, px."""
CALIBRATION_PAIRS = 60
"""Pairs of a sequence that are looked at."""
_PROBE = 0.1
"""Step of the differences by which the likelihood is followed, px."""
_IMPOSSIBLE = 5.0
"""A value of more standard deviations, with what a careful calibration leaves, is a mistake and no remainder."""
_LEAST_YAW = 0.0035
"""rad: twice what the noise of tracks allows for (`track_noise.RIGHT_TURN`)."""
_LOOKED_AT = 8
"""Pairs whose rows are compared."""

_log = logging.getLogger(__name__)


def calibrated(
    sequence: ImageSequence, settings: TrackerSettings | None = None, pairs: int = CALIBRATION_PAIRS
) -> TrackerSettings:
    """The settings with the disparity offset that the first `pairs` pairs of a sequence show, and its sigma.

    Raises
    ------
    ValueError
        They are no rectified pair, see `require_rectified`, or the offset is larger than any calibration leaves.
    """
    settings = settings_for(sequence) if settings is None else settings
    tracker = StereoTracker(sequence.camera, settings)
    offset = DisparityOffset(sequence.camera)
    before, looked_at = 0.0, list[tuple[GreyImage, GreyImage]]()
    for number, pair in enumerate(islice(sequence.pairs(), pairs)):
        if number % max(1, min(len(sequence), pairs) // _LOOKED_AT) == 0 and len(looked_at) < _LOOKED_AT:
            looked_at.append((pair.left, pair.right))
        tracker.track(pair.left, pair.right, pair.timestamp - before if number else None)
        before = pair.timestamp
        if (far_apart := tracker.longest_pairs()) is not None:
            offset.learn(*far_apart, shared=MEMORY - 1)
    rows = row_offsets(looked_at)
    require_rectified(rows, sequence.camera, sequence.name)
    shift, doubt = offset.unbiased
    if abs(shift) > _IMPOSSIBLE * np.hypot(doubt, PRIOR_SIGMA) or _is_yaw(rows, sequence.camera, shift, doubt):
        raise ValueError(
            f"{sequence.name}: all disparities are off by {-shift:+.1f} ± {doubt:.1f} px, by the motion, a yaw of "
            f"{1e3 * abs(shift) / sequence.camera.fx:.1f} mrad between the cameras: calibrate the pair again"
        )
    _log.info("%s: disparity offset %.3f +- %.3f px", sequence.name, offset.value, offset.sigma)
    corrected = settings.disparity_offset + offset.value
    return dataclasses.replace(settings, disparity_offset=corrected, disparity_offset_sigma=offset.sigma)


def _is_yaw(rows: RowOffsets, camera: StereoCamera, shift: float, doubt: float) -> bool:
    """Whether rows and motion, which share no error, show one yaw between the cameras that no calibration leaves."""
    if len(rows.offset) < FEWEST or not abs(shift) > _IMPOSSIBLE * doubt:
        return False
    turns, sigma = turns_of_rows(rows, camera)
    yaw, by_motion = float(turns[1]), -shift / camera.fx
    return abs(yaw) > max(_LEAST_YAW, _IMPOSSIBLE * float(sigma[1])) and bool(0.25 < by_motion / yaw < 4.0)


class DisparityOffset:
    """Recursive estimate of what must be added to measured disparities."""

    def __init__(self, camera: StereoCamera) -> None:
        self._camera = camera
        self.value = 0.0
        """The estimate, px."""
        self._information = PRIOR_SIGMA**-2

    @property
    def sigma(self) -> float:
        """Standard deviation of the estimate, px."""
        return float(self._information**-0.5)

    @property
    def unbiased(self) -> tuple[float, float]:
        """The estimate and its standard deviation, px, by the images alone, without what is usual."""
        data = self._information - PRIOR_SIGMA**-2
        return (self.value * self._information / data, float(data**-0.5)) if data > 0.0 else (0.0, np.inf)

    def learn(self, pairs: Pairs, step: Step, *, shared: int = 1) -> None:
        """Learn from pairs as measured and the approximate step between them, one of `shared` overlapping ones."""
        step_found = robust_step(self._camera, self._shifted(pairs, self.value), step)
        if step_found is None:
            return
        fitting = pairs.select(step_found.inliers)
        # Minus twice the log-likelihood of the pairs, with the step that suits them best, for three offsets.
        misfits = []
        for offset in (self.value - _PROBE, self.value, self.value + _PROBE):
            estimate = most_likely_step(self._camera, self._shifted(fitting, offset), step_found.step)
            if estimate is None:
                return
            misfits.append(estimate.nis)
        below, here, above = misfits
        information = 0.5 * (above - 2.0 * here + below) / _PROBE**2 / shared
        if information <= 0.0:
            return
        self._information += information
        self.value -= 0.5 * (above - below) / (2.0 * _PROBE) / shared / self._information

    @staticmethod
    def _shifted(pairs: Pairs, offset: float) -> Pairs:
        shift = np.array([0.0, 0.0, offset])
        return dataclasses.replace(pairs, first=pairs.first + shift, second=pairs.second + shift)
