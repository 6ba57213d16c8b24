"""The composed filter: order of work, beliefs, odometry, and what a refused call leaves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from filters import BodyVelocity, Start, StereoEKF, StereoObservation, VelocityDriven
from filters.geometry import symmetric

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, INDEPENDENT_UVD, drive, finish, run
from .beliefs import assert_identical, make, snapshot


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
    list(run(stereo_filter, frames[:3]))
    stereo_filter.predict(DT)
    seen = frames[3].observation
    one = seen.select(seen.ids == np.intersect1d(seen.ids, stereo_filter.landmarks.ids)[2])
    forecast = stereo_filter.forecast(one.ids)
    nu = (one.uvd - forecast.uvd)[0]
    assert stereo_filter.update(one).nis == pytest.approx(nu @ np.linalg.solve(forecast.S[0], nu), rel=1e-9)


def test_landmark_belief_is_in_ascending_order_with_the_numbers_of_each() -> None:
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
        of_rho = state.map_rows(index)[0, 5]
        assert belief.inverse_distance[row] == pytest.approx(rho, rel=1e-15)
        assert belief.inverse_distance_variance[row] == pytest.approx(P[of_rho, of_rho])


# --- odometry ---


def test_dead_reckoning_covariance_matches_samples() -> None:
    """VelocityDriven over a turn: the claimed pose covariance is that of many noisy runs."""
    rng, velocity = np.random.default_rng(16), np.array([0.2, 0.0, 5.0, 0.0, 0.4, 0.05])
    covariance = np.diag(np.repeat([0.05, 0.01], 3) ** 2)

    def driven(noise: np.ndarray) -> StereoEKF:
        stereo_filter = make(motion=VelocityDriven())
        stereo_filter.reset(Start(covariance=1e-12 * np.eye(12)))
        for step in velocity + noise:
            stereo_filter.predict(DT, BodyVelocity(step[:3], step[3:], covariance))
        return stereo_filter

    exact = driven(np.zeros((8, 6)))
    poses = [driven(rng.multivariate_normal(np.zeros(6), covariance, 8)).pose for _ in range(100)]
    errors = [exact.pose_error(pose.position, pose.orientation)[0] for pose in poses]
    nees = np.einsum("ri,ij,rj->r", errors, np.linalg.inv(exact.pose.covariance), errors)
    # Mean of 100 chi-square variables with 6 degrees of freedom: 6 +- 0.35; four sigma.
    assert abs(nees.mean() - 6.0) < 1.4
    with pytest.raises(ValueError, match="odometry must be given"):
        exact.predict(DT)


# --- refused calls ---

NAN, INF = float("nan"), float("inf")
REFUSED: list[tuple[Callable[[StereoEKF], object], str]] = [
    *((lambda f, dt=dt: f.predict(dt), "dt must be") for dt in (0.0, -0.1, NAN, INF, "soon", 1e3)),
    (lambda f: f.predict(DT, np.zeros(6)), "odometry must be"),
    (lambda f: f.update(None), "observation must be"),
    (lambda f: f.update(np.zeros((3, 3))), "observation must be"),
    (lambda f: f.reset((0.0, 0.0, 0.0)), "start must be a filters.Start"),
    (lambda f: f.forecast([123456]), "ids must be in the map"),
    (lambda f: f.forecast([f.landmarks.ids[0]] * 2), "ids must be unique"),
    (lambda f: f.forecast([0.5]), "ids must be integers"),
    (lambda f: f.forget([[1, 2]]), "ids must have shape"),
    (lambda f: f.forget([1.5]), "ids must be integers"),
    (lambda f: f.pose_error((NAN, 0, 0), (0, 0, 0, 1)), "position must be finite"),
    (lambda f: f.pose_error((0, 0, 0), (0, 0, 0, 0)), "orientation must be a unit"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED)
def test_a_refused_call_names_the_argument_and_leaves_every_bit_as_it_was(call: Callable, message: str) -> None:
    stereo_filter = finish(make(), drive(17, 3))
    before = snapshot(stereo_filter)
    with pytest.raises(ValueError, match=message):
        call(stereo_filter)
    assert_identical(snapshot(stereo_filter), before)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *(({"gate": gate}, "gate must be") for gate in (0.0, 1.0, NAN, "0.9")),
        *(({"iterations": count}, "iterations must be") for count in (0, 1.5)),
        *(({"relinearise_above": limit}, "relinearise_above must be") for limit in (-1.0, NAN)),
        *(({"min_disparity": limit}, "min_disparity must be") for limit in (INF, "2")),
        *(({"drop_unseen": answer}, "drop_unseen must be") for answer in (1, "no")),
        *(({"landmark": part}, "landmark must be one of") for part in ("homogeneous", ["euclidean"])),
        ({"measurement": "jont"}, "did you mean 'joint'"),
        ({"error": "so4"}, "did you mean 'so3'"),
        ({"update": "unscented", "error": "first-estimates"}, "error must linearise at the state with update=Unsc"),
        ({"motion": "constant"}, "motion must be"),
        ({"tail_dof": 0.0}, "tail_dof must be a finite number > 0"),
        ({"consensus": True, "gate": None}, "gate must be a probability with consensus=True"),
        ({"camera": "camera"}, "camera must be a StereoCamera"),
        ({"noise": np.eye(3)}, "noise must be a StereoNoise"),
    ],
)
def test_impossible_options_are_refused(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StereoEKF(**{"camera": CAMERA, "noise": INDEPENDENT_PIXELS, **options})


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
