"""Gauge walk: camera and map walk together, which no measurement can see and the absolute pose must admit."""

from __future__ import annotations

import numpy as np
import pytest

from filters import GaugeWalk, RightInvariant, Start, StereoEKF
from filters.state import symmetric

from .drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, START_COVARIANCE, drive, finish, run, start
from .slots import LANDMARKS

WALK = {"rotation": 0.01, "translation": 0.05}
KEEPING = ["first-estimates", "right-invariant"]


def make(**options: object) -> StereoEKF:
    return StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)


@pytest.mark.parametrize("error", KEEPING)
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_the_walk_shows_in_the_pose_and_in_no_forecast(landmark: str, error: str) -> None:
    frames = drive(1, 2, visible=20)
    walked, still = (start(make(landmark=landmark, error=error, gauge_walk=walk)) for walk in (WALK, None))
    for slam in (walked, still):
        slam.update(frames[0].observation)
        slam.clone_pose("where it started")
        slam.predict(DT)
    added = symmetric.full(walked.state.P) - symmetric.full(still.state.P)
    scale = np.sqrt(np.diag(symmetric.full(walked.state.P))) + 1e-12
    assert np.linalg.matrix_rank(added / np.outer(scale, scale), tol=1e-8) == 6
    growth = np.diag(walked.pose.covariance - still.pose.covariance)
    distance = SPEED * DT
    np.testing.assert_allclose(growth, np.repeat([0.05**2, 0.01**2], 3) * distance, rtol=1e-6)
    np.testing.assert_allclose(  # the camera walks away from where it was
        walked.belief("where it started").covariance, still.belief("where it started").covariance, rtol=1e-9, atol=1e-15
    )
    seen, expected = walked.forecast(), still.forecast()
    np.testing.assert_allclose(seen.S, expected.S, rtol=0, atol=1e-9 * np.abs(expected.S).max())


@pytest.mark.parametrize("error", KEEPING)
def test_it_costs_vision_nothing(error: str) -> None:
    """The same way is found, to a share of sigma that the changed weights of start and prior explain."""
    frames = drive(2, 20)
    walked, still = (finish(make(landmark="shared-anchor", error=error, gauge_walk=w), frames) for w in (WALK, None))
    sigmas = np.sqrt(np.diag(still.pose.covariance))[:3]
    assert (np.abs(walked.pose.position - still.pose.position) < 0.2 * sigmas).all()
    assert np.linalg.slogdet(walked.pose.covariance)[1] > np.linalg.slogdet(still.pose.covariance)[1] + 3.0


def test_standing_still_adds_nothing() -> None:
    frames = drive(3, 1)
    walked, still = (make(error="right-invariant", gauge_walk=walk) for walk in (WALK, None))
    for slam in (walked, still):
        slam.reset(Start(covariance=START_COVARIANCE))
        slam.update(frames[0].observation)
        slam.predict(DT)
    np.testing.assert_allclose(walked.pose.covariance, still.pose.covariance, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("error", ["quaternion", "so3", "left-invariant", RightInvariant(reset=True)])
def test_errors_that_take_it_for_information_are_refused(error: object) -> None:
    with pytest.raises(
        ValueError, match=r"error must keep what cannot be observed unobservable with gauge_walk, .* use"
    ):
        make(error=error, gauge_walk=WALK)


@pytest.mark.parametrize("given", [0.1, {"rotation": -1.0}, {"turn": 0.1}, {"translation": float("inf")}])
def test_an_impossible_walk_is_refused(given: object) -> None:
    with pytest.raises(ValueError, match="gauge_walk"):
        make(error="right-invariant", gauge_walk=given)


def test_it_is_named_or_given_as_an_object() -> None:
    frames = drive(5, 6)
    for walk in (WALK, GaugeWalk(**WALK)):
        *_, last = run(start(make(error="first-estimates", gauge_walk=walk)), frames)
        assert len(last.updated)
