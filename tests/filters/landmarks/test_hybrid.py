"""Hybrid landmarks: when they are XYZ, and that changing over loses nothing."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from filters import FilterBatch, Hybrid, InverseDepthStereoEKF, Start, StereoEKF, StereoObservation
from filters.geometry import rotations, symmetric

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, START_COVARIANCE, drive, finish, start
from ..slots import ERRORS


def filter_with(error: str = "quaternion", **settings) -> StereoEKF:
    landmark = {"name": "hybrid", **settings}
    return StereoEKF(CAMERA, INDEPENDENT_PIXELS, gate=None, error=error, landmark=landmark)


def are_points(hybrid: StereoEKF) -> np.ndarray:
    return hybrid.state.anchor_block < 0


def test_index_is_civeras_formula() -> None:
    """4 sigma_d |cos alpha| / d_1 with sigma_d = sigma_rho / rho^2, computed here with points and angles."""
    rng = np.random.default_rng(1)
    position, anchors = rng.normal(size=3), rng.normal(size=(20, 3))
    parameters = np.column_stack([rng.uniform(-1, 1, (20, 2)), rng.uniform(0.02, 0.3, 20)])
    sigma = rng.uniform(0.001, 0.01, 20)
    points = Hybrid().points(anchors, parameters).positions
    first, now = points - anchors, points - position
    d1 = np.linalg.norm(now, axis=1)
    cos_alpha = np.sum(first * now, axis=1) / np.linalg.norm(first, axis=1) / d1
    expected = 4 * sigma / parameters[:, 2] ** 2 * np.abs(cos_alpha) / d1
    for anchor, y, variance, index in zip(anchors, parameters, sigma**2, expected, strict=True):
        given = anchor - position, y, np.array([0.0, 0.0, variance])
        assert Hybrid(linearity_limit=index * (1.0 + 1e-12)).becomes_point(*given)
        assert not Hybrid(linearity_limit=index * (1.0 - 1e-12)).becomes_point(*given)


@pytest.mark.parametrize("rho", [0.0, -0.01])
def test_a_point_at_infinity_or_beyond_is_never_linear(rho: float) -> None:
    given = np.ones(3), np.array([0.1, 0.2, rho]), np.full(3, 1e-12)
    assert not Hybrid(linearity_limit=1e9).becomes_point(*given)


def test_without_a_limit_the_estimates_are_those_of_shared_anchors() -> None:
    frames = drive(2, 30)
    hybrid = finish(filter_with(linearity_limit=None), frames)
    shared = finish(InverseDepthStereoEKF(CAMERA, INDEPENDENT_PIXELS, gate=None), frames)
    assert not are_points(hybrid).any()
    np.testing.assert_allclose(hybrid.pose.position, shared.pose.position, atol=1e-12)
    np.testing.assert_allclose(hybrid.pose.covariance, shared.pose.covariance, rtol=1e-9)


@pytest.mark.parametrize("error", ERRORS)
def test_changing_over_keeps_the_belief_to_first_order(error: str) -> None:
    """Positions, their covariance, the pose and every forecast with its S are what they would be without the change."""
    frames = drive(5, 12)
    changing, rays = (start(filter_with(linearity_limit=limit, error=error)) for limit in (0.05, None))
    for slam in (changing, rays):
        finish(slam, frames)
        slam.predict(DT)
    rays.state = changing.state
    seen = StereoObservation(changing.ids, changing.forecast().uvd)  # certain enough now for some to change
    for slam, limit in ((changing, 1e3), (rays, None)):
        slam.assume(slam.noise, landmark=Hybrid(limit))
        slam.update(seen)
    assert are_points(changing).all()
    assert not are_points(rays).all()
    np.testing.assert_allclose(changing.pose.covariance, rays.pose.covariance, rtol=1e-12)
    after, before = changing.landmarks, rays.landmarks
    np.testing.assert_allclose(after.positions, before.positions, rtol=1e-12)
    np.testing.assert_allclose(changing.forecast().uvd, rays.forecast().uvd, rtol=1e-12)
    if error != "first-estimates":
        np.testing.assert_allclose(after.covariances, before.covariances, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(changing.forecast().S, rays.forecast().S, rtol=1e-8, atol=1e-12)


def test_the_change_is_a_linear_map_of_the_covariance() -> None:
    """P after = T P T^T with T dense, every row of it, written out here; the anchors that none needs are left out."""
    hybrid = finish(filter_with(linearity_limit=None), drive(6, 10))
    observation = StereoObservation(hybrid.ids, hybrid.forecast().uvd)
    changed = copy.deepcopy(hybrid)
    hybrid.update(observation)
    changed.assume(changed.noise, landmark=Hybrid(1e3))
    changed.update(observation)
    state, after = hybrid.state, changed.state
    full, every = symmetric.full(state.P), np.arange(len(state))
    by_map = state.model.points(state.anchors(), state.parameters()).by_map
    T = np.zeros((12 + 3 * len(state), len(full)))
    T[:12, :12] = np.eye(12)
    for k, (rows, J) in enumerate(zip(state.map_rows(every), by_map, strict=True)):
        T[12 + 3 * k : 15 + 3 * k, rows] = J
    kept = np.concatenate([np.arange(12), after.own_rows(np.searchsorted(after.ids, state.ids)).ravel()])
    assert are_points(changed).all()
    expected = T @ full @ T.T
    np.testing.assert_allclose(symmetric.full(after.P)[np.ix_(kept, kept)], expected, rtol=1e-8, atol=1e-14)


class ByNumbers(Hybrid):
    """The same functions in Python."""

    in_machine_code = False


@pytest.mark.parametrize(
    ("error", "option"),
    [
        ("first-estimates", {"gauge_walk": 1e-3}),
        ("right-invariant", {"iterations": 2}),
        ("so3", {"consensus": True, "gate": 0.99, "drift": 0.1}),
    ],
    ids=["first-estimates", "right-invariant", "so3"],
)
def test_kernels_lead_where_the_numbers_do(error: str, option: dict[str, object]) -> None:
    found = []
    for landmark in (Hybrid(0.1), ByNumbers(0.1)):
        options = {"gate": None, "error": error, "landmark": landmark, **option}
        slam = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options), drive(8, 25))
        map_, seen = slam.landmarks, slam.forecast()
        assert 0 < are_points(slam).sum() < len(map_.ids)
        found.append(np.concatenate([slam.pose.covariance.ravel(), map_.positions.ravel(), seen.S.ravel()]))
    np.testing.assert_allclose(*found, rtol=1e-8, atol=1e-10)


def test_kernels_ask_for_the_change_in_the_frame_in_which_it_is_due() -> None:
    """Where another place of the camera, or another variance than that of rho, would have it come later."""
    told = []
    for landmark in (Hybrid(0.15), ByNumbers(0.15)):
        slam, changed = StereoEKF(CAMERA, INDEPENDENT_PIXELS, gate=None, landmark=landmark), []
        slam.reset(Start((0.0, 0.0, -10.0), linear_velocity=(0.0, 0.0, SPEED), covariance=START_COVARIANCE))
        for k in range(8):
            if k:
                slam.predict(DT)
            slam.update(StereoObservation([1], CAMERA.project([[1.0, -1.0, 20.0 - k * SPEED * DT]])))
            changed.append(bool(are_points(slam)[0]))
        told.append(changed)
    assert told[0] == told[1] == sorted(told[1])
    assert {False, True} == set(told[1])


def test_a_batch_tells_of_points_and_rays() -> None:
    batch = FilterBatch(lambda: filter_with(linearity_limit=0.1), 1)
    batch.reset(Start(linear_velocity=(0.0, 0.0, SPEED), covariance=START_COVARIANCE))
    for number, frame in enumerate(drive(8, 25)):
        if number:
            batch.predict(DT)
        batch.update([frame.observation])
    slam, seen = batch[0], batch.relative_landmarks()
    assert 0 < are_points(slam).sum() < len(slam.ids)
    expected = (slam.landmarks.positions - slam.pose.position) @ slam.state.camera.R_wc
    np.testing.assert_allclose(seen.points_c, expected, rtol=1e-9)
    joint, count = slam.joint_covariance(), len(slam.ids)
    for i in range(count):
        J = np.zeros((3, 9))
        J[:, :3], J[:, 6:] = -slam.state.camera.R_wc.T, slam.state.camera.R_wc.T
        J[:, 3:6] = rotations.skew(expected[i])
        rows = np.concatenate([np.arange(6), 6 + 3 * i + np.arange(3)])
        np.testing.assert_allclose(seen.covariances[i], J @ joint[np.ix_(rows, rows)] @ J.T, rtol=1e-6, atol=1e-9)
