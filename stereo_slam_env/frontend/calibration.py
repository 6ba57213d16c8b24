"""The residual of the rectification along the rows: all disparities of a real rig are wrong by the same little.

A yaw of a quarter of a milliradian between the eyes, far below what a calibration promises, shifts every disparity by
0.2 px: 1 % of the depth, and so of the distance driven, at 20 px. A moving camera sees it: between two pairs, points
come nearer by what the step says, the same for all, while a wrong offset brings near and far ones nearer by
different amounts.
"""

from __future__ import annotations

import dataclasses
import logging
from itertools import islice

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from filters.camera import StereoCamera
from filters.validation import FloatArray
from stereo_slam_env.frontend.ego_motion import robust_step
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracker import StereoTracker
from stereo_slam_env.frontend.tracks import MEMORY
from stereo_slam_env.image_sequence import ImageSequence
from stereo_slam_env.stereo_step import Pairs, Step, transfer

PRIOR_SIGMA = 0.25
"""What a careful calibration leaves, px."""
CALIBRATION_PAIRS = 60
"""Pairs of a sequence that are looked at."""
_NOT_NOISE = 9.0
"""Squared ratio of the value to its standard deviation below which nothing is corrected."""

_log = logging.getLogger(__name__)


def calibrated(
    sequence: ImageSequence, settings: TrackerSettings | None = None, pairs: int = CALIBRATION_PAIRS
) -> TrackerSettings:
    """The settings with the disparity offset that the first `pairs` pairs of a recording show.

    Parameters
    ----------
    sequence : ImageSequence
        The recording.
    settings : TrackerSettings, optional
        Of the front end.
    pairs : int
        How many to look at.

    Returns
    -------
    TrackerSettings
    """
    settings = TrackerSettings() if settings is None else settings
    tracker = StereoTracker(sequence.camera, settings)
    offset = DisparityOffset(sequence.camera)
    before = 0.0
    for number, pair in enumerate(islice(sequence.pairs(), pairs)):
        tracker.track(pair.left, pair.right, pair.timestamp - before if number else None)
        before = pair.timestamp
        if number % (MEMORY - 1) == 0 and (far_apart := tracker.longest_pairs()) is not None:
            offset.learn(*far_apart)
    _log.info("%s: disparity offset %.3f +- %.3f px", sequence.name, offset.value, offset.sigma)
    return dataclasses.replace(settings, disparity_offset=settings.disparity_offset + offset.correction)


class DisparityOffset:
    """A recursive estimate of what must be added to measured disparities.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    """

    def __init__(self, camera: StereoCamera) -> None:
        self._camera = camera
        self.value = 0.0
        """px."""
        self._information = PRIOR_SIGMA**-2

    @property
    def correction(self) -> float:
        """What to add to disparities: the part of `value` that noise alone would not bring about, px.

        The less the value stands out of its own uncertainty, the more it is drawn to 0: a perfect rig is left alone.
        """
        significance = self.value**2 * self._information
        return self.value * max(0.0, 1.0 - _NOT_NOISE / max(significance, _NOT_NOISE))

    @property
    def sigma(self) -> float:
        """Standard deviation of the estimate, px."""
        return float(self._information**-0.5)

    def learn(self, pairs: Pairs, step: Step) -> None:
        """Learn from a step and the pairs that agree with it.

        Parameters
        ----------
        pairs : Pairs
            Measurements as they came; none may come twice.
        step : Step
            About the motion between them.
        """
        shift = np.array([0.0, 0.0, self.value])
        pairs = dataclasses.replace(pairs, first=pairs.first + shift, second=pairs.second + shift)
        found = robust_step(self._camera, pairs, step)
        if found is None:
            return
        pairs, step = pairs.select(found.inliers), found.step
        predicted = transfer(self._camera, pairs.first, step)
        A = predicted.by_first
        S = pairs.R_second + A @ pairs.R_first @ A.transpose(0, 2, 1)
        nu = pairs.second - predicted.uvd
        # Adding x to all disparities moves the measurement by x e_d and the prediction by A e_d x.
        by_offset = A[:, :, 2] - np.array([0.0, 0.0, 1.0])
        H = np.concatenate([predicted.by_step, by_offset[:, :, None]], axis=2)
        weighted = np.linalg.solve(S, H)
        normal: FloatArray = np.einsum("mij,mik->jk", H, weighted)
        normal[6, 6] += self._information
        try:
            factor = cho_factor(normal)
        except LinAlgError:
            return
        self.value += float(cho_solve(factor, np.einsum("mij,mi->j", weighted, nu))[6])
        self._information = float(1.0 / cho_solve(factor, np.eye(7)[6])[6])
