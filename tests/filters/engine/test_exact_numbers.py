"""Numbers of an update that nothing else in the estimate would show: each written out."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import CalibratedPair, InertialSamples, Start, StereoEKF, StereoObservation, Strapdown
from filters.geometry import rotations, symmetric
from filters.geometry.derivatives import jacobian_of
from filters.geometry.vectors import spread_by

from ..dense import at_first_estimates, gamma
from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, drive, finish
from ..inertial_drives import UNIT, driven, measured
from ..slots import ERRORS, LANDMARKS

BROAD = np.diag(np.repeat([0.2, 0.05, 1.0, 0.2], 3) ** 2)
UVD = np.array([[300.0, 150.0, 25.0], [1000.0, 250.0, 24.0], [350.0, 300.0, 26.0], [1050.0, 120.0, 25.0]])


def make(**options: object) -> StereoEKF:
    return StereoEKF(CAMERA, INDEPENDENT_PIXELS, **{"gate": None, **options})


# --- joint compatibility ---


def test_of_hypotheses_with_equal_support_the_tighter_one_wins_and_of_equal_ones_the_first() -> None:
    """Two pairs of landmarks that contradict each other, wherever in the frame; then two single ones."""
    slam = make(gate=0.99, consensus=True, landmark="euclidean")
    slam.reset(Start(covariance=np.diag([*np.full(6, 1e-6), 3.0, *np.full(5, 1e-6)]) ** 2))  # sideways, m/s
    slam.update(StereoObservation([1, 2, 3, 4], UVD))
    slam.predict(DT)
    points = slam.landmarks.positions
    to_the_right, to_the_left = (CAMERA.project(points - [x, 0.0, 0.0]) for x in (0.2, -0.2))
    for tight in ([0, 1], [2, 3], [0, 3], [1, 2]):
        loose = [k for k in range(4) if k not in tight]
        seen = np.where(np.isin(np.arange(4), tight)[:, None], to_the_right, to_the_left)
        seen[loose[0], 0] += 1.5  # within the noise, yet not as tight
        report = copy.deepcopy(slam).update(StereoObservation([1, 2, 3, 4], seen))
        assert report.updated.tolist() == [k + 1 for k in tight]
    for first, second in ((0, 1), (3, 2)):
        seen = StereoObservation([first + 1, second + 1], np.stack([to_the_right[first], to_the_left[second]]))
        assert copy.deepcopy(slam).update(seen).updated.tolist() == [min(first, second) + 1]


# --- new landmarks ---


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("landmark", [name for name in LANDMARKS if name != "polar"])
def test_where_the_camera_is_does_not_matter_to_a_landmark_that_it_has_just_seen(landmark: str, error: str) -> None:
    """The next look at it has twice the noise of a measurement, however vague the pose: Eq. 25 with all its signs."""
    slam = make(landmark=landmark, error=error)
    slam.reset(Start((1.0, 2.0, 3.0), Rotation.from_rotvec([0.2, -0.4, 0.1]).as_quat(), covariance=BROAD))
    slam.update(StereoObservation([1, 2, 3, 4], UVD))
    S = slam.forecast([1, 2, 3, 4]).S
    np.testing.assert_allclose(S, np.broadcast_to(2.0 * INDEPENDENT_PIXELS.R, S.shape), rtol=0, atol=1e-5)


def test_iterations_do_not_move_what_is_considered() -> None:
    """Next to certain, it is as if it were not there."""
    found = []
    for measurement in (CalibratedPair(baseline_sigma=1e-9, considered=True), "joint"):
        slam = finish(make(measurement=measurement, iterations=2), drive(33, 6, visible=12, depths=(6.0, 30.0)))
        found.append(np.concatenate([slam.pose.position, slam.pose.covariance.ravel()]))
    np.testing.assert_allclose(*found, rtol=1e-7, atol=1e-10)


# --- vectors of W ---


def test_a_step_turns_the_vectors_of_the_world_with_it() -> None:
    """F Gamma_k = Gamma_k+1 with first estimates that are not the state, of gravity too."""
    motion, edges = Strapdown(), DT / 20 * np.arange(21)
    slam = make(error="first-estimates", landmark="euclidean", motion=motion)
    turned = Rotation.from_rotvec([0.4, -0.9, 0.3]).as_quat()
    slam.reset(Start((1.0, 2.0, -3.0), turned, (0.5, 0.1, 4.0), covariance=BROAD))
    samples = measured(driven, edges)
    given = InertialSamples(edges[1:], samples[:, :3], samples[:, 3:], UNIT)
    for uvd in (UVD, UVD + 3.0):
        slam.predict(DT, inertial=given)
        slam.update(StereoObservation(np.arange(4), uvd))
    state = slam.state
    assert np.abs(state.predicted.variables["gravity"] - state.camera.variables["gravity"]).max() > 1e-3
    found = []
    for scale in (0.0, 1.0):
        twin, turned = copy.deepcopy(slam), gamma(at_first_estimates(state))
        twin.state = replace(state, P=scale * np.asfortranarray(turned @ turned.T))
        twin.predict(DT, inertial=given)
        found.append(symmetric.full(twin.state.P))
    there = gamma(at_first_estimates(twin.state))
    np.testing.assert_allclose(found[1] - found[0], there @ there.T, rtol=0, atol=1e-9 * np.abs(there).max() ** 2)


@pytest.mark.parametrize("angle", [1e-9, 0.0999, 0.1001, 2.0])
def test_the_derivative_of_j_l_is_that_by_dual_numbers(angle: float) -> None:
    """On both sides of where its series ends."""
    theta, a = angle * np.array([2.0, -1.0, 2.0]) / 3.0, np.array([3.0, 5.0, -7.0])
    expected = jacobian_of(lambda turn: spread_by(turn, tuple(a)), theta[None])[1][0]
    np.testing.assert_allclose(rotations.left_jacobian_derivative_of(*theta, *a), expected.ravel(), rtol=0, atol=1e-11)
