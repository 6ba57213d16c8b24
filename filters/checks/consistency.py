"""Normalised estimation error squared (NEES), its quantiles, and the test whether what is claimed is a covariance."""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from filters.geometry.arrays import BoolArray, FloatArray

ROUNDING = 1e-9
"""By so much of its size a covariance may be asymmetric, or semi-definite from the wrong side."""
NEGLIGIBLE = 1e-12
"""Variance (SI units) of a quantity that is known: 1e-6 squared. What is less below zero is rounding, too."""
LEAST_CORRELATION = 1e-14
"""Smallest eigenvalue of a correlation that is not rounding; those of the filters of this package are above 1e-2."""
CLEARLY = 1e-6
"""Determinant of a correlation far from any rounding."""
_SMALLEST = 1e-300


def nees(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Normalised estimation error squared e^T P^-1 e (Bar-Shalom, Li and Kirubarajan, 2001, ch. 5.4).

    Parameters
    ----------
    errors : (..., n) ndarray
        Estimation errors.
    covariances : (..., n, n) ndarray
        What the filter claims for them.

    Returns
    -------
    (...) ndarray
        NaN where the covariance is not symmetric positive definite or something is not finite.
    """
    errors, covariances = np.asarray(errors), np.asarray(covariances)
    usable = np.isfinite(errors).all(axis=-1) & are_definite(covariances)
    values = np.full(errors.shape[:-1], np.nan)
    solved = np.linalg.solve(covariances[usable], errors[usable][..., None])[..., 0]
    values[usable] = np.sum(errors[usable] * solved, axis=-1)
    return values


def chi_square_quantile(probability: float, dof: int) -> float:
    """Value that the NEES of a consistent filter stays below with `probability`.

    That of `scipy.stats.chi2.ppf`, to the bit, without `scipy.stats`, whose import takes as long as all others.
    """
    return float(2.0 * gammaincinv(dof / 2, probability))


def are_definite(covariances: FloatArray) -> BoolArray:
    """Which of (..., n, n) are finite, symmetric and positive definite, whatever the units of their rows; (...)."""
    usable = np.asarray(np.isfinite(covariances).all(axis=(-2, -1)))
    usable[usable] = _asymmetry(covariances[usable]) <= ROUNDING
    open_ones = usable & ~_are_clearly_definite(covariances)
    usable[open_ones] = _least_correlation(covariances[open_ones]) > LEAST_CORRELATION
    return usable


def _are_clearly_definite(covariances: FloatArray) -> BoolArray:
    """Which of (..., 3, 3) are definite beyond doubt, by the determinant of their correlation, (...).

    There are many of them, and eigenvalues take long. Those of a correlation add up to 3, so that the smallest is at
    least det / 2.25. Of matrices of another size none is told.
    """
    if covariances.shape[-1] != 3:
        return np.zeros(covariances.shape[:-2], dtype=np.bool_)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        sigmas = np.sqrt(np.diagonal(covariances, axis1=-2, axis2=-1))
        x, y, z = (covariances[..., i, j] / (sigmas[..., i] * sigmas[..., j]) for i, j in ((1, 0), (2, 0), (2, 1)))
        determinant = 1.0 + 2.0 * x * y * z - x * x - y * y - z * z
        found: BoolArray = (np.abs(x) < 1.0) & (determinant > CLEARLY)
    return found


def fault_of(covariance: FloatArray, *, definite: bool = True) -> str | None:
    """What keeps (n, n) from being a covariance, or an example of (K, n, n), in words; None where nothing does.

    With `definite` False, a semi-definite one will do, such as that of a velocity that odometry without errors states.
    """
    if not np.isfinite(covariance).all():
        return "is not finite"
    if covariance.size == 0:
        return None
    asymmetry = float(_asymmetry(covariance).max())
    if asymmetry > ROUNDING:
        return f"is not symmetric (by {asymmetry:.2g} of its largest entry)"
    smallest = float(_least_correlation(covariance).min())
    if definite and not smallest > LEAST_CORRELATION:
        return f"is not positive definite (smallest eigenvalue, scaled to unit variances: {smallest:.2g})"
    if smallest < -ROUNDING and (smallest := float(np.linalg.eigvalsh(covariance).min())) < -NEGLIGIBLE:
        return f"is not positive semi-definite (smallest eigenvalue {smallest:.2g})"
    return None


def _asymmetry(covariances: FloatArray) -> FloatArray:
    """Largest difference of each from its transpose, by its largest entry."""
    largest = np.abs(covariances).max(axis=(-2, -1), initial=_SMALLEST)
    apart = np.abs(covariances - np.swapaxes(covariances, -1, -2)).max(axis=(-2, -1), initial=0.0)
    return np.asarray(apart / largest, dtype=np.float64)


def _least_correlation(covariances: FloatArray) -> FloatArray:
    """Smallest eigenvalue of each, scaled to unit variances, so that metres and radians compare; <= 0 where one is 0.

    A variance of 0 or less is taken as it is: its row is not scaled.
    """
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)
    sigmas = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    eigenvalues = np.linalg.eigvalsh(covariances / sigmas[..., :, None] / sigmas[..., None, :])
    return np.asarray(eigenvalues[..., 0], dtype=np.float64)
