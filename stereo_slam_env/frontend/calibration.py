"""Offset of all disparities that a rectification leaves, estimated from the motion of the camera.

A yaw of a quarter of a milliradian between the cameras, far below what a calibration promises, shifts every disparity
by 0.2 px: 1 % of the depth, and so of the distance driven, at 20 px. A moving camera shows it: between two pairs,
points come nearer by what the step says, the same for all, while a wrong offset brings near and far ones nearer by
different amounts.
"""

from __future__ import annotations

import dataclasses
import logging
from itertools import islice

import numpy as np

from filters import StereoCamera
from stereo_slam_env.frontend.ego_motion import Pairs, Step, most_likely_step, robust_step
from stereo_slam_env.frontend.row_offsets import FEWEST, RowOffsets, require_rectified, row_offsets, turns_of_rows
from stereo_slam_env.frontend.settings import TrackerSettings, settings_for
from stereo_slam_env.frontend.tracker import StereoTracker
from stereo_slam_env.frontend.tracks import MEMORY
from stereo_slam_env.recording.recording import GreyImage, ImageSequence

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
    found, sigma = turns_of_rows(rows, camera)
    yaw, by_motion = float(found[1]), -shift / camera.fx
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
        found = robust_step(self._camera, self._shifted(pairs, self.value), step)
        if found is None:
            return
        fitting = pairs.select(found.inliers)
        # Minus twice the log-likelihood of the pairs, with the step that suits them best, for three offsets.
        misfits = []
        for offset in (self.value - _PROBE, self.value, self.value + _PROBE):
            estimate = most_likely_step(self._camera, self._shifted(fitting, offset), found.step)
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
