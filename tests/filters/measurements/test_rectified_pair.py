"""Measurement models: what they take from (u, v, d), and the noise that follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from filters import StereoNoise, StereoObservation

from ..slots import MEASUREMENTS

UVD = np.array([[100.0, 50.0, 8.0], [300.0, 70.0, -1.0]])
V_RIGHT = np.array([51.0, 69.5])
PIXELS = np.tile(StereoNoise.independent_pixels(2.0).R, (2, 1, 1))
FULL = np.tile([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 0.01]], (2, 1, 1))

without_row = StereoObservation([1, 2], UVD)
with_row = StereoObservation([1, 2], UVD, v_right=V_RIGHT)
every = pytest.mark.parametrize("model", MEASUREMENTS.values(), ids=MEASUREMENTS.keys())


@every
@pytest.mark.parametrize("R", [PIXELS, FULL], ids=["pixels", "correlated"])
def test_without_a_right_row_everything_is_a_function_of_uvd(model, R: np.ndarray) -> None:
    for stage in model.stages(without_row, R):
        T = stage.T[:, :3]
        assert not stage.T[:, 3:].any()
        np.testing.assert_allclose(stage.z, UVD @ T.T)
        np.testing.assert_allclose(stage.R, T @ R @ T.T)


@every
def test_measurements_are_not_changed(model) -> None:
    model.stages(with_row, PIXELS)
    np.testing.assert_array_equal(with_row.uvd, UVD)
    np.testing.assert_array_equal(PIXELS, np.tile(StereoNoise.independent_pixels(2.0).R, (2, 1, 1)))


def test_joint_is_the_triple_in_one_update() -> None:
    (stage,) = MEASUREMENTS["joint"].stages(with_row, PIXELS)
    np.testing.assert_array_equal(stage.z, UVD)
    np.testing.assert_array_equal(stage.R, PIXELS)


def test_sequential_is_left_then_right() -> None:
    left, right = MEASUREMENTS["sequential"].stages(with_row, PIXELS)
    np.testing.assert_array_equal(left.z, UVD[:, :2])
    np.testing.assert_allclose(right.z, [[92.0, 51.0], [301.0, 69.5]])
    # Independent pixels of 2 px in both eyes.
    np.testing.assert_allclose(left.R, np.tile(4 * np.eye(2), (2, 1, 1)))
    np.testing.assert_allclose(right.R, np.tile(4 * np.eye(2), (2, 1, 1)))


def test_a_right_row_that_is_not_measured_is_not_counted_twice() -> None:
    _, right = MEASUREMENTS["sequential"].stages(without_row, PIXELS)
    np.testing.assert_allclose(right.z, [[92.0], [301.0]])
    assert MEASUREMENTS["stacked"].stages(without_row, PIXELS)[0].z.shape == (2, 3)


@pytest.mark.parametrize("name", ["sequential", "stacked"])
def test_a_copied_right_row_counts_as_much_as_asked(name: str) -> None:
    """Its variance is a multiple of the left row's, and it is taken as an independent measurement."""
    model = replace(MEASUREMENTS[name], copied_row_variance=3.0)
    stage = model.stages(without_row, PIXELS)[-1]
    np.testing.assert_allclose(stage.z[:, -1], UVD[:, 1])
    np.testing.assert_allclose(stage.R[:, -1, -1], 3.0 * 4.0)
    np.testing.assert_array_equal(stage.R[:, -1, :-1], 0.0)
    np.testing.assert_array_equal(stage.R, np.swapaxes(stage.R, 1, 2))


@pytest.mark.parametrize("name", ["sequential", "stacked"])
def test_a_measured_right_row_is_not_inflated(name: str) -> None:
    inflated = replace(MEASUREMENTS[name], copied_row_variance=3.0).stages(with_row, PIXELS)
    for one, other in zip(inflated, MEASUREMENTS[name].stages(with_row, PIXELS), strict=True):
        np.testing.assert_array_equal(one.R, other.R)
        np.testing.assert_array_equal(one.z, other.z)


def test_a_variance_that_is_not_positive_is_refused() -> None:
    with pytest.raises(ValueError, match="copied_row_variance"):
        replace(MEASUREMENTS["sequential"], copied_row_variance=0.0)


def test_stacked_has_independent_pixels_where_they_are() -> None:
    (stage,) = MEASUREMENTS["stacked"].stages(with_row, PIXELS)
    np.testing.assert_allclose(stage.z, [[100, 50, 92, 51], [300, 70, 301, 69.5]])
    np.testing.assert_allclose(stage.R, np.tile(4 * np.eye(4), (2, 1, 1)))


def test_stacked_keeps_the_correlation_of_the_columns() -> None:
    """Under independent (u, v, d) noise u_right = u - d shares the error of u."""
    R = np.tile(np.eye(3), (2, 1, 1))
    (stage,) = MEASUREMENTS["stacked"].stages(without_row, R)
    np.testing.assert_allclose(stage.R[0], [[1, 0, 1], [0, 1, 0], [1, 0, 2]])


def test_left_is_the_left_pixel_only() -> None:
    (stage,) = MEASUREMENTS["left"].stages(with_row, PIXELS)
    np.testing.assert_array_equal(stage.z, UVD[:, :2])
