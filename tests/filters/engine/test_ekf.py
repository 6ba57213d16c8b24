"""The composed filter: order of work, beliefs, odometry, and what a refused call leaves."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, Start, StereoEKF, StereoObservation, VelocityDriven
from filters.geometry import symmetric

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, INDEPENDENT_UVD, SPEED, drive, finish, run
from .beliefs import assert_identical, make, snapshot, tilted


def test_new_landmarks_start_from_the_updated_pose_and_unseen_ones_leave() -> None:
    frames = drive(12, 2, missed=0.0, visible=12)
    stereo_filter = make()
    first, second = (frame.observation for frame in frames)
    stereo_filter.update(first)
    stereo_filter.predict(DT)
    predicted = stereo_filter.pose.position
    kept = second.select(np.arange(6))
    new = StereoObservation([900], [[600.0, 200.0, 15.0]])
    report = stereo_filter.update(StereoObservation(np.append(kept.ids, new.ids), np.vstack([kept.uvd, new.uvd])))
    assert report.initialised.tolist() == [900]
    assert set(report.dropped) == set(first.ids) - set(kept.ids)
    state = stereo_filter.state
    anchor = state.anchors(np.flatnonzero(state.ids == 900))[0]
    np.testing.assert_array_equal(anchor, stereo_filter.pose.position)
    assert np.abs(predicted - anchor).max() > 1e-6
    np.testing.assert_allclose(stereo_filter.forecast([900]).uvd, new.uvd, rtol=1e-12)


def test_per_measurement_noise_is_used_for_update_and_for_initialisation() -> None:
    """R in the observation equals the same R given to the filter."""
    frames = drive(13, 6, noise=INDEPENDENT_UVD)
    assumed, told = make(INDEPENDENT_UVD), make(INDEPENDENT_PIXELS)
    for number, frame in enumerate(frames):
        if number:
            assumed.predict(DT)
            told.predict(DT)
        seen = frame.observation
        assumed.update(seen)
        told.update(StereoObservation(seen.ids, seen.uvd, R=np.tile(INDEPENDENT_UVD.R, (len(seen), 1, 1))))
    assert_identical(snapshot(assumed), snapshot(told))


def test_forecast_is_what_the_update_expects() -> None:
    """Prediction and S of the forecast give the NIS that the update reports for a single landmark."""
    frames = drive(14, 4, missed=0.0)
    stereo_filter = make(drop_unseen=False)
    for _ in run(stereo_filter, frames[:3]):
        pass
    stereo_filter.predict(DT)
    seen = frames[3].observation
    for i in np.intersect1d(seen.ids, stereo_filter.landmarks.ids)[:4]:
        one = seen.select(seen.ids == i)
        forecast = stereo_filter.forecast([i])
        nu = (one.uvd - forecast.uvd)[0]
        report = copy.deepcopy(stereo_filter).update(one)
        assert report.nis == pytest.approx(nu @ np.linalg.solve(forecast.S[0], nu), rel=1e-9)


def test_landmark_belief_is_in_ascending_order_with_its_own_covariances() -> None:
    """Against the parameters of each landmark, one at a time."""
    stereo_filter = finish(make(drop_unseen=False), drive(15, 6, depths=(6.0, 30.0)))
    belief, state = stereo_filter.landmarks, stereo_filter.state
    assert (np.diff(belief.ids) > 0).all()
    P = symmetric.full(state.P)
    for row, i in enumerate(belief.ids):
        index = np.flatnonzero(state.ids == i)
        anchor, (theta, phi, rho) = state.anchors(index)[0], state.parameters(index)[0]
        m = np.array([np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)])
        np.testing.assert_allclose(belief.positions[row], anchor + m / rho, rtol=1e-12)
        where = state.map_rows(index)[0]
        assert belief.inverse_distance[row] == pytest.approx(rho, rel=1e-15)
        assert belief.inverse_distance_variance[row] == pytest.approx(P[where[5], where[5]])
        m_theta = np.array([np.cos(phi) * np.cos(theta), 0.0, -np.cos(phi) * np.sin(theta)])
        m_phi = np.array([-np.sin(phi) * np.sin(theta), -np.cos(phi), -np.sin(phi) * np.cos(theta)])
        J = np.column_stack([np.eye(3), m_theta / rho, m_phi / rho, -m / rho**2])
        np.testing.assert_allclose(belief.covariances[row], J @ P[np.ix_(where, where)] @ J.T, rtol=1e-9, atol=1e-15)


# --- odometry ---


def test_odometry_is_fused_as_a_measurement_of_the_velocity() -> None:
    """Precise odometry pins the velocity and the displacement of the step; vague odometry changes nothing."""
    truth_linear, truth_angular = np.array([0.1, -0.05, 4.0]), np.array([0.01, 0.3, -0.02])
    precise = BodyVelocity(truth_linear, truth_angular, 1e-10 * np.eye(6))
    vague = BodyVelocity(truth_linear, truth_angular, 1e12 * np.eye(6))
    with_precise, with_vague, without = make(), make(), make()
    for stereo_filter in (with_precise, with_vague, without):
        stereo_filter.reset(Start(linear_velocity=(0.0, 0.0, SPEED)))
    with_precise.predict(DT, precise)
    with_vague.predict(DT, vague)
    without.predict(DT)
    np.testing.assert_allclose(with_precise.velocity.angular, truth_angular, atol=1e-5)
    half = Rotation.from_rotvec(0.5 * DT * truth_angular)
    np.testing.assert_allclose(with_precise.pose.position, half.apply(truth_linear) * DT, atol=2e-3)
    np.testing.assert_allclose(with_precise.velocity.linear, half.apply(truth_linear), atol=2e-2)
    np.testing.assert_allclose(with_vague.pose.position, without.pose.position, atol=1e-9)
    np.testing.assert_allclose(with_vague.velocity.covariance, without.velocity.covariance, rtol=1e-6, atol=1e-9)


def test_dead_reckoning_covariance_matches_samples() -> None:
    """VelocityDriven over a turn: the claimed pose covariance is that of many noisy runs."""
    rng = np.random.default_rng(16)
    linear, angular = np.array([0.2, 0.0, 5.0]), np.array([0.0, 0.4, 0.05])
    covariance = np.diag(np.repeat([0.05, 0.01], 3) ** 2)
    steps, runs = 8, 100

    def driven(noise: np.ndarray) -> StereoEKF:
        stereo_filter = make(motion=VelocityDriven())
        stereo_filter.reset(Start(covariance=1e-12 * np.eye(12)))
        for step in range(steps):
            stereo_filter.predict(DT, BodyVelocity(linear + noise[step, :3], angular + noise[step, 3:], covariance))
        return stereo_filter

    exact = driven(np.zeros((steps, 6)))
    errors = []
    for _ in range(runs):
        pose = driven(rng.multivariate_normal(np.zeros(6), covariance, steps)).pose
        errors.append(exact.pose_error(pose.position, pose.orientation)[0])
    claimed = exact.pose.covariance
    nees = np.einsum("ri,ij,rj->r", errors, np.linalg.inv(claimed), errors)
    # Mean of 100 chi-square variables with 6 degrees of freedom: 6 +- 0.35; four sigma.
    assert abs(nees.mean() - 6.0) < 1.4
    with pytest.raises(ValueError, match="odometry must be given"):
        exact.predict(DT)


@pytest.mark.parametrize("error", ["quaternion", "so3"])
def test_pose_error_is_in_the_filters_own_definition(error: str) -> None:
    stereo_filter = tilted(make(error=error))
    pose = stereo_filter.pose
    turn = np.array([0.3, -0.2, 0.4])
    truth = (Rotation.from_quat(pose.orientation) * Rotation.from_rotvec(turn)).as_quat()
    for sign in (1.0, -1.0):
        difference, covariance = stereo_filter.pose_error(np.add(pose.position, (1.0, 2.0, 3.0)), sign * truth)
        angle = np.linalg.norm(turn)
        expected = turn if error == "so3" else 2 * np.tan(angle / 2) / angle * turn
        np.testing.assert_allclose(difference, [1.0, 2.0, 3.0, *expected], rtol=1e-10)
        np.testing.assert_array_equal(covariance, pose.covariance)


# --- refused calls ---

NAN, INF = float("nan"), float("inf")
REFUSED: dict[str, tuple[Callable[[StereoEKF], object], str]] = {
    "dt zero": (lambda f: f.predict(0.0), "dt must be"),
    "dt negative": (lambda f: f.predict(-0.1), "dt must be"),
    "dt NaN": (lambda f: f.predict(NAN), "dt must be"),
    "dt infinite": (lambda f: f.predict(INF), "dt must be"),
    "dt not a number": (lambda f: f.predict("soon"), "dt must be"),
    "odometry of another type": (lambda f: f.predict(DT, np.zeros(6)), "odometry must be"),
    "update with nothing": (lambda f: f.update(None), "observation must be"),
    "update with an array": (lambda f: f.update(np.zeros((3, 3))), "observation must be"),
    "reset to a position": (lambda f: f.reset((0.0, 0.0, 0.0)), "start must be a filters.Start"),
    "forecast of a stranger": (lambda f: f.forecast([123456]), "ids must be in the map"),
    "forecast twice": (lambda f: f.forecast([f.landmarks.ids[0]] * 2), "ids must be unique"),
    "forecast of fractions": (lambda f: f.forecast([0.5]), "ids must be integers"),
    "forget of a table": (lambda f: f.forget([[1, 2]]), "ids must have shape"),
    "forget of fractions": (lambda f: f.forget([1.5]), "ids must be integers"),
    "pose_error NaN": (lambda f: f.pose_error((NAN, 0, 0), (0, 0, 0, 1)), "position must be finite"),
    "pose_error not unit": (lambda f: f.pose_error((0, 0, 0), (0, 0, 0, 0)), "orientation must be a unit"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_refused_call_names_the_argument_and_leaves_every_bit_as_it_was(what: str) -> None:
    call, message = REFUSED[what]
    stereo_filter = finish(make(), drive(17, 3))
    before = snapshot(stereo_filter)
    with pytest.raises(ValueError, match=message):
        call(stereo_filter)
    assert_identical(snapshot(stereo_filter), before)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gate": 0.0}, "gate must be"),
        ({"gate": 1.0}, "gate must be"),
        ({"gate": NAN}, "gate must be"),
        ({"iterations": 0}, "iterations must be"),
        ({"iterations": 1.5}, "iterations must be"),
        ({"relinearise_above": -1.0}, "relinearise_above must be"),
        ({"relinearise_above": NAN}, "relinearise_above must be"),
        ({"min_disparity": INF}, "min_disparity must be"),
        ({"landmark": "homogeneous"}, "landmark must be one of"),
        ({"measurement": "jont"}, "did you mean 'joint'"),
        ({"error": "so4"}, "did you mean 'so3'"),
    ],
)
def test_impossible_options_are_refused(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)


@pytest.mark.parametrize(
    "options",
    [
        {"drop_unseen": 1},
        {"drop_unseen": "no"},
        {"gate": "0.9"},
        {"min_disparity": "2"},
        {"motion": "constant"},
        {"landmark": ["euclidean"]},
    ],
    ids=str,
)
def test_options_of_a_wrong_type_are_refused(options: dict) -> None:
    with pytest.raises(ValueError, match="must be"):
        StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)


def test_camera_and_noise_must_be_what_they_say() -> None:
    with pytest.raises(ValueError, match="camera must be a StereoCamera"):
        StereoEKF("camera", INDEPENDENT_PIXELS)
    with pytest.raises(ValueError, match="noise must be a StereoNoise"):
        StereoEKF(CAMERA, np.eye(3))


def test_the_filter_keeps_no_view_of_what_it_was_given_or_gave() -> None:
    position, covariance = np.zeros(3), np.eye(12)
    stereo_filter = make()
    stereo_filter.reset(Start(position=position, covariance=covariance))
    stereo_filter.update(drive(18, 1)[0].observation)
    before = snapshot(stereo_filter)
    before = [array.copy() for array in before]
    position += 1.0
    covariance += 1.0
    belief = stereo_filter.landmarks
    shown = [*vars(stereo_filter.pose).values(), *vars(stereo_filter.velocity).values(), *vars(belief).values()]
    for array in shown:
        if array.flags.writeable:
            array[...] = 7
    assert_identical(snapshot(stereo_filter), before)
