"""Gravity as a variable that turns with the world, in a motion model of a third party."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import chi2

from filters import (
    FirstEstimates,
    MotionModel,
    RightInvariant,
    Start,
    StereoEKF,
    StereoObservation,
    Variable,
    check_part,
)
from filters.geometry import symmetric
from filters.geometry.vectors import plus, product, quaternion, scaled

from ..dense import at_first_estimates, gamma
from ..drives import CAMERA, INDEPENDENT_PIXELS

G = np.array([0.0, 9.81, 0.0])
KNOWN, UNKNOWN = 1e-8 * np.eye(3), np.eye(3)
DT = 0.05


@dataclass(frozen=True)
class Thrown(MotionModel):
    """Free fall: r' = r + v dt + g dt^2 / 2, v' = v + g dt; noise n = impulses of v and of the turn rate."""

    variables: tuple[Variable, ...] = (Variable("gravity", G, UNKNOWN, in_world=True),)

    def step(self, x, dt, n):
        v, w, g = plus(x.linear_velocity, n[:3], 1.0), plus(x.angular_velocity, n[3:], 1.0), x.gravity
        r = plus(plus(x.position, v, dt), g, 0.5 * dt * dt)
        return r, product(x.orientation, quaternion(scaled(dt, w))), plus(v, g, dt), w, g

    def sigmas(self, dt):
        return 0.01, 0.01, 0.01, 0.02, 0.02, 0.02


def flown(prior: np.ndarray, error: object, orientation: float = 0.2) -> StereoEKF:
    """A filter after 15 frames that does not know its velocity at the start, nor its orientation but to so many rad."""
    rng, motion = np.random.default_rng(0), Thrown((replace(Thrown().variables[0], covariance=prior),))
    slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, motion=motion, landmark="euclidean", error=error, gate=None)
    sigmas = np.repeat([1e-3, orientation, 100.0, 0.05], 3)  # a known direction of the velocity would be a compass
    velocity = np.array([0.0, -4.0, 2.0])
    slam.reset(Start(linear_velocity=velocity, covariance=np.diag(sigmas**2)))
    points = CAMERA.backproject(rng.uniform([400.0, 100.0, 20.0], [900.0, 300.0, 60.0], (12, 3)))
    for k in range(15):
        if k:
            slam.predict(DT)
        uvd = CAMERA.project(points - velocity * k * DT - 0.5 * G * (k * DT) ** 2)
        uvd = uvd + rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, len(uvd))
        slam.update(StereoObservation(np.arange(12), uvd))
    return slam


def test_gravity_passes_as_a_vector_of_the_world_and_not_as_numbers() -> None:
    assert "passed" in str(check_part(Thrown()))
    with pytest.raises(AssertionError, match=r"in a moved world .*in_world=True"):
        check_part(Thrown((replace(Thrown().variables[0], in_world=False),)))


def learnt(slam: StereoEKF, axis: np.ndarray) -> float:
    """Information on a rotation of the world about an axis in W, where its Jacobians are taken; 1: as at the start."""
    state = slam.state
    point = at_first_estimates(state) if slam.options.error.first_estimates else state
    direction = gamma(point) @ axis
    return 0.2**2 * float(direction @ np.linalg.solve(symmetric.full(state.P), direction))


@pytest.mark.parametrize("error", [FirstEstimates(), RightInvariant()], ids=["first-estimates", "right-invariant"])
def test_known_gravity_shows_the_vertical_and_no_heading(error: object) -> None:
    """Unknown gravity shows neither: the world may be turned with it; a plain EKF takes noise for both."""
    up, across = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    known, unknown = flown(KNOWN, error), flown(1e4 * UNKNOWN, error)
    assert learnt(known, up) == pytest.approx(1.0, abs=1e-3)
    assert learnt(known, across) > 100.0
    assert learnt(unknown, up) == pytest.approx(1.0, abs=1e-3)
    assert learnt(unknown, across) == pytest.approx(1.0, abs=1e-2)
    assert learnt(flown(KNOWN, "so3"), up) > 100.0


@pytest.mark.parametrize("error", ["so3", "first-estimates", "right-invariant", "left-invariant"])
def test_gravity_is_found_within_what_is_claimed(error: str) -> None:
    """Its size is: its direction only as well as the orientation at the start is known."""
    belief = flown(UNKNOWN, error, orientation=1e-3).belief("gravity")
    assert np.sqrt(np.diag(belief.covariance)).max() < 0.3
    left = belief.value - G
    assert left @ np.linalg.solve(belief.covariance, left) < chi2.ppf(0.999, 3)
