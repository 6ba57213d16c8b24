"""The chi-square gate."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from filters.validation import BoolArray, FloatArray


@lru_cache
def gate_limit(probability: float, degrees_of_freedom: int) -> float:
    """Squared Mahalanobis distance that a consistent innovation stays below with `probability`."""
    return float(chdtri(degrees_of_freedom, 1.0 - probability))


def passes(innovations: FloatArray, S: FloatArray, limit: float) -> BoolArray:
    """Whether each nu^T S^-1 nu is within the limit; (M, k), (M, k, k) -> (M,)."""
    solved = np.linalg.solve(S, innovations[:, :, None])[:, :, 0]
    inside: BoolArray = np.einsum("mk,mk->m", innovations, solved) <= limit
    return inside
