"""Symmetric matrices of which only the lower triangle is kept up to date (column-major, as BLAS wants it)."""

from __future__ import annotations

import numpy as np

from filters.validation import FloatArray, IntArray


def rows(P: FloatArray, index: IntArray) -> FloatArray:
    """Full rows `index` of the symmetric matrix; (n, n), (k,) -> (k, n)."""
    taken: FloatArray = P[index]
    np.copyto(taken, P[:, index].T, where=np.arange(len(P)) > index[:, None])
    return taken


def blocks(P: FloatArray, index: IntArray) -> FloatArray:
    """Symmetric sub-matrices P[index_i, index_i]; (n, n), (M, k) -> (M, k, k)."""
    first, second = index[:, :, None], index[:, None, :]
    taken: FloatArray = P[np.maximum(first, second), np.minimum(first, second)]
    return taken


def keep(P: FloatArray, index: IntArray) -> FloatArray:
    """The sub-matrix of the ascending `index`; marginalises the rest."""
    return P.T.take(index, axis=0).take(index, axis=1).T


def full(P: FloatArray) -> FloatArray:
    """The whole matrix, both triangles."""
    lower = np.tril(P)
    return lower + np.tril(P, -1).T
