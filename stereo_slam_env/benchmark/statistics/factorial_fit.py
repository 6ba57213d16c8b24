"""Least squares for a factorial experiment in blocks: effects, block by block, and the variance they explain.

The model: value = block + main effects + interactions of two factors; the effects of a factor sum to zero.
Within a block values are taken about their mean, so that blocks drop out. With all values there, an effect is the mean
over blocks of the effect in each; with some missing, it is that of all of them together, and what stands for a single
block is its share in it (its pseudo-value, the influence of the block).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from filters.validation import FloatArray, IntArray

Term = tuple[int, ...]
"""Numbers of the factors: one of a main effect, two of an interaction."""


@dataclass(frozen=True, eq=False)
class FactorialFit:
    """What a fit found.

    Attributes
    ----------
    blocks : mapping of Term to (S, *levels) ndarray
        The effect of each level, or pair of levels, block by block; the estimate is the mean over blocks.
    shares : mapping of Term to float
        Share of the variance within blocks that a term explains beyond all others, 0 to 1.
    rest : float
        Share that no term explains.
    left_out : tuple of Term
        Interactions that cannot be told from other terms, because combinations are missing.
    """

    blocks: dict[Term, FloatArray]
    shares: dict[Term, float]
    rest: float
    left_out: tuple[Term, ...]


def fit_factorial(values: FloatArray) -> FactorialFit:
    """Fit main effects and the interactions of two factors that can be estimated.

    Parameters
    ----------
    values : (*levels, S) ndarray
        One value for each combination of levels and each block; NaN where missing. Blocks without two values are left
        out.

    Raises
    ------
    ValueError
        What is missing leaves main effects that cannot be told apart.
    """
    levels = values.shape[:-1]
    rows = values.reshape(-1, values.shape[-1]).T
    rows = rows[np.isfinite(rows).sum(axis=1) >= 2]
    mains = [(i,) for i in range(len(levels))]
    designs = {term: _columns(term, levels) for term in [*mains, *combinations(range(len(levels)), 2)]}
    gram = _gram(rows, np.hstack(list(designs.values())))
    kept: list[Term] = []
    places = _places(designs)
    for term in designs:
        columns = np.concatenate([places[t] for t in [*kept, term]])
        if np.linalg.matrix_rank(gram[np.ix_(columns, columns)], hermitian=True) == len(columns):
            kept.append(term)
        elif len(term) == 1:
            raise ValueError("too many combinations are missing: the effects of the factors cannot be told apart")
    used = {term: designs[term] for term in kept}
    coefficients, residual = _solve(rows, np.hstack(list(used.values())))
    places = _places(used)
    total = float(np.nansum((rows - np.nanmean(rows, axis=1, keepdims=True)) ** 2))
    shares = {}
    for term in kept:
        others = [design for other, design in used.items() if other != term]
        without = _solve(rows, np.hstack(others))[1] if others else total
        shares[term] = (without - residual) / total if total > 0.0 else 0.0
    return FactorialFit(
        blocks={term: _effects(coefficients[:, places[term]], term, levels) for term in kept},
        shares=shares,
        rest=residual / total if total > 0.0 else 0.0,
        left_out=tuple(term for term in designs if term not in kept),
    )


def _coding(count: int) -> FloatArray:
    """Effects of `count` levels from count - 1 coefficients: the last one is minus the sum of the others."""
    return np.vstack([np.eye(count - 1), -np.ones(count - 1)])


def _columns(term: Term, levels: Sequence[int]) -> FloatArray:
    """Design of a term, one row a combination."""
    every = np.array(list(product(*map(range, levels))))
    columns: FloatArray = np.ones((len(every), 1))
    for i in term:
        columns = np.einsum("cp,cq->cpq", columns, _coding(levels[i])[every[:, i]]).reshape(len(every), -1)
    return columns


def _effects(coefficients: FloatArray, term: Term, levels: Sequence[int]) -> FloatArray:
    """Effects (S, *levels of the term) from coefficients (S, p)."""
    table: FloatArray = np.ones((1, 1))
    for i in term:
        table = np.asarray(np.kron(table, _coding(levels[i])), dtype=np.float64)
    return (coefficients @ table.T).reshape(len(coefficients), *(levels[i] for i in term))


def _places(designs: dict[Term, FloatArray]) -> dict[Term, IntArray]:
    """Which columns of all designs side by side belong to each term."""
    ends = np.cumsum([design.shape[1] for design in designs.values()])
    return {
        term: np.arange(end - design.shape[1], end) for (term, design), end in zip(designs.items(), ends, strict=True)
    }


def _centred(rows: FloatArray, design: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values (S, C) and designs (S, C, p) about their means within each block; 0 where missing."""
    known = np.isfinite(rows)
    counts = known.sum(axis=1, keepdims=True)
    values = np.where(known, rows - np.nanmean(rows, axis=1, keepdims=True), 0.0)
    means = (known @ design) / counts
    return values, np.where(known[:, :, None], design[None] - means[:, None, :], 0.0)


def _gram(rows: FloatArray, design: FloatArray) -> FloatArray:
    _, centred = _centred(rows, design)
    return np.asarray(np.einsum("scp,scq->pq", centred, centred))


def _solve(rows: FloatArray, design: FloatArray) -> tuple[FloatArray, float]:
    """Pseudo-values of the coefficients (S, p), whose mean is the solution, and the sum of squares that is left."""
    values, centred = _centred(rows, design)
    grams = np.einsum("scp,scq->spq", centred, centred)
    rights = np.einsum("scp,sc->sp", centred, values)
    gram = grams.sum(axis=0)
    solution = np.linalg.solve(gram, rights.sum(axis=0))
    scores = rights - grams @ solution
    residual = float(np.sum((values - centred @ solution) ** 2))
    return solution + len(rows) * np.linalg.solve(gram, scores.T).T, residual
