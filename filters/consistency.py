"""Normalised estimation error squared (NEES)."""

from __future__ import annotations

import numpy as np

from filters.validation import FloatArray


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
        NaN where the covariance is not positive definite or something is not finite.
    """
    errors, covariances = np.asarray(errors), np.asarray(covariances)
    usable = np.array(np.isfinite(errors).all(axis=-1) & np.isfinite(covariances).all(axis=(-2, -1)))
    usable[usable] = np.linalg.eigvalsh(covariances[usable])[..., 0] > 0
    values = np.full(errors.shape[:-1], np.nan)
    solved = np.linalg.solve(covariances[usable], errors[usable][..., None])[..., 0]
    values[usable] = np.sum(errors[usable] * solved, axis=-1)
    return values
