"""Symmetric matrices of which only the lower triangle is kept up to date (column-major, as BLAS wants it)."""

from __future__ import annotations

import numpy as np

from filters.validation import FloatArray, IntArray


def rows(P: FloatArray, index: IntArray) -> FloatArray:
    """Full rows `index` of the symmetric matrix; (n, n), (k,) -> (k, n)."""
    below = np.arange(len(P)) <= index[:, None]
    return np.where(below, P[index], P[:, index].T)


def blocks(P: FloatArray, index: IntArray) -> FloatArray:
    """Symmetric sub-matrices P[index_i, index_i]; (n, n), (M, k) -> (M, k, k)."""
    first, second = index[:, :, None], index[:, None, :]
    taken: FloatArray = P[np.maximum(first, second), np.minimum(first, second)]
    return taken


def keep(P: FloatArray, index: IntArray) -> FloatArray:
    """The sub-matrix of the ascending `index`; marginalises the rest."""
    return np.asfortranarray(P[np.ix_(index, index)])


def full(P: FloatArray) -> FloatArray:
    """The whole matrix, both triangles."""
    lower = np.tril(P)
    return lower + np.tril(P, -1).T
