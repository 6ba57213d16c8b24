"""Random linear-Gaussian problems in the engine's blocks, and the dense algebra to hold results against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LinearisedMeasurements:
    """M measurements of k rows each, linear in the errors of the first rows and of some blocks."""

    innovation: np.ndarray
    """(M, k)."""
    by_leading: np.ndarray
    """(M, k, c)."""
    by_map: np.ndarray
    """(M, k, w)."""
    map_rows: np.ndarray
    """(M, w): rows that `by_map` is by."""
    R: np.ndarray
    """(M, k, k)."""

    def times(self, delta: np.ndarray) -> np.ndarray:
        """H delta, (M, k)."""
        of_map = np.einsum("mkw,mw->mk", self.by_map, delta[self.map_rows])
        return self.by_leading @ delta[: self.by_leading.shape[2]] + of_map


def random_covariance(rng: np.random.Generator, size: int) -> np.ndarray:
    """Positive definite, with standard deviations over four orders of magnitude, as poses and angles have."""
    root = rng.standard_normal((size, size + 5))
    sigmas = 10 ** rng.uniform(-3, 1, size)
    return sigmas[:, None] * (root @ root.T / size) * sigmas


def random_measurements(
    rng: np.random.Generator, count: int, rows: int, blocks: int, per_landmark: int = 2, camera: int = 6
) -> LinearisedMeasurements:
    """Each landmark depends on the camera and on `per_landmark` blocks of the map, which others may share."""
    chosen = np.stack([rng.choice(blocks, per_landmark, replace=False) for _ in range(count)])
    map_rows = (12 + 3 * chosen[:, :, None] + np.arange(3)).reshape(count, -1)
    root = rng.standard_normal((count, rows, rows))
    return LinearisedMeasurements(
        rng.standard_normal((count, rows)),
        rng.standard_normal((count, rows, camera)),
        rng.standard_normal((count, rows, 3 * per_landmark)),
        map_rows,
        root @ root.transpose(0, 2, 1) + 0.1 * np.eye(rows),
    )


def dense(measurements: LinearisedMeasurements, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The innovation, H and R of all measurements, as full matrices."""
    count, rows = measurements.innovation.shape
    H = np.zeros((count, rows, size))
    H[:, :, : measurements.by_leading.shape[2]] = measurements.by_leading
    R = np.zeros((count * rows, count * rows))
    for i in range(count):
        H[i][:, measurements.map_rows[i]] += measurements.by_map[i]
        R[i * rows : (i + 1) * rows, i * rows : (i + 1) * rows] = measurements.R[i]
    return measurements.innovation.ravel(), H.reshape(-1, size), R


def joseph_update(P: np.ndarray, measurements: LinearisedMeasurements) -> tuple[np.ndarray, np.ndarray, float]:
    """State correction, P and NIS of the Kalman update, Joseph form."""
    nu, H, R = dense(measurements, len(P))
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    I_KH = np.eye(len(P)) - K @ H
    return K @ nu, I_KH @ P @ I_KH.T + K @ R @ K.T, float(nu @ np.linalg.solve(S, nu))


def update(P: np.ndarray, measurements: LinearisedMeasurements) -> np.ndarray:
    """Correct P (lower triangle) in place by the dense Joseph form; gives the correction of the state."""
    whole = np.tril(P) + np.tril(P, -1).T
    delta, corrected, _ = joseph_update(whole, measurements)
    P[...] = corrected
    return delta


def lower(P: np.ndarray) -> np.ndarray:
    """As the engine keeps it: column-major, with rubbish above the diagonal."""
    return np.asfortranarray(np.tril(P) + np.triu(np.full_like(P, np.nan), 1))


def assert_covariances_equal(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    sigmas = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        actual / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), rtol=0, atol=tolerance
    )
