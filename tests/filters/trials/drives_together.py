"""Drives of different sizes, run together and one by one, and what must be equal in every frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from filters import BodyVelocity, StereoEKF, StereoEKFTrials, StereoObservation, UpdateReport
from filters.trials.observations import TrialReports

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, START_COVARIANCE, drive

EQUAL = 1e-9
Observations = list[list[StereoObservation]]  # [trial][frame]


def drives(trials: int, frames: int, *, visible: int = 6, seed: int = 0, **options: Any) -> Observations:
    """One more landmark in view in every trial than in the one before; some are missed now and then."""
    made = [drive(seed + b, frames, visible=visible + b, **options) for b in range(trials)]
    return [[frame.observation for frame in one] for one in made]


def starts(trials: int) -> list[dict[str, Any]]:
    """Arguments of `reset`, different for each trial."""
    rng = np.random.default_rng(7)
    return [
        {
            "position": rng.normal(0.0, 0.1, 3),
            "linear_velocity": rng.normal((0.0, 0.0, SPEED), 0.3),
            "covariance": START_COVARIANCE * rng.uniform(1.0, 2.0),
        }
        for _ in range(trials)
    ]


def noisy_odometry(trials: int, frames: int, seed: int = 3) -> list[list[BodyVelocity | None]]:
    """Some steps of some trials have none."""
    rng = np.random.default_rng(seed)
    covariance = np.diag(np.repeat([0.1, 0.01], 3) ** 2)

    def of_a_step() -> BodyVelocity | None:
        linear, angular = rng.normal((0.0, 0.0, SPEED), 0.1), rng.normal(0.0, 0.01, 3)
        return BodyVelocity(linear, angular, covariance) if rng.uniform() < 0.7 else None

    return [[of_a_step() for _ in range(frames)] for _ in range(trials)]


def ekf(**options: Any) -> StereoEKF:
    """The filter under test."""
    return StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)


class Race:
    """The same trials together and one by one; `step` asserts that they are equal."""

    def __init__(self, trials: int, **options: Any) -> None:
        self.together = StereoEKFTrials(ekf(**options), trials)
        self.together.reset(starts(trials))
        self.alone = [ekf(**options) for _ in range(trials)]
        for slam, start in zip(self.alone, starts(trials), strict=True):
            slam.reset(**start)
        self.events = dict.fromkeys((field.name for field in fields(UpdateReport)), 0)

    def predict(self, odometry: Sequence[BodyVelocity | None] | None = None) -> None:
        """One step of the motion."""
        self.together.predict(DT, odometry)
        for b, slam in enumerate(self.alone):
            slam.predict(DT, None if odometry is None else odometry[b])
        self.assert_equal_beliefs()

    def update(self, observations: Sequence[StereoObservation]) -> TrialReports:
        """One frame."""
        reports = self.together.update(observations)
        for b, slam in enumerate(self.alone):
            self.assert_equal_reports(reports[b], slam.update(observations[b]))
        self.assert_equal_beliefs()
        return reports

    def run(self, trials: Observations, odometry: list[list[BodyVelocity | None]] | None = None) -> None:
        """All frames; the maps are compared now and then."""
        for k, observations in enumerate(zip(*trials, strict=True)):
            if k:
                self.predict(None if odometry is None else [own[k] for own in odometry])
            self.update(observations)
            if k % 15 == 0:
                self.assert_equal_maps()
        self.assert_equal_maps()

    def assert_equal_reports(self, ours: UpdateReport, theirs: UpdateReport) -> None:
        theirs = replace(theirs, dropped=np.sort(theirs.dropped))
        for name in self.events:
            got, wanted = getattr(ours, name), getattr(theirs, name)
            np.testing.assert_allclose(got, wanted, rtol=EQUAL, atol=EQUAL, err_msg=name)
            self.events[name] += np.size(wanted)

    def assert_equal_beliefs(self) -> None:
        for ours, of_each in (
            (self.together.pose, [slam.pose for slam in self.alone]),
            (self.together.velocity, [slam.velocity for slam in self.alone]),
        ):
            for name, got in vars(ours).items():
                wanted = [getattr(belief, name) for belief in of_each]
                np.testing.assert_allclose(got, wanted, rtol=EQUAL, atol=EQUAL, err_msg=name)

    def assert_equal_maps(self) -> None:
        for b, slam in enumerate(self.alone):
            ours, theirs = self.together.trial(b).landmarks, slam.landmarks
            for name, wanted in vars(theirs).items():
                # A point far away has a position of a thousand metres, and one of no use beyond infinity.
                np.testing.assert_allclose(getattr(ours, name), wanted, rtol=1e-7, atol=EQUAL, err_msg=name)
