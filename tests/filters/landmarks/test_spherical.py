"""Bearings on the sphere, with inverse distance and with log-distance, against inverse depth in two angles."""

from __future__ import annotations

import numpy as np
import pytest

from filters import Polar, Spherical, Start, StereoEKF, StereoObservation
from filters.geometry.derivatives import columns_of
from filters.landmarks.spherical import tangent_basis

from ..drives import CAMERA, DT
from ..matched_drives import HIGH, LOW, PIXELS, Setup, finished, mean_nees

SETUP = Setup(frames=8, visible=12)
EVERYWHERE = np.vstack([np.eye(3), -np.eye(3), np.random.default_rng(0).standard_normal((50, 3))])
EVERYWHERE /= np.linalg.norm(EVERYWHERE, axis=1, keepdims=True)


def test_the_tangent_basis_is_orthonormal_everywhere() -> None:
    basis = np.transpose(tangent_basis(tuple(EVERYWHERE.T)), (2, 1, 0))
    whole = np.concatenate([EVERYWHERE[:, :, None], basis], axis=2)
    assert whole.transpose(0, 2, 1) @ whole == pytest.approx(np.tile(np.eye(3), (len(whole), 1, 1)), abs=1e-12)


@pytest.mark.parametrize("model", [Spherical(), Polar()], ids=["spherical", "polar"])
def test_no_direction_is_singular(model: Spherical) -> None:
    """Where two angles have a pole, too: a correction is undone, and the Jacobians are of its size."""
    scale = np.full(len(EVERYWHERE), 0.1)
    started = model.started(np.zeros(3), EVERYWHERE, scale)
    delta = np.random.default_rng(1).uniform(-0.5, 0.5, (len(EVERYWHERE), 3))
    moved = columns_of(model.retract_by, started.parameters, delta)
    assert columns_of(model.local_by, started.parameters, moved) == pytest.approx(delta, abs=1e-12)
    assert np.linalg.norm(moved[:, :3], axis=1) == pytest.approx(1.0)
    sizes = np.linalg.svd(started.by_seen[:, :2, :3], compute_uv=False)
    assert sizes == pytest.approx(np.ones_like(sizes), abs=1e-9)


def test_a_landmark_straight_below_can_be_tracked() -> None:
    """Inverse depth refuses a ray along the vertical of W (Eq. 24)."""
    down = Start(orientation=(-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)), linear_velocity=(1.0, 0.0, 0.0))
    for landmark, started in (("shared-anchor", False), ("spherical", True), ("polar", True)):
        slam = StereoEKF(CAMERA, PIXELS, landmark=landmark)
        slam.reset(down)
        uvd = np.array([[CAMERA.cx, CAMERA.cy, 40.0], [CAMERA.cx + 200.0, CAMERA.cy, 30.0]])
        assert (0 in slam.update(StereoObservation([0, 1], uvd)).initialised) == started
        slam.predict(DT)
        assert (0 in slam.update(StereoObservation([0, 1], uvd)).updated) == started


def test_to_first_order_it_is_inverse_depth() -> None:
    """The same estimates within a twentieth of sigma, and the same NEES."""
    for seed in range(10):
        slam, _ = finished(SETUP, seed, landmark="spherical")
        other, _ = finished(SETUP, seed)
        difference, covariance = slam.pose_error(other.pose.position, other.pose.orientation)
        assert np.abs(difference / np.sqrt(np.diag(covariance))).max() < 0.05
        assert np.linalg.eigvals(np.linalg.solve(other.pose.covariance, covariance)).real == pytest.approx(1, abs=0.05)
        apart = (slam.landmarks.inverse_distance - other.landmarks.inverse_distance) ** 2
        assert (apart < 0.05**2 * slam.landmarks.inverse_distance_variance).all()


def test_the_pose_is_as_certain_as_it_is_right() -> None:
    of = {name: mean_nees(lambda seed: SETUP, landmark=name) for name in ("shared-anchor", "spherical", "polar")}
    assert all(LOW < value < HIGH for value in of.values()), of
    assert of["spherical"] == pytest.approx(of["shared-anchor"], rel=0.01)


def test_a_landmark_without_a_distance_has_no_logarithm() -> None:
    h_w, scale = np.tile([[0.0, 0.0, 1.0]], (4, 1)), np.array([0.1, 1e-12, 0.0, -0.1])
    seen = np.column_stack([h_w, scale])
    assert [bool(Polar().can_start_from(h)) for h in seen] == [True, True, False, False]
    assert all(Spherical().can_start_from(h) for h in seen)
    started = Polar().started(np.zeros(3), h_w[:2], scale[:2])
    assert started.parameters[:, 3] == pytest.approx(-np.log(scale[:2]))
    assert np.isfinite(started.by_seen).all()
    assert started.by_seen[:, 2, 3] == pytest.approx(-1.0 / scale[:2], rel=1e-9)
