"""The EKF on filterpy's class keeps the contract and estimates what the engine does (about 8 s)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from filters import (
    BodyVelocity,
    ConstantVelocity,
    StereoFilter,
    StereoObservation,
    VelocityDriven,
    check_filter,
    make_filter,
)
from filters.contract.inputs import Start
from stereo_slam_env.baselines import FilterpyEKF

from ...filters.drives import CAMERA, DT, INDEPENDENT_PIXELS, INDEPENDENT_UVD, ODD_CAMERA, SPEED, drive, start

FORWARD = BodyVelocity([0.0, 0.0, SPEED], [0.0, 0.2, 0.0], np.diag(np.repeat([0.1, 0.02], 3) ** 2))


def test_it_keeps_the_contract() -> None:
    check_filter(FilterpyEKF)


def assert_same_beliefs(filterpy: StereoFilter, engine: StereoFilter, tolerance: float = 1e-8) -> None:
    """States agree relative to their values, covariances relative to the two sigmas."""
    for mine, other in ((filterpy.pose, engine.pose), (filterpy.velocity, engine.velocity)):
        for name, value in vars(other).items():
            if name != "covariance":
                np.testing.assert_allclose(getattr(mine, name), value, rtol=tolerance, atol=0.01 * tolerance)
    mine, other = filterpy.landmarks, engine.landmarks
    np.testing.assert_array_equal(mine.ids, other.ids)
    for name in ("positions", "inverse_distance", "inverse_distance_variance"):
        np.testing.assert_allclose(getattr(mine, name), getattr(other, name), rtol=tolerance)
    for P, wanted in (
        (filterpy.joint_covariance(), engine.joint_covariance()),
        (filterpy.velocity.covariance, engine.velocity.covariance),
    ):
        sigmas = np.sqrt(np.diag(wanted))
        np.testing.assert_allclose(P / np.outer(sigmas, sigmas), wanted / np.outer(sigmas, sigmas), atol=tolerance)
    expected, forecast = engine.forecast(), filterpy.forecast()
    np.testing.assert_allclose(forecast.uvd, expected.uvd, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(forecast.S, expected.S, rtol=tolerance, atol=tolerance)
    np.testing.assert_array_equal(forecast.in_view, expected.in_view)


@pytest.mark.parametrize(
    ("camera", "noise", "odometry", "options"),
    [
        (CAMERA, INDEPENDENT_PIXELS, None, {"gate": None}),
        (ODD_CAMERA, INDEPENDENT_UVD, None, {"gate": None, "motion": ConstantVelocity(1.0, 0.2)}),
        (CAMERA, INDEPENDENT_PIXELS, FORWARD, {"gate": None}),
        (CAMERA, INDEPENDENT_PIXELS, FORWARD, {"gate": None, "motion": VelocityDriven()}),
        (CAMERA, INDEPENDENT_PIXELS, None, {"gate": 0.5}),
    ],
    ids=["vision only", "another rig", "odometry", "velocity-driven", "gated"],
)
def test_it_estimates_what_the_engine_does(camera: Any, noise: Any, odometry: Any, options: dict[str, Any]) -> None:
    """Eight landmarks that enter, leave and are missed, 15 frames: the same reports and, to 1e-8, beliefs."""
    filterpy = start(FilterpyEKF(camera, noise, **options))
    engine = start(make_filter("inverse-depth", camera=camera, noise=noise, landmark="inverse-depth", **options))
    reported = dict.fromkeys(("updated", "initialised", "dropped", "gated"), 0)
    for number, frame in enumerate(drive(4, 15, visible=8, noise=noise, camera=camera, depths=(6.0, 40.0))):
        if number:
            filterpy.predict(DT, odometry)
            engine.predict(DT, odometry)
            assert_same_beliefs(filterpy, engine)
        mine, other = filterpy.update(frame.observation), engine.update(frame.observation)
        for name, value in vars(other).items():
            if name.startswith("nis"):
                assert getattr(mine, name) == pytest.approx(value, rel=1e-8)
            else:
                assert sorted(getattr(mine, name)) == sorted(value), name
        assert_same_beliefs(filterpy, engine)
        reported = {name: count + len(getattr(mine, name)) for name, count in reported.items()}
    assert min(reported[name] for name in ("updated", "initialised", "dropped")) >= 5
    assert (reported["gated"] > 0) == (options["gate"] is not None)


def test_a_landmark_behind_the_camera_is_not_used() -> None:
    """The camera is told to have driven past all of them."""
    frames = drive(4, 1, visible=4, depths=(6.0, 10.0))
    stereo_filter = start(FilterpyEKF(CAMERA, INDEPENDENT_PIXELS, gate=None, motion=VelocityDriven()))
    stereo_filter.update(frames[0].observation)
    stereo_filter.predict(1.0, BodyVelocity([0.0, 0.0, 30.0], np.zeros(3), np.eye(6)))
    before = stereo_filter.pose
    report = stereo_filter.update(frames[0].observation)
    np.testing.assert_array_equal(report.behind_camera, np.sort(frames[0].observation.ids))
    assert report.nis_dof == 0
    np.testing.assert_array_equal(stereo_filter.pose.position, before.position)


def test_a_ray_along_the_vertical_starts_no_landmark() -> None:
    """Its azimuth is undefined."""
    stereo_filter = FilterpyEKF(CAMERA, INDEPENDENT_PIXELS)
    stereo_filter.reset(Start(orientation=(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))))
    report = stereo_filter.update(StereoObservation([3], [[CAMERA.cx, CAMERA.cy, 5.0]]))
    assert report.rejected.tolist() == [3]
    assert len(stereo_filter.landmarks.ids) == 0


@pytest.mark.parametrize("option", [{"gate": 1.5}, {"motion": "fast"}])
def test_impossible_options_are_refused(option: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(option))} must be"):
        FilterpyEKF(CAMERA, INDEPENDENT_PIXELS, **option)
