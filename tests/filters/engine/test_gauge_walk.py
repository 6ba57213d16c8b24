"""Gauge walk: camera and map walk together, which no measurement can see and the absolute pose must admit."""

from __future__ import annotations

import numpy as np
import pytest

from filters import RightInvariant, Start, StereoEKF
from filters.geometry import symmetric

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, START_COVARIANCE, drive, finish
from ..slots import LANDMARKS
from ..stranger.parts import OnS3

WALK = 0.01
TURN_WEIGHT = 5.0  # as docs/covariances.md measured it
KEEPING = ["first-estimates", "right-invariant"]


def make(**options: object) -> StereoEKF:
    return StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)


@pytest.mark.parametrize("error", KEEPING)
@pytest.mark.parametrize("landmark", [*LANDMARKS, OnS3()], ids=str)
def test_the_walk_shows_in_the_pose_and_in_no_forecast(landmark: object, error: str) -> None:
    frames = drive(1, 2, visible=20)
    walked, still = (make(landmark=landmark, error=error, gauge_walk=walk) for walk in (WALK, 0.0))
    for slam in (walked, still):
        slam.reset(Start((1.0, 2.0, -3.0), (0.1, -0.7, 0.1, 0.7), (0.3, 0.0, 5.0), (0.05, 0.4, 0.0), START_COVARIANCE))
        slam.update(frames[0].observation)
        slam.clone_pose("where it started")
    before = walked.pose
    for slam in (walked, still):
        slam.predict(DT)
    added = symmetric.full(walked.state.P) - symmetric.full(still.state.P)
    scale = np.sqrt(np.diag(symmetric.full(walked.state.P))) + 1e-12
    assert np.linalg.matrix_rank(added / np.outer(scale, scale), tol=1e-8) == 6
    # By how far the landmarks move on the sphere of bearings, and by their mean inverse distance.
    away = walked.landmarks.positions - walked.pose.position
    distances = np.linalg.norm(away, axis=1)
    step = walked.pose.position - before.position
    turn = 2.0 * np.arccos(min(1.0, abs(walked.pose.orientation @ before.orientation)))
    assert turn > 0.03
    motion = TURN_WEIGHT * turn + np.mean(np.linalg.norm(np.cross(step, away), axis=1) / distances**2)
    growth = np.diag(walked.pose.covariance - still.pose.covariance)
    expected = WALK**2 * motion * np.repeat([1.0 / np.mean(1.0 / distances) ** 2, 1.0], 3)
    np.testing.assert_allclose(growth, expected, rtol=1e-5)
    np.testing.assert_allclose(  # the camera walks away from where it was
        walked.belief("where it started").covariance, still.belief("where it started").covariance, rtol=1e-9, atol=1e-15
    )
    seen, known = walked.forecast(), still.forecast()
    np.testing.assert_allclose(seen.S, known.S, rtol=0, atol=1e-9 * np.abs(known.S).max())


@pytest.mark.parametrize("error", KEEPING)
def test_it_costs_vision_nothing(error: str) -> None:
    """The same way is found, to a share of sigma that the changed weights of start and prior explain."""
    frames = drive(2, 20)
    walked, still = (finish(make(landmark="shared-anchor", error=error, gauge_walk=w), frames) for w in (WALK, 0.0))
    sigmas = np.sqrt(np.diag(still.pose.covariance))[:3]
    assert (np.abs(walked.pose.position - still.pose.position) < 0.2 * sigmas).all()
    assert np.linalg.slogdet(walked.pose.covariance)[1] > np.linalg.slogdet(still.pose.covariance)[1] + 3.0


@pytest.mark.parametrize("has_map", [False, True])
def test_standing_still_and_an_empty_map_add_nothing(has_map: bool) -> None:
    frames = drive(3, 1)
    walked, still = (make(error="right-invariant", gauge_walk=walk) for walk in (WALK, 0.0))
    for slam in (walked, still):
        if has_map:
            slam.reset(Start(covariance=START_COVARIANCE))
            slam.update(frames[0].observation)
        else:
            slam.reset(Start(linear_velocity=np.array([0.0, 0.0, 3.0]), covariance=START_COVARIANCE))
        slam.predict(DT)
    np.testing.assert_allclose(walked.pose.covariance, still.pose.covariance, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("error", ["quaternion", "so3", "left-invariant", RightInvariant(reset=True)])
def test_errors_that_take_it_for_information_are_refused(error: object) -> None:
    with pytest.raises(ValueError, match=r"error must keep what cannot be observed unobservable with gauge_walk, .* u"):
        make(error=error, gauge_walk=WALK)


@pytest.mark.parametrize("given", [-1.0, float("inf"), "much"])
def test_an_impossible_walk_is_refused(given: object) -> None:
    with pytest.raises(ValueError, match="gauge_walk"):
        make(error="right-invariant", gauge_walk=given)
