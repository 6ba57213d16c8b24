"""The chi-square gate, and the outcome of each measurement in an update."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from filters.validation import BoolArray, FloatArray

FateArray = NDArray[np.uint8]
USED, BEHIND, GATED, FAILED = range(4)
"""Outcome of a known landmark's measurement: used, predicted behind the camera, gated, no Cholesky factor of S."""


@lru_cache
def gate_limit(probability: float, degrees_of_freedom: int) -> float:
    """Squared Mahalanobis distance that a consistent innovation stays below with `probability`."""
    return float(chdtri(degrees_of_freedom, 1.0 - probability))


def squared_distances(innovations: FloatArray, S: FloatArray) -> FloatArray:
    """nu^T S^-1 nu of each; (M, k), (M, k, k) -> (M,)."""
    solved = np.linalg.solve(S, innovations[:, :, None])[:, :, 0]
    distances: FloatArray = np.einsum("mk,mk->m", innovations, solved)
    return distances


def passes(innovations: FloatArray, S: FloatArray, limit: float) -> BoolArray:
    """Whether each innovation lies inside the gate; (M, k), (M, k, k) -> (M,)."""
    if len(innovations) == 0:
        return np.zeros(0, dtype=bool)
    inside: BoolArray = squared_distances(innovations, S) <= limit
    return inside
