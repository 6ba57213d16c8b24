"""The blockwise update is the Kalman update: against dense algebra (against filterpy: test_linear_gaussian.py)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from filters.engine import kalman
from filters.motions.model import LinearMeasurement
from filters.state import symmetric
from filters.state.linearised import LinearisedMeasurements, of_variables

from .linear_problems import (
    assert_covariances_equal,
    dense,
    joseph_update,
    lower,
    random_covariance,
    random_measurements,
)

RNG = np.random.default_rng


@pytest.mark.parametrize("rows", [1, 2, 3, 4])
@pytest.mark.parametrize(("count", "per_landmark"), [(1, 1), (7, 2), (45, 1), (45, 2)])
def test_update_equals_the_dense_joseph_update(count: int, per_landmark: int, rows: int) -> None:
    rng = RNG([count, per_landmark, rows])
    P = random_covariance(rng, 12 + 3 * 30)
    measurements = random_measurements(rng, count, rows, 30, per_landmark)
    updated = lower(P)
    correction = kalman.update(updated, measurements)
    delta, expected, nis = joseph_update(P, measurements)
    assert_covariances_equal(symmetric.full(updated), expected, 1e-8)
    np.testing.assert_allclose(correction.delta, delta, rtol=0, atol=1e-8 * np.sqrt(np.diag(P)).max())
    assert correction.nis == pytest.approx(nis, rel=1e-9)
    assert correction.dof == count * rows
    assert correction.used.all()


@pytest.mark.parametrize("chunk", [1, 2, 7, 20, 44, 45, 1000])
def test_the_size_of_the_chunks_does_not_change_the_result(chunk: int) -> None:
    rng = RNG(3)
    P = random_covariance(rng, 12 + 3 * 40)
    measurements = random_measurements(rng, 45, 3, 40)
    whole, parts = lower(P), lower(P)
    expected = kalman.update(whole, measurements, chunk=10**6)
    correction = kalman.update(parts, measurements, chunk=chunk)
    np.testing.assert_allclose(correction.delta / np.sqrt(np.diag(P)), expected.delta / np.sqrt(np.diag(P)), atol=1e-10)
    assert_covariances_equal(symmetric.full(parts), symmetric.full(whole), 1e-10)
    assert correction.nis == pytest.approx(expected.nis, rel=1e-10)
    assert correction.dof == expected.dof


def test_the_order_of_the_measurements_does_not_change_the_result() -> None:
    rng = RNG(4)
    P = random_covariance(rng, 12 + 3 * 40)
    measurements = random_measurements(rng, 45, 3, 40)
    first, second = lower(P), lower(P)
    one = kalman.update(first, measurements)
    other = kalman.update(second, measurements[rng.permutation(45)])
    np.testing.assert_allclose(one.delta, other.delta, atol=1e-10)
    np.testing.assert_allclose(symmetric.full(first), symmetric.full(second), atol=1e-10)


def test_p_is_updated_in_place_and_only_its_lower_triangle_is_read() -> None:
    rng = RNG(5)
    P = random_covariance(rng, 24)
    kept = lower(P)
    kalman.update(kept, random_measurements(rng, 4, 3, 4))
    assert np.isfinite(np.tril(kept)).all()
    assert (np.diag(kept) < np.diag(P)).any()


def test_no_measurement_changes_nothing() -> None:
    P = lower(random_covariance(RNG(6), 18))
    before = P.copy()
    correction = kalman.update(P, random_measurements(RNG(6), 3, 3, 2)[:0])
    np.testing.assert_array_equal(P, before)
    assert not correction.delta.any()
    assert (correction.nis, correction.dof, len(correction.used)) == (0.0, 0, 0)


def test_innovation_covariances_are_the_blocks_of_the_dense_one() -> None:
    rng = RNG(7)
    P = random_covariance(rng, 12 + 3 * 6)
    measurements = random_measurements(rng, 5, 3, 6)
    _, H, R = dense(measurements, len(P))
    S = (H @ P @ H.T + R).reshape(5, 3, 5, 3)[np.arange(5), :, np.arange(5), :]
    np.testing.assert_allclose(measurements.innovation_covariances(lower(P)), S, rtol=1e-10)


def test_times_is_the_dense_product() -> None:
    rng = RNG(8)
    measurements, delta = random_measurements(rng, 5, 3, 6), rng.standard_normal(30)
    _, H, _ = dense(measurements, 30)
    np.testing.assert_allclose(measurements.times(delta).ravel(), H @ delta, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("chunk", [1, 3, 20])
def test_a_measurement_without_a_cholesky_factor_is_left_out_alone(chunk: int) -> None:
    """The others count as if it had not been there, P stays positive definite, nothing is raised."""
    rng = RNG(10)
    P = random_covariance(rng, 12 + 3 * 9)
    measurements = random_measurements(rng, 9, 3, 9)
    broken = replace(measurements, R=measurements.R.copy())
    broken.R[4] = -1e6 * np.eye(3)
    others = np.arange(9) != 4
    updated, expected = lower(P), lower(P)
    correction = kalman.update(updated, broken, chunk=chunk)
    good = kalman.update(expected, measurements[others], chunk=chunk)
    np.testing.assert_array_equal(correction.used, others)
    assert correction.dof == good.dof == 24
    assert correction.nis == pytest.approx(good.nis, rel=1e-10)
    np.testing.assert_allclose(correction.delta, good.delta, atol=1e-10)
    assert_covariances_equal(symmetric.full(updated), symmetric.full(expected), 1e-10)
    assert np.linalg.eigvalsh(symmetric.full(updated)).min() > 0


def test_a_landmark_in_the_image_plane_is_left_out_before_rounding_makes_p_indefinite() -> None:
    """Its pixel would be predicted to 1e9 sigmas of R: 1e-16 of that, squared, is a hundred R."""
    rng = RNG(12)
    P = random_covariance(rng, 12 + 3 * 9)
    measurements = random_measurements(rng, 9, 3, 9)
    measurements.by_leading[4] *= 1e9
    measurements.by_map[4] *= 1e9
    updated = lower(P)
    correction = kalman.update(updated, measurements)
    np.testing.assert_array_equal(correction.used, np.arange(9) != 4)
    assert np.linalg.eigvalsh(symmetric.full(updated)).min() > 0


def test_a_measurement_of_the_camera_may_be_exact() -> None:
    P = random_covariance(RNG(13), 12)
    updated = lower(P)
    exact = LinearMeasurement(np.ones(3), np.eye(3, 12), np.zeros((3, 3)))
    correction = kalman.update(updated, of_variables(exact, np.arange(12), 12))
    np.testing.assert_allclose(correction.delta[:3], 1.0)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_jacobian_that_is_not_finite_is_left_out(value: float) -> None:
    rng = RNG(11)
    P = random_covariance(rng, 24)
    measurements = random_measurements(rng, 2, 3, 4)
    measurements.by_leading[1, 2, 3] = value
    updated = lower(P)
    with np.errstate(invalid="ignore"):
        correction = kalman.update(updated, measurements, chunk=1)
    np.testing.assert_array_equal(correction.used, [True, False])
    assert np.isfinite(correction.delta).all()
    assert np.isfinite(np.tril(updated)).all()


@pytest.mark.parametrize("rows", [2, 3, 4])
def test_a_change_of_measurement_coordinates_changes_nothing(rows: int) -> None:
    """Z' = T z with R' = T R T^T is the same measurement: same correction, same P, same NIS."""
    rng = RNG(12)
    P = random_covariance(rng, 12 + 3 * 12)
    measurements = random_measurements(rng, 30, rows, 12)
    T = rng.standard_normal((rows, rows)) + 2 * np.eye(rows)
    transformed = LinearisedMeasurements(
        measurements.innovation @ T.T,
        T @ measurements.by_leading,
        T @ measurements.by_map,
        measurements.map_rows,
        T @ measurements.R @ T.T,
    )
    first, second = lower(P), lower(P)
    one, other = kalman.update(first, measurements), kalman.update(second, transformed)
    np.testing.assert_allclose(one.delta, other.delta, atol=1e-9)
    assert_covariances_equal(symmetric.full(first), symmetric.full(second), 1e-9)
    assert one.nis == pytest.approx(other.nis, rel=1e-9)


def test_independent_parts_of_a_measurement_may_come_one_after_the_other() -> None:
    """Left then right, linearised once, is left and right together if their errors are independent."""
    rng = RNG(13)
    P = random_covariance(rng, 12 + 3 * 12)
    together = random_measurements(rng, 30, 4, 12)
    together.R[:, :2, 2:] = together.R[:, 2:, :2] = 0.0
    at_once, in_turn = lower(P), lower(P)
    expected = kalman.update(at_once, together)
    halves = [
        LinearisedMeasurements(
            together.innovation[:, part],
            together.by_leading[:, part],
            together.by_map[:, part],
            together.map_rows,
            together.R[:, part, part],
        )
        for part in (slice(0, 2), slice(2, 4))
    ]
    first = kalman.update(in_turn, halves[0])
    second = kalman.update(in_turn, replace(halves[1], innovation=halves[1].innovation - halves[1].times(first.delta)))
    np.testing.assert_allclose(first.delta + second.delta, expected.delta, atol=1e-10)
    assert_covariances_equal(symmetric.full(in_turn), symmetric.full(at_once), 1e-10)
    assert first.nis + second.nis == pytest.approx(expected.nis, rel=1e-9)
