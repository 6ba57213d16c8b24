"""What every landmark parametrisation must keep: a new landmark projects to where it was seen."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import InverseDepth, RangeBearing
from filters.geometry.derivatives import columns_of

from ..drives import ODD_CAMERA as CAMERA
from ..first_sight import first_sight
from ..slots import LANDMARKS

POSITION = np.array([3.0, -1.0, 7.0])
R_WC = Rotation.from_rotvec([0.2, -0.7, 0.3]).as_matrix()
RNG = np.random.default_rng(0)
UVD = RNG.uniform([50, 30, 2], [1250, 400, 40], (12, 3))
ANY_UVD = np.vstack([UVD, [[600, 200, 0.0], [100, 50, -1.0]]])

every = pytest.mark.parametrize("model", LANDMARKS.values(), ids=LANDMARKS.keys())
ANGLES = ("inverse-depth", "shared-anchor", "hybrid")
by_angles = pytest.mark.parametrize("model", [LANDMARKS[name] for name in ANGLES], ids=ANGLES)


def started(model, uvd: np.ndarray):
    parameters = first_sight(model, CAMERA, POSITION, R_WC, uvd).parameters
    return np.tile(POSITION, (len(uvd), 1)) if model.anchored else None, parameters


def can_start(model, R_wc: np.ndarray, uvd: np.ndarray) -> list[bool]:
    points_c = RangeBearing().backproject(CAMERA, uvd, {})
    seen = np.hstack([points_c[:, :3] @ R_wc.T, points_c[:, 3:]])
    return [bool(model.can_start_from(tuple(h))) for h in seen.tolist()]


@every
def test_a_new_landmark_is_seen_where_it_was_measured(model) -> None:
    uvd = ANY_UVD[can_start(model, R_WC, ANY_UVD)]
    assert len(uvd) >= len(UVD)
    anchors, parameters = started(model, uvd)
    seen = model.relative_to(POSITION, anchors, parameters).homogeneous
    np.testing.assert_allclose(CAMERA.project_scaled(seen[:, :3] @ R_WC, seen[:, 3]), uvd, rtol=1e-10, atol=1e-10)


@every
def test_points_are_the_triangulated_ones(model) -> None:
    anchors, parameters = started(model, UVD)
    expected = POSITION + CAMERA.backproject(UVD) @ R_WC.T
    np.testing.assert_allclose(model.points(anchors, parameters).positions, expected, rtol=1e-10)


@every
def test_relative_to_another_camera_is_the_point_minus_its_position(model) -> None:
    anchors, parameters = started(model, UVD)
    other = np.array([4.0, 0.0, 9.0])
    seen = model.relative_to(other, anchors, parameters).homogeneous
    points = model.points(anchors, parameters).positions
    np.testing.assert_allclose(seen[:, :3] / seen[:, 3:], points - other, rtol=1e-9)


@every
def test_inverse_distance_is_that_of_the_point_from_where_it_was_seen(model) -> None:
    anchors, parameters = started(model, UVD)
    distance = np.linalg.norm(CAMERA.backproject(UVD), axis=1)
    np.testing.assert_allclose(model.inverse_distances(POSITION, anchors, parameters).values, 1 / distance, rtol=1e-10)


@by_angles
def test_rho_is_zero_at_no_disparity_and_changes_sign_with_it(model) -> None:
    _, parameters = started(model, ANY_UVD)
    np.testing.assert_array_equal(np.sign(parameters[:, 2]), np.sign(ANY_UVD[:, 2]))
    mirrored = started(model, ANY_UVD * [1, 1, -1])[1]
    np.testing.assert_array_equal(mirrored[:, 2], -parameters[:, 2])
    np.testing.assert_array_equal(mirrored[:, :2], parameters[:, :2])


@by_angles
def test_a_point_at_infinity_has_no_finite_position_and_no_warning(model) -> None:
    anchors, parameters = started(model, np.array([[600.0, 200.0, 0.0]]))
    assert not np.isfinite(model.points(anchors, parameters).positions).all()


@by_angles
def test_the_vertical_of_the_world_is_refused_and_what_is_near_it_is_not(model) -> None:
    """There the azimuth of Eq. 24 is undefined."""
    down = Rotation.from_rotvec([-np.pi / 2, 0, 0]).as_matrix()
    pixels = np.array([[CAMERA.cx, CAMERA.cy, 5.0], [CAMERA.cx + 0.01, CAMERA.cy, 5.0], [100.0, 100.0, 5.0]])
    assert abs(down @ [0, 0, 1] @ np.array([0, 1, 0])) == pytest.approx(1.0)
    assert can_start(model, down, pixels) == [False, True, True]
    assert np.isfinite(first_sight(model, CAMERA, POSITION, down, pixels[1:]).noise).all()


def test_euclidean_needs_a_positive_disparity() -> None:
    uvd = np.array([[600.0, 200.0, d] for d in (-1.0, 0.0, 1e-9, 5.0)])
    assert can_start(LANDMARKS["euclidean"], R_WC, uvd) == [False, False, True, True]


def test_directions_are_those_of_the_paper() -> None:
    """Eq. 5: theta turns about y from +z to +x, phi lifts against +y (down)."""
    angles = np.array([[0, 0], [np.pi / 2, 0], [0, np.pi / 2], [np.pi, 0]])
    expected = [[0, 0, 1], [1, 0, 0], [0, -1, 0], [0, 0, -1]]
    rays = columns_of(InverseDepth().point_of, np.column_stack([angles, np.zeros(4)]))
    np.testing.assert_allclose(rays[:, :3], expected, atol=1e-15)
