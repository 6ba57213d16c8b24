"""Coloured-noise filter without a look ahead: it measures the noise of the tracks while the drive goes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from filters import ColouredNoise, Start, StereoCamera, StereoNoise, StereoObservation, UpdateReport
from filters.catalogue.presets import ColouredNoiseEKF
from filters.contract.noise import RIG_ERRORS
from filters.contract.stereo_filter import AT_ORIGIN
from filters.geometry import rotations
from filters.landmarks.lasting_errors import LastingErrors
from stereo_slam_env.frontend.ego_motion import Step
from stereo_slam_env.frontend.track_noise import LASTING_TIME, TrackStatistics, stated_noise

EVERY = 10
"""Frames after which the filter is told what the tracks say now."""
LEARNING, PERIOD, AT_FIRST = 13, 150, 50
"""Frames that it learns from, of so many each; it takes all until so many have had enough tracks to say something. That
keeps the cost low."""


class CausalNoiseEKF(ColouredNoiseEKF):
    """`ColouredNoiseEKF` that assumes no more than R at the start and measures how errors last as the drive goes.

    The motion between two frames, which residuals of the flow need, begins with that of its own estimates.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        Of which R is taken, and of a `ColouredNoise` what it says of the rig; one without gauge walk says that tracks
        have no errors in common, and one without errors that last, as that of measurements which bring a covariance of
        their own, that landmarks walk instead of keeping such errors in the state.
    **options
        As of `ColouredNoiseEKF`.
    """

    def __init__(self, camera: StereoCamera, noise: StereoNoise, **options: Any) -> None:
        self._R = StereoNoise(noise.R)
        self._stranger = not isinstance(noise, ColouredNoise) or noise.gauge_walk > 0.0
        self._tracks = TrackStatistics(camera)
        nothing_known = stated_noise(self._tracks.noise, self._R, brings_R=False, stranger=self._stranger)
        if isinstance(noise, ColouredNoise):
            nothing_known = dataclasses.replace(nothing_known, **{name: getattr(noise, name) for name in RIG_ERRORS})
            if noise.lasting_covariance is None:
                nothing_known = dataclasses.replace(nothing_known, lasting=None, lasting_time=None)
        super().__init__(camera, nothing_known, **options)

    def reset(self, start: Start = AT_ORIGIN) -> None:
        """Reset as `StereoEKF` does; nothing is known of the tracks."""
        super().reset(start)
        self._tracks = TrackStatistics(self.camera)
        self._last: tuple[StereoObservation, np.ndarray, np.ndarray] | None = None
        self._raised, self._frame = 1.0, 0

    def update(self, observation: StereoObservation) -> UpdateReport:
        """Update as `StereoEKF` does, then learn from the frame."""
        brings_R = isinstance(observation, StereoObservation) and observation.R is not None
        k = self._frame
        learns = self._tracks.frames < AT_FIRST or k % PERIOD < LEARNING
        if learns and k % EVERY == 0:
            measured = self._tracks.noise
            self._raised = measured.claimed_too_small
            noise = stated_noise(measured, self._R, brings_R, self._stranger)
            assumed: dict[str, Any] = {"drift": noise.drift, "gauge_walk": noise.gauge_walk}
            if isinstance(self.options.landmark, LastingErrors):  # the errors are assumed once, kept or as a walk
                lasting = noise.lasting_covariance
                lasting_part = np.zeros((3, 3)) if lasting is None else lasting
                assumed["landmark"] = LastingErrors(lasting_part, LASTING_TIME)
                assumed["drift"] = noise.drift if lasting is None else None
            self.assume(noise.white_part, **assumed)
        used = observation
        if brings_R and observation.R is not None and self._raised != 1.0:
            used = dataclasses.replace(observation, R=self._raised * observation.R)
        report = super().update(used)
        if learns:
            camera = self._row.camera
            position, R_wc = np.array(camera.position), rotations.matrix(camera.orientation)
            if self._last is not None:
                before, r, R = self._last
                self._tracks.add(before, observation, Step(R.T @ R_wc, R.T @ (position - r)), fits=False)
            self._last = observation, position, R_wc
        elif self._last is not None:
            self._tracks.pause()
            self._last = None
        self._frame = k + 1
        return report
