"""Symmetric matrices stored in their lower triangle (column-major, as in BLAS)."""

from __future__ import annotations

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray


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
    index = np.arange(len(P))
    return np.where(index[:, None] >= index, P, P.T)
