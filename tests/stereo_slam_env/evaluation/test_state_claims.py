"""Velocities and biases against a truth: errors, claims, and what an alignment or a body makes of them (5 s)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import stereo_slam_env as sse
from filters import Pose
from filters.geometry import rotations
from stereo_slam_env.recording.state_beliefs import StateBelief
from stereo_slam_env.recording.trajectory import Trajectory

NAMES = ("velocity", "gyro-bias", "accelerometer-bias")


def odometry(count=1000, seed=0, excess=1.0):
    """A drive and an estimate of it whose errors are independent; those of the states `excess` times too large."""
    rng = np.random.default_rng(seed)
    t = 0.05 * np.arange(count)
    p = np.column_stack([20 * np.sin(t / 7), 15 * np.cos(t / 5), np.sin(t)])
    v = np.column_stack([20 / 7 * np.cos(t / 7), -3 * np.sin(t / 5), np.cos(t)])
    q = Rotation.from_rotvec(np.column_stack([0.1 * np.sin(t), 0.1 * np.cos(t), t / 3])).as_quat()
    true = {"velocity": v, "gyro-bias": np.tile([0.01, 0.02, 0.03], (count, 1))}
    true["accelerometer-bias"] = 10.0 * true["gyro-bias"]
    sigmas = np.array([[0.1, 0.2, 0.3], [0.001, 0.002, 0.003], [0.01, 0.02, 0.03]])
    states = {}
    for name, sigma in zip(NAMES, sigmas, strict=True):
        P = np.tile(np.diag(sigma**2), (count, 1, 1))
        states[name] = StateBelief(true[name] + excess * sigma * rng.normal(size=(count, 3)), P)
    turned = rotations.multiply(q, rotations.exp_quaternion(0.01 * rng.normal(size=(count, 3))))
    P = np.tile(1e-4 * np.eye(6), (count, 1, 1))
    at = p + 0.01 * rng.normal(size=(count, 3))
    estimate = Trajectory(at, turned, t, P, name="mine", states=states)
    truth = Trajectory(p, q, t, name="truth", states={name: StateBelief(value) for name, value in true.items()})
    return estimate, truth


def test_true_claims_of_the_states_are_consistent():
    score = sse.evaluate_trajectory(*odometry())
    low, high = chi2(3 * 999).ppf([0.0005, 0.9995]) / 999
    for name in NAMES:
        claim = score.claims[name]
        assert (claim.dof, claim.frames, claim.unusable) == (3, 999, 0)
        assert low < claim.nees.mean < high
        assert claim.verdict.startswith("consistent")
        assert score.nees[name].shape == (999,)
    assert score.state_rmse["velocity"] == pytest.approx(0.1 * 14**0.5, rel=0.1)
    assert score.state_rmse["gyro-bias"] == pytest.approx(0.001 * 14**0.5, rel=0.1)
    assert next(iter(score.claims)) == "pose"


def test_claims_that_are_too_small_are_told_by_how_much():
    score = sse.evaluate_trajectory(*odometry(excess=3.0))
    assert [score.claims[name].nees.mean / 3 for name in NAMES] == pytest.approx([9.0] * 3, rel=0.15)
    assert score.claims["velocity"].verdict.startswith("overconfident: errors are ")
    assert score.claims["pose"].verdict.startswith("consistent")


def test_a_reference_states_its_own_errors():
    estimate, truth = odometry(excess=2**0.5)
    doubted = {name: replace(truth.states[name], covariances=belief.covariances)
               for name, belief in estimate.states.items()}  # fmt: skip
    score = sse.evaluate_trajectory(estimate, replace(truth, states=doubted))
    assert [score.claims[name].nees.mean / 3 for name in NAMES] == pytest.approx([1.0] * 3, rel=0.15)


@pytest.mark.parametrize("interpolate", [False, True])
def test_a_turned_world_leaves_claims_as_they_are_and_says_what_it_cannot_carry(interpolate):
    estimate, truth = odometry()
    there = estimate.moved(Pose([3.0, 2.0, 1.0], Rotation.from_rotvec([0.0, 0.0, 2.0]).as_quat()))
    score = sse.evaluate_trajectory(there, truth, align="gravity-yaw", interpolate=interpolate)
    assert score.claims["velocity"].nees.mean == pytest.approx(3.0, rel=0.15)
    assert any("not carried through the alignment 'gravity-yaw'" in note for note in score.notes)
    assert not any("not carried" in note for note in sse.evaluate_trajectory(estimate, truth, align="none").notes)


def test_an_inertial_odometry_is_aligned_by_its_first_pose_where_it_claims_to_know_that():
    """Its roll and pitch at the start are claimed to be off by 10 mrad, and are: gravity says them, not the truth."""
    estimate, truth = odometry()
    P = estimate.covariances.copy()
    P[0] = np.diag([0.0, 0.0, 0.0, 1e-4, 1e-4, 0.0]) + 1e-12 * np.eye(6)
    tilt = Rotation.from_rotvec([0.01, 0.01, 0.0])
    first = Trajectory(truth.positions[:1], (Rotation.from_quat(truth.orientations[:1]) * tilt).as_quat())
    positions, orientations = estimate.positions.copy(), estimate.orientations.copy()
    positions[0], orientations[0] = first.positions[0], first.orientations[0]
    there = replace(estimate, positions=positions, orientations=orientations, covariances=P, gauge="gravity_yaw").moved(
        Pose([3.0, 2.0, 1.0], Rotation.from_rotvec([0.0, 0.0, 2.0]).as_quat())
    )
    score = sse.evaluate_trajectory(there, truth)
    assert (score.alignment, score.aligned_by) == ("gravity-yaw", 1)
    assert any(note.startswith("aligned by the first pose, whose position is") for note in score.notes)
    assert not any("not carried" in note for note in score.notes)
    assert score.claims["pose"].nees.mean == pytest.approx(6.0, rel=0.15)
    assert sse.evaluate_trajectory(replace(there, covariances=estimate.covariances), truth).aligned_by == 1000
    assert sse.evaluate_trajectory(there, truth, align_seconds=5.0).aligned_by == 101


def test_a_velocity_along_the_axes_of_the_body_is_named_and_not_judged():
    estimate, truth = odometry()
    R = rotations.matrix(truth.orientations)
    belief = estimate.states["velocity"]
    in_body = replace(belief, values=rotations.turned(R.swapaxes(1, 2), belief.values))
    score = sse.evaluate_trajectory(replace(estimate, states={**estimate.states, "velocity": in_body}), truth)
    assert (
        score.claims["velocity"].verdict == "the velocity of mine is along the axes of its body: write it in the world"
    )
    assert score.claims["gyro-bias"].obstacle == ""


def test_what_one_of_the_two_lacks_is_not_scored():
    estimate, truth = odometry(60)
    states = {"velocity": StateBelief(estimate.states["velocity"].values)}
    score = sse.evaluate_trajectory(replace(estimate, states=states), truth)
    assert (set(score.state_rmse), set(score.claims)) == ({"velocity"}, {"pose", "position", "rotation"})
    assert sse.evaluate_trajectory(estimate, replace(truth, states={})).state_rmse == {}


def test_rows_without_a_state_are_left_out_and_covariances_that_are_none_counted():
    estimate, truth = odometry(60)
    belief = estimate.states["gyro-bias"]
    values, P = belief.values.copy(), belief.covariances.copy()
    values[10], P[20] = np.nan, 0.0
    changed = {**estimate.states, "gyro-bias": StateBelief(values, P)}
    claim = sse.evaluate_trajectory(replace(estimate, states=changed), truth).claims["gyro-bias"]
    assert (claim.frames, claim.unusable) == (57, 1)
    assert claim.verdict == "none: 1 of 58 covariances are not positive definite"
    changed["gyro-bias"] = StateBelief(values, 0.0 * P)
    score = sse.evaluate_trajectory(replace(estimate, states=changed), truth)
    assert "gyro-bias" not in score.claims
    assert any("none of the covariances of the gyro-bias of mine is positive definite" in note for note in score.notes)
