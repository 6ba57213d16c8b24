"""`check_filter` passes every filter of ours, and finds what is wrong with a bad one."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pytest

from filters import (
    ConformanceError,
    ConstantVelocity,
    Forecast,
    InverseDepthStereoEKF,
    StereoEKF,
    StereoFilter,
    StereoObservation,
    UpdateReport,
    available_filters,
    check_filter,
)
from filters.catalogue.presets import UNLISTED
from filters.checks.conformance import CHECKS, REFERENCE_CAMERA, REFERENCE_NOISE

from ..delayed import DelayedEKF

NAMES = ("inverse-depth", "dual-bearing", "euclidean", "shared-anchor", "hybrid", "right-invariant", "unscented")


@pytest.mark.parametrize("name", [*NAMES, "monocular", "msckf", "submaps"])
def test_every_named_filter_conforms(name: str) -> None:
    report = check_filter(name)
    assert (report.filter_name, len(report.passed)) == (name, len(CHECKS))
    assert name in (UNLISTED if name in ("shared-anchor", "hybrid") else available_filters())


LANDMARKS, MEASUREMENTS = ("inverse-depth", "shared-anchor", "euclidean", "hybrid"), ("sequential", "stacked", "left")


@pytest.mark.parametrize(
    "make",
    [
        *(
            partial(StereoEKF, landmark=landmark, measurement=sensor)
            for landmark, sensor in product(LANDMARKS, MEASUREMENTS)
        ),
        partial(InverseDepthStereoEKF, error="so3"),
        partial(InverseDepthStereoEKF, error="first-estimates"),
        partial(StereoEKF, error="right-invariant", landmark="euclidean"),
        partial(InverseDepthStereoEKF, error="right-invariant", iterations=2),
        partial(InverseDepthStereoEKF, consensus=True, measurement="sequential", tail_dof=4.0),
        partial(InverseDepthStereoEKF, drop_unseen=False),
        partial(InverseDepthStereoEKF, gate=None, iterations=3),
        partial(InverseDepthStereoEKF, min_disparity=5.0, motion=ConstantVelocity(1.0, 0.1)),
        *(partial(StereoEKF, landmark=landmark, update="unscented") for landmark in LANDMARKS),
        DelayedEKF,
        partial(DelayedEKF, until_tracks_end=True),
        lambda: InverseDepthStereoEKF(REFERENCE_CAMERA, REFERENCE_NOISE),
    ],
)
def test_other_options_and_factories_conform(make: Any) -> None:
    check_filter(make)


def test_a_filter_is_made_as_a_benchmark_makes_it() -> None:
    """With the common options that it leaves open, and without those that it has chosen."""
    heard: list[dict[str, Any]] = []

    class MovesItsOwnWay(InverseDepthStereoEKF):
        def __init__(self, camera: Any, noise: Any, **options: Any) -> None:
            heard.append(options)
            super().__init__(camera, noise, motion=ConstantVelocity(2.0, 0.4), **options)

    check_filter(MovesItsOwnWay)
    assert heard[-1] == {"gate": 0.99}


def test_a_filter_that_refuses_what_a_benchmark_gives_it_is_caught() -> None:
    class Ungated(InverseDepthStereoEKF):
        def __init__(self, camera: Any, noise: Any, *, gate: float | None = None) -> None:
            if gate is not None:
                raise ValueError("gate must be None: this filter has no gate")
            super().__init__(camera, noise, gate=gate)

    with pytest.raises(ConformanceError, match="this filter has no gate"):
        check_filter(Ungated)


class _AcceptsAnyTimeStep(InverseDepthStereoEKF):
    def predict(self, dt: float, odometry: Any = None) -> None:
        super().predict(abs(dt) + 0.1 if np.isfinite(dt) else 0.1, odometry)


class _MovesBeforeItRefuses(InverseDepthStereoEKF):
    def predict(self, dt: float, odometry: Any = None) -> None:
        super().predict(0.1)
        super().predict(dt, odometry)


class _DependsOnTheOrder(InverseDepthStereoEKF):
    def update(self, observation: StereoObservation) -> UpdateReport:
        return super().update(observation.select(np.arange(len(observation))[: len(observation) - 1]))


class _Overconfident(InverseDepthStereoEKF):
    def predict(self, dt: float, odometry: Any = None) -> None:
        super().predict(dt, odometry)
        state = self.state
        state.P *= 0.5
        self.state = state


class _Asymmetric(InverseDepthStereoEKF):
    def forecast(self, ids: Any = None) -> Forecast:
        forecast = super().forecast(ids)
        forecast.S[:, 0, 1] += 0.1
        return forecast


class _Random(InverseDepthStereoEKF):
    def update(self, observation: StereoObservation) -> UpdateReport:
        report = super().update(observation)
        state = self.state
        state.blocks = state.blocks + 1e-9 * np.random.default_rng().standard_normal(state.blocks.shape)
        self.state = state
        return report


class _HandsOutItsState(InverseDepthStereoEKF):
    @property
    def pose(self) -> Any:
        pose = super().pose
        object.__setattr__(pose, "position", self.engine.storage.x[0, :3])
        return pose


class _MixesUpItsLandmarks(InverseDepthStereoEKF):
    def joint_covariance(self, ids: Any = None) -> Any:
        return super().joint_covariance(np.roll(self.landmarks.ids, 1))


class _NeverSeesTwice(InverseDepthStereoEKF):
    """Each landmark is new in each frame, so that no measurement ever corrects the pose."""

    def update(self, observation: StereoObservation) -> UpdateReport:
        if isinstance(observation, StereoObservation):
            self.forget(self.landmarks.ids)
        return super().update(observation)


class _Doubting(StereoFilter):
    """Twenty times the standard deviation for each measurement: ten times the position error, all else in order."""

    def update(self, observation: StereoObservation) -> UpdateReport:
        if isinstance(observation, StereoObservation):
            R = 400.0 * observation.covariances(self.noise)
            observation = StereoObservation(observation.ids, observation.uvd, R=R)
        return super().update(observation)


class _TrustsItsMotionTooMuch(_Doubting, InverseDepthStereoEKF):
    pass


class _DelayedAndWorse(_Doubting, DelayedEKF):
    pass


class _DelaysAndForgetsToSay(DelayedEKF):
    def update(self, observation: StereoObservation) -> UpdateReport:
        report = super().update(observation)
        updated, initialised = (ids[ids != 7] for ids in (report.updated, report.initialised))
        return replace(report, updated=updated, initialised=initialised)


class _DelaysAndSaysTwice(DelayedEKF):
    _last = UpdateReport()

    def update(self, observation: StereoObservation) -> UpdateReport:
        self._last, before = super().update(observation), self._last
        return self._last if len(observation) else before


@pytest.mark.parametrize("worse", [_TrustsItsMotionTooMuch, _NeverSeesTwice, _DelayedAndWorse])
def test_errors_ten_times_those_of_inverse_depth_are_the_only_complaint(worse: type[StereoFilter]) -> None:
    """But for a covariance too large of those that make too little of each measurement."""
    report = check_filter(worse, raise_on_failure=False)
    errors, *others = report.failed
    factor = float(re.search(r"position errors are ([0-9.]+) times those of inverse-depth", errors)[1])
    assert factor > 8.0
    assert all("underconfident" in line for line in others)
    assert bool(others) == (worse is not _DelayedAndWorse)


@pytest.mark.parametrize(
    ("broken", "complaint"),
    [
        (_AcceptsAnyTimeStep, r"predict\(0\) raised nothing"),
        (_MovesBeforeItRefuses, "changed the state"),
        (_DependsOnTheOrder, "in another order: position differs by 0.0042"),
        (_Overconfident, r"overconfident \(mean pose NEES / dof .*, expected 1\)"),
        (_Asymmetric, "forecast S is not symmetric"),
        (_MixesUpItsLandmarks, "the joint covariance of landmark 0 differs"),
        (_Random, "two filters differ"),
        (_HandsOutItsState, "the filter's state changed"),
        (_DelaysAndForgetsToSay, "ids \\[7\\] were observed and are in no report 20 frames later"),
        (_DelaysAndSaysTwice, "are reported more often than they were observed"),
    ],
)
def test_a_broken_filter_is_caught(broken: type[StereoFilter], complaint: str) -> None:
    with pytest.raises(ConformanceError, match=complaint):
        check_filter(broken)


def test_all_failures_are_listed_at_once() -> None:
    class Hopeless(InverseDepthStereoEKF):
        def forecast(self, ids: Any = None) -> Any:
            raise NotImplementedError("no forecast")

        def forget(self, ids: Any) -> None:
            pass

    report = check_filter(Hopeless, raise_on_failure=False)
    assert len(report.failed) >= 3
    assert "no forecast" in str(report)
    assert "forgotten ids are still in the map" in str(report)
