"""The chi-square gate."""

from __future__ import annotations

from functools import lru_cache

from scipy.special import chdtri


@lru_cache
def gate_limit(probability: float, degrees_of_freedom: int) -> float:
    """Squared Mahalanobis distance that a consistent innovation stays below with `probability`."""
    return float(chdtri(degrees_of_freedom, 1.0 - probability))
