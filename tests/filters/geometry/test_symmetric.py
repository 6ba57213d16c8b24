"""Symmetric matrices of which only the lower triangle counts."""

from __future__ import annotations

import numpy as np
import pytest

from filters.geometry import symmetric


@pytest.fixture
def whole() -> np.ndarray:
    root = np.random.default_rng(0).standard_normal((7, 7))
    return root + root.T


@pytest.fixture
def lower(whole: np.ndarray) -> np.ndarray:
    """With rubbish above the diagonal."""
    return np.asfortranarray(np.tril(whole) + np.triu(np.full_like(whole, np.nan), 1))


def test_full_restores_both_triangles(whole: np.ndarray, lower: np.ndarray) -> None:
    np.testing.assert_array_equal(symmetric.full(np.tril(lower)), whole)


def test_rows_reads_the_lower_triangle_only(whole: np.ndarray, lower: np.ndarray) -> None:
    index = np.array([0, 6, 3, 3])
    np.testing.assert_array_equal(symmetric.rows(lower, index), whole[index])


def test_blocks_reads_the_lower_triangle_only(whole: np.ndarray, lower: np.ndarray) -> None:
    index = np.array([[0, 5, 2], [6, 1, 1]])
    expected = np.stack([whole[np.ix_(i, i)] for i in index])
    np.testing.assert_array_equal(symmetric.blocks(lower, index), expected)


def test_keep_marginalises_and_stays_column_major(whole: np.ndarray, lower: np.ndarray) -> None:
    index = np.array([1, 2, 5])
    kept = symmetric.keep(lower, index)
    assert kept.flags.f_contiguous
    np.testing.assert_array_equal(np.tril(kept), np.tril(whole[np.ix_(index, index)]))
