"""The stereo camera (Eq. 10, 21)."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from filters import StereoCamera

from ..drives import ODD_CAMERA as CAMERA

RNG = np.random.default_rng(0)
PIXELS = RNG.uniform([0, 0, 0.5], [1279, 419, 60], (20, 3))


def test_projection_is_that_of_two_pinholes() -> None:
    """D is the difference of the columns in a left camera and in one a baseline to the right of it."""
    points = CAMERA.backproject(PIXELS)
    u, v, d = CAMERA.project(points).T
    x, y, z = points.T
    np.testing.assert_allclose(u, CAMERA.fx * x / z + CAMERA.cx, rtol=1e-12)
    np.testing.assert_allclose(v, CAMERA.fy * y / z + CAMERA.cy, rtol=1e-12)
    u_right = CAMERA.fx * (x - CAMERA.baseline) / z + CAMERA.cx
    np.testing.assert_allclose(d, u - u_right, rtol=1e-9)


def test_backprojection_undoes_projection() -> None:
    np.testing.assert_allclose(CAMERA.project(CAMERA.backproject(PIXELS)), PIXELS, rtol=1e-12)


def test_depth_and_disparity() -> None:
    """A point straight ahead at z has d = fx b / z."""
    np.testing.assert_allclose(CAMERA.project([0.0, 0.0, 10.0]), [600.0, 210.0, 28.0])
    np.testing.assert_allclose(CAMERA.backproject([600.0, 210.0, 28.0]), [0.0, 0.0, 10.0])
    assert CAMERA.disparity_constant == pytest.approx(280.0)


@pytest.mark.parametrize("shape", [(), (1,), (4,), (2, 3), (0,)])
def test_any_leading_shape_will_do(shape: tuple[int, ...]) -> None:
    points = np.ones((*shape, 3))
    assert CAMERA.project(points).shape == (*shape, 3)
    assert CAMERA.backproject(points).shape == (*shape, 3)
    assert CAMERA.project_jacobian(points).shape == (*shape, 3, 3)
    assert CAMERA.project_scaled_jacobian(points, np.ones(shape)).shape == (*shape, 3, 4)
    assert CAMERA.in_view(points).shape == shape


def test_scaled_projection_is_projection_of_the_quotient() -> None:
    directions, scales = CAMERA.ray(PIXELS), RNG.uniform(0.01, 1.0, 20)
    np.testing.assert_allclose(
        CAMERA.project_scaled(directions, scales), CAMERA.project(directions / scales[:, None]), rtol=1e-12
    )


def test_scaled_projection_is_regular_at_infinity_and_beyond() -> None:
    uvd = CAMERA.project_scaled([[0.1, 0.2, 1.0]] * 3, [0.1, 0.0, -0.1])
    np.testing.assert_allclose(uvd[:, :2], np.tile(uvd[0, :2], (3, 1)))
    np.testing.assert_allclose(uvd[:, 2], [28.0, 0.0, -28.0])


def test_points_behind_have_negative_disparity_and_points_beside_no_image() -> None:
    assert CAMERA.project([1.0, 1.0, -5.0])[2] < 0
    assert not np.isfinite(CAMERA.project([1.0, 1.0, 0.0])).all()


@pytest.mark.parametrize("d", [0.0, -1.0, np.nan])
def test_backprojection_refuses_what_has_no_point(d: float) -> None:
    with pytest.raises(ValueError, match="uvd must have d > 0"):
        CAMERA.backproject([[100.0, 100.0, 5.0], [100.0, 100.0, d]])


@pytest.mark.parametrize(
    ("uvd", "inside"),
    [
        ((0, 0, 0), True),
        ((1279, 419, 0), True),
        ((1279.5, 100, 5), False),
        ((-0.5, 100, 0), False),
        ((20, 100, 20), True),
        ((20, 100, 20.5), False),  # out of the right image
        ((1279, 100, -1), False),
        ((100, 419.5, 5), False),
        ((100, -0.1, 5), False),
        ((np.nan, 100, 5), False),
    ],
)
def test_in_view_means_in_both_images(uvd: tuple[float, float, float], inside: bool) -> None:
    assert CAMERA.in_view(uvd) == inside
    assert CAMERA.in_view([100, 2, 5], margin=2)
    assert not CAMERA.in_view([100, 1.9, 5], margin=2)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *product(["fx", "fy", "baseline", "width", "height"], [0, -1, np.nan, np.inf, "wide"]),
        *product(["cx", "cy"], [np.nan, np.inf]),
    ],
)
def test_sizes_must_be_positive_and_the_principal_point_finite(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=rf"camera\.{name} must be"):
        StereoCamera(**{**vars(CAMERA), name: value})
