"""`check_filter` passes every filter of ours, and finds what is wrong with a bad one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from filters import (
    ConformanceError,
    ConstantVelocity,
    Forecast,
    InverseDepthStereoEKF,
    StereoEKF,
    StereoObservation,
    UpdateReport,
    available_filters,
    check_filter,
    make_filter,
)
from filters.conformance import CHECKS, REFERENCE_CAMERA, REFERENCE_NOISE


@pytest.mark.parametrize(
    "name",
    [
        "inverse-depth",
        "dual-bearing",
        "euclidean",
        "shared-anchor",
        "hybrid",
        "right-invariant",
        "unscented",
        "monocular",
    ],
)
def test_every_named_filter_conforms(name: str) -> None:
    report = check_filter(lambda camera, noise: make_filter(name, camera=camera, noise=noise))
    assert len(report.passed) == len(CHECKS)
    assert name in available_filters()


@pytest.mark.parametrize("landmark", ["inverse-depth", "shared-anchor", "euclidean", "hybrid"])
@pytest.mark.parametrize("measurement", ["joint", "sequential", "stacked", "left"])
def test_every_combination_of_parts_conforms(landmark: str, measurement: str) -> None:
    check_filter(lambda camera, noise: StereoEKF(camera, noise, landmark=landmark, measurement=measurement))


@pytest.mark.parametrize(
    "options",
    [
        {"error": "so3"},
        {"error": "first-estimates"},
        {"error": "right-invariant", "landmark": "euclidean"},
        {"error": "right-invariant", "iterations": 2},
        {"consensus": True},
        {"consensus": True, "measurement": "sequential", "tail_dof": 4.0},
        {"drop_unseen": False},
        {"iterations": 3},
        {"gate": None},
        {"min_disparity": 5.0},
        {"motion": ConstantVelocity(1.0, 0.1)},
    ],
)
def test_other_options_conform(options: dict[str, Any]) -> None:
    check_filter(lambda camera, noise: InverseDepthStereoEKF(camera, noise, **options))


def test_a_factory_without_arguments_is_accepted() -> None:
    report = check_filter(lambda: InverseDepthStereoEKF(REFERENCE_CAMERA, REFERENCE_NOISE))
    assert not report.failed


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
        self._state.P *= 0.5


class _Asymmetric(InverseDepthStereoEKF):
    def forecast(self, ids: Any = None) -> Forecast:
        forecast = super().forecast(ids)
        forecast.S[:, 0, 1] += 0.1
        return forecast


class _Random(InverseDepthStereoEKF):
    def update(self, observation: StereoObservation) -> UpdateReport:
        report = super().update(observation)
        self._state.blocks = self._state.blocks + 1e-9 * np.random.default_rng().standard_normal(
            self._state.blocks.shape
        )
        return report


class _HandsOutItsState(InverseDepthStereoEKF):
    @property
    def pose(self) -> Any:
        pose = super().pose
        object.__setattr__(pose, "position", self._state.camera.position)
        return pose


class _MixesUpItsLandmarks(InverseDepthStereoEKF):
    def joint_covariance(self, ids: Any = None) -> Any:
        return super().joint_covariance(np.roll(self.landmarks.ids, 1))


@pytest.mark.parametrize(
    ("broken", "complaint"),
    [
        (_AcceptsAnyTimeStep, "predict\\(0\\) raised nothing"),
        (_MovesBeforeItRefuses, "changed the state"),
        (_DependsOnTheOrder, "beliefs differ"),
        (_Overconfident, "mean pose NEES is"),
        (_Asymmetric, "forecast S is asymmetric"),
        (_MixesUpItsLandmarks, "the joint covariance of landmark 0 differs"),
        (_Random, "two filters differ"),
        (_HandsOutItsState, "the filter's state changed"),
    ],
)
def test_a_broken_filter_is_caught(broken: type[StereoEKF], complaint: str) -> None:
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
