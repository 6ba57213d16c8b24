"""Filters that must give the same numbers: by a change of coordinates, by relinearising, by sharing anchors."""

from __future__ import annotations

import copy
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares

from filters import ConstantVelocity, LeftThenRight, Stacked, Start, StereoEKF, StereoNoise, StereoObservation
from filters.geometry import symmetric

from ..dense import retracted
from ..drives import DT, INDEPENDENT_PIXELS, INDEPENDENT_UVD, SPEED, drive, run
from .beliefs import assert_same_belief, make, scaled

FULL = StereoNoise([[1.0, 0.3, 0.6], [0.3, 1.5, -0.2], [0.6, -0.2, 2.0]])


# --- measurement coordinates ---


@pytest.mark.parametrize("noise", [INDEPENDENT_PIXELS, INDEPENDENT_UVD, FULL], ids=["pixels", "uvd", "full"])
@pytest.mark.parametrize("landmark", ["inverse-depth", "shared-anchor", "euclidean"])
def test_joint_and_stacked_are_the_same_filter(landmark: str, noise: StereoNoise) -> None:
    """(u, v, d) with R, or (u, v, u_right) with T R T^T: the same numbers, NIS included."""
    frames = drive(0, 12, noise=noise, depths=(6.0, 30.0))
    joint, stacked = (make(noise, landmark=landmark, measurement=m) for m in ("joint", "stacked"))
    for one, other in zip(run(joint, frames), run(stacked, frames), strict=True):
        assert one.nis == pytest.approx(other.nis, rel=1e-8)
        assert one.nis_dof == other.nis_dof
    assert_same_belief(joint, stacked, 1e-9)


def test_the_right_row_is_one_more_measurement_of_v_and_nothing_else() -> None:
    """Stacked with v_right is joint with the mean of both rows, of half the variance."""
    frames = drive(1, 12, v_right=True, depths=(6.0, 30.0))
    stacked, joint = make(measurement="stacked"), make(measurement="joint")
    averaged_R = np.array([[1.0, 0.0, 1.0], [0.0, 0.5, 0.0], [1.0, 0.0, 2.0]])
    for number, frame in enumerate(frames):
        for stereo_filter in (stacked, joint):
            if number:
                stereo_filter.predict(DT)
        seen = frame.observation
        known = np.isin(seen.ids, joint.landmarks.ids)
        uvd = seen.uvd.copy()
        # New landmarks are started from (u, v, d) with R in every filter, without the right row.
        uvd[known, 1] = 0.5 * (uvd[known, 1] + seen.v_right[known])
        R = np.where(known[:, None, None], averaged_R, INDEPENDENT_PIXELS.R)
        stacked.update(seen)
        joint.update(StereoObservation(seen.ids, uvd, R=R))
        assert_same_belief(stacked, joint, 1e-9)


@pytest.mark.parametrize("model", [LeftThenRight, Stacked])
def test_a_copied_right_row_of_huge_variance_is_one_left_out(model: type) -> None:
    frames = drive(1, 12, depths=(6.0, 30.0))
    copied, left_out = make(measurement=model(copied_row_variance=1e13)), make(measurement=model())
    for _ in zip(run(copied, frames), run(left_out, frames), strict=True):
        assert_same_belief(copied, left_out, 1e-9)


def small_problem(scale: float, seed: int, **options) -> tuple[StereoEKF, StereoObservation]:
    """A filter with a map, after a prediction, and a consistent frame: every sigma is `scale` times the usual one."""
    noise = StereoNoise(scale**2 * INDEPENDENT_PIXELS.R)
    motion = ConstantVelocity(3.0 * scale, 0.6 * scale)
    stereo_filter = make(noise, motion=motion, drop_unseen=False, **options)
    covariance = scale**2 * np.diag(np.repeat([0.05, 0.01, 0.5, 0.05], 3) ** 2)
    stereo_filter.reset(Start(linear_velocity=(0.0, 0.0, SPEED), covariance=covariance))
    stereo_filter.update(drive(4, 1, depths=(6.0, 30.0))[0].observation)
    stereo_filter.predict(DT)
    rng = np.random.default_rng(seed)
    forecast = stereo_filter.forecast()
    # One shift for all, as a wrong pose gives, and noise.
    shift = rng.uniform(3.0, 6.0, 3) + rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, len(forecast.ids))
    return stereo_filter, StereoObservation(forecast.ids, forecast.uvd + scale * shift)


def moved_by(stereo_filter: StereoEKF, observation: StereoObservation) -> np.ndarray:
    """Run the update and give the change of every number of the state."""
    before = state_of(stereo_filter)
    stereo_filter.update(observation)
    return state_of(stereo_filter) - before


def state_of(stereo_filter: StereoEKF) -> np.ndarray:
    camera, blocks = stereo_filter.state.camera, stereo_filter.state.blocks
    velocities = camera.linear_velocity, camera.angular_velocity
    return np.concatenate([camera.position, camera.orientation, *velocities, blocks.ravel()])


def test_sequential_differs_from_joint_only_by_relinearisation() -> None:
    """With all sigmas scaled by s the correction scales with s, and the difference with s^2."""

    def compare(scale: float) -> tuple[float, float]:
        joint, sequential = (moved_by(*small_problem(scale, 0, measurement=m)) for m in ("joint", "sequential"))
        return float(np.abs(joint - sequential).max()), float(np.abs(joint).max())

    by_scale = [compare(scale) for scale in (0.08, 0.04, 0.02, 0.01)]
    for (coarse, _), (fine, _) in pairwise(by_scale):
        assert 3.5 < coarse / fine < 4.5
    assert by_scale[-1][0] < 1e-3 * by_scale[-1][1]


# --- iterations ---


@pytest.mark.parametrize("error", ["quaternion", "so3"])
@pytest.mark.parametrize("measurement", ["joint", "sequential", "stacked"])
def test_iterating_changes_nothing_on_an_almost_linear_problem(measurement: str, error: str) -> None:
    """The measurement is not counted again (a known trap of iterated filters): P stays that of one pass."""
    made = []
    for iterations in (1, 3):
        options = {"measurement": measurement, "error": error, "iterations": iterations}
        stereo_filter, observation = small_problem(1e-5, 1, **options)
        before = stereo_filter.velocity.covariance
        correction = moved_by(stereo_filter, observation)
        assert (np.diag(stereo_filter.velocity.covariance) < 0.5 * np.diag(before)).any()
        made.append((correction, stereo_filter.pose.covariance))
    (once, P_once), (thrice, P_thrice) = made
    np.testing.assert_allclose(thrice, once, rtol=0, atol=1e-4 * np.abs(once).max())
    np.testing.assert_allclose(*scaled(P_thrice, P_once), rtol=0, atol=1e-4)


@pytest.mark.parametrize("measurement", ["joint", "sequential", "unrectified"])
@pytest.mark.parametrize("error", ["quaternion", "so3", "first-estimates", "right-invariant"])
def test_the_limit_of_relinearising_lies_between_one_pass_and_all(measurement: str, error: str) -> None:
    frames = drive(8, 12, missed=0.1)
    start = Start(linear_velocity=(0.5, 0.3, SPEED - 1.0), covariance=np.diag(np.repeat([0.1, 0.05, 1.0, 0.3], 3)))

    def end(iterations: int, relinearise_above: float = 0.0) -> np.ndarray:
        options = {"measurement": measurement, "error": error, "relinearise_above": relinearise_above}
        slam = make(iterations=iterations, **options)
        slam.reset(start)
        list(run(slam, frames))
        return np.concatenate([slam.pose.position, slam.pose.covariance.ravel()])

    limit = 1e-3 if error == "right-invariant" else 1.0  # whose tangents miss less
    once, thrice, some = end(1), end(3), end(3, limit)
    np.testing.assert_allclose(end(3, 1e9), once, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(end(3, 1e-200), thrice, rtol=1e-9, atol=1e-12)
    assert min(np.abs(some - once).max(), np.abs(some - thrice).max()) > 1e-6


@pytest.mark.parametrize(
    ("landmark", "error"), [("inverse-depth", "quaternion"), ("shared-anchor", "so3"), ("euclidean", "quaternion")]
)
def test_iterating_converges_to_the_map_estimate(landmark: str, error: str) -> None:
    """Against an optimiser that minimises prior plus measurement residuals, with none of the filter's Jacobians."""
    frames = drive(8, 2, missed=0.0, visible=6, depths=(6.0, 15.0))
    prior = make(landmark=landmark, error=error, iterations=100, drop_unseen=False)
    covariance = np.diag(np.repeat([0.1, 0.05, 1.0, 0.3], 3) ** 2)
    prior.reset(Start(linear_velocity=(0.5, 0.3, SPEED - 1.0), covariance=covariance))
    prior.update(frames[0].observation)
    prior.predict(DT)
    seen = frames[1].observation
    seen = seen.select(np.argsort(seen.ids))
    seen = seen.select(np.isin(seen.ids, prior.landmarks.ids))
    # 6-D inverse depth has a singular P: minimise over coordinates of its range.
    values, vectors = np.linalg.eigh(symmetric.full(prior.state.P))
    regular = values > 1e-13 * values.max()
    root = vectors[:, regular] * np.sqrt(values[regular])
    whiten = np.linalg.inv(np.linalg.cholesky(INDEPENDENT_PIXELS.R))

    def moved(x: np.ndarray) -> StereoEKF:
        there = copy.deepcopy(prior)
        there.state = retracted(prior, root @ x)
        return there

    def residuals(x: np.ndarray) -> np.ndarray:
        uvd = moved(x).forecast(seen.ids).uvd
        return np.concatenate([x, ((seen.uvd - uvd) @ whiten.T).ravel()])

    start_at = np.zeros(root.shape[1])
    optimum = least_squares(residuals, start_at, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-10)
    best = moved(optimum.x)
    converged, once = copy.deepcopy(prior), make(landmark=landmark, error=error, drop_unseen=False)
    once.state = copy.deepcopy(prior.state)
    once.update(seen)
    converged.update(seen)
    np.testing.assert_allclose(converged.pose.position, best.pose.position, rtol=0, atol=1e-6)
    np.testing.assert_allclose(converged.pose.orientation, best.pose.orientation, rtol=0, atol=1e-6)
    np.testing.assert_allclose(converged.velocity.linear, best.velocity.linear, rtol=0, atol=1e-5)
    np.testing.assert_allclose(converged.state.blocks, best.state.blocks, rtol=0, atol=1e-5)
    # One pass is not there yet, or the test would say nothing.
    assert np.abs(once.pose.position - best.pose.position).max() > 3e-4


# --- six numbers or a shared anchor ---


@pytest.mark.parametrize("measurement", ["joint", "sequential"])
def test_shared_anchors_give_the_estimates_of_six_numbers(measurement: str) -> None:
    frames = drive(7, 40, visible=20, depths=(6.0, 60.0))
    options = {"measurement": measurement, "gate": 0.99}
    six, shared = (make(landmark=name, **options) for name in ("inverse-depth", "shared-anchor"))
    entered = left = 0
    for one, other in zip(run(six, frames), run(shared, frames), strict=True):
        np.testing.assert_array_equal(one.updated, other.updated)
        entered, left = entered + len(one.initialised), left + len(one.dropped)
        assert_same_belief(six, shared, 1e-9)
        assert len(shared.state.P) <= len(six.state.P)
    assert entered > 60
    assert left > 40
