"""Effects of the factors of an experiment on one response: estimates, intervals, shares of variance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.benchmark.statistics.differences import Difference, Finding, differences_of
from stereo_slam_env.benchmark.statistics.sentences import sentence

Term = tuple[int, ...]
"""Numbers of the factors: one of a main effect, two of an interaction."""


_WORTH_WORDS = 1.0
"""An interaction that explains less of the variance, %, is not put into words."""


@dataclass(frozen=True, eq=False)
class Response:
    """Response of an experiment: the values that the factors explain."""

    logarithms: FloatArray  # (*levels, S): one for each combination and each seed; NaN where there is none
    unit: str = ""  # of the value itself; may be empty
    ideal: float | None = None  # the value that is best; None: the smaller the better


@dataclass(frozen=True)
class Effect:
    """Effect of a level against the average of all, or of two levels together beyond what each does alone."""

    factors: tuple[str, ...]  # one name (a main effect) or two (an interaction)
    levels: tuple[Any, ...]  # the level of each
    difference: Difference  # of the logarithm, corrected for the number of such effects


@dataclass(frozen=True)
class Contrast:
    """One level of a factor instead of its first one, all else being averaged over."""

    factor: str
    level: Any
    instead_of: Any
    difference: Difference  # of the logarithm, corrected for the number of contrasts
    finding: Finding  # whether the response is shown to be better (smaller, or nearer to its ideal), worse, or neither


@dataclass(frozen=True)
class ResponseAttribution:
    """The effects on one response."""

    response: str  # its name: "position error", "pose NEES / 6", "time"
    unit: str  # of `mean`: "m", "", "ms"
    mean: float  # geometric mean over combinations and seeds, in `unit`
    effects: tuple[Effect, ...]  # main effects, in the order of factors and levels
    interactions: tuple[Effect, ...]  # of two factors, those that can be estimated: beyond what each does alone
    contrasts: tuple[Contrast, ...]  # every level against the first of its factor
    # Share of the variance between combinations, on the same seed, that a factor or two together explain, %: by their
    # names, largest first; of none of them, (), last.
    shares: Mapping[tuple[str, ...], float]

    @property
    def conclusion(self) -> str:
        """A sentence on the factors, by the variance they explain, and on strong interactions."""
        return sentence("effects", self)

    @property
    def contrasts_by_factor(self) -> dict[str, list[Contrast]]:
        """Contrasts of each factor, that with the largest share of the variance first."""
        mains = [names[0] for names in self.shares if len(names) == 1]
        return {factor: [c for c in self.contrasts if c.factor == factor] for factor in mains}

    @property
    def together(self) -> list[tuple[str, ...]]:
        """Pairs of factors with an interaction that is shown, and worth words."""
        significant = {effect.factors for effect in self.interactions if effect.difference.shown}
        return sorted(names for names in significant if self.shares[names] >= _WORTH_WORDS)


def explain(
    name: str, response: Response, factors: Mapping[str, Sequence[Any]]
) -> tuple[ResponseAttribution, tuple[Term, ...]]:
    """Effects on a response, and the interactions that cannot be estimated (numbers of the factors).

    `factors` has names and levels, at least two each, in the order of the axes. Raises as `fit_factorial`.
    """
    fit = fit_factorial(response.logarithms)
    names = list(factors)
    effects, interactions = (
        _effects({term: blocks for term, blocks in fit.blocks.items() if len(term) == size}, factors) for size in (1, 2)
    )
    contrasts = _contrasts(response, factors, fit)
    by_share = sorted(fit.shares.items(), key=lambda item: -item[1])
    shares = {tuple(names[i] for i in term): 100.0 * share for term, share in by_share}
    attribution = ResponseAttribution(
        response=name,
        unit=response.unit,
        mean=float(np.exp(np.nanmean(response.logarithms))),
        effects=effects,
        interactions=interactions,
        contrasts=contrasts,
        shares={**shares, (): 100.0 * fit.rest},
    )
    return attribution, fit.left_out


def _effects(blocks: Mapping[Term, FloatArray], factors: Mapping[str, Sequence[Any]]) -> tuple[Effect, ...]:
    """Effects of all terms of one kind; two levels have one effect with two signs."""
    names, levels = list(factors), list(factors.values())
    comparisons = sum(int(np.prod([n if n > 2 else 1 for n in found.shape[1:]])) for found in blocks.values())
    return tuple(
        Effect(tuple(names[i] for i in term), combination, difference)
        for term, found in blocks.items()
        for combination, difference in zip(
            product(*(levels[i] for i in term)),
            differences_of(found.reshape(len(found), -1), comparisons=comparisons),
            strict=True,
        )
    )


def _contrasts(response: Response, factors: Mapping[str, Sequence[Any]], fit: FactorialFit) -> tuple[Contrast, ...]:
    comparisons = sum(len(levels) - 1 for levels in factors.values())
    contrasts = []
    for i, (factor, levels) in enumerate(factors.items()):
        blocks = fit.blocks[(i,)]
        differences = differences_of(blocks[:, 1:] - blocks[:, :1], comparisons=comparisons)
        at = float(np.nanmean(response.logarithms)) + blocks.mean(axis=0)
        for k, d in enumerate(differences, start=1):
            finding = d.finding
            if d.shown and response.ideal is not None:
                ideal = np.log(response.ideal)
                finding = Finding.BETTER if abs(at[k] - ideal) < abs(at[0] - ideal) else Finding.WORSE
            contrasts.append(Contrast(factor, levels[k], levels[0], d, finding))
    return tuple(contrasts)


# ---- least squares ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FactorialFit:
    """Result of a fit: effects, and the variance they explain."""

    # The effect of each level, or pair of levels, block by block; the estimate is the mean over blocks.
    blocks: dict[Term, FloatArray]
    shares: dict[Term, float]  # share of the variance within blocks that a term explains beyond all others, 0 to 1
    rest: float  # share that no term explains
    left_out: tuple[Term, ...]  # interactions that cannot be told from other terms, because combinations are missing


def fit_factorial(values: FloatArray) -> FactorialFit:
    """Fit main effects and the interactions of two factors that can be estimated.

    `values` (*levels, S) has one value for each combination of levels and each block, NaN where missing; blocks without
    two values are left out. Raises a `ValueError` where what is missing leaves main effects that cannot be told apart.
    """
    levels = values.shape[:-1]
    rows = values.reshape(-1, values.shape[-1]).T
    rows = rows[np.isfinite(rows).sum(axis=1) >= 2]
    mains = [(i,) for i in range(len(levels))]
    designs = {term: _columns(term, levels) for term in [*mains, *combinations(range(len(levels)), 2)]}
    values, centred = _centred(rows, np.hstack(list(designs.values())))
    places = _places(designs)

    def columns(terms: Sequence[Term]) -> FloatArray:
        return centred[:, :, np.concatenate([places[term] for term in terms])]

    kept_terms: list[Term] = []
    for term in designs:
        tried = columns([*kept_terms, term])
        gram = np.einsum("scp,scq->pq", tried, tried)
        if np.linalg.matrix_rank(gram, hermitian=True) == len(gram):
            kept_terms.append(term)
        elif len(term) == 1:
            raise ValueError("too many combinations are missing: the effects of the factors cannot be told apart")
    coefficients, residual = _solve(values, columns(kept_terms))
    total = float(np.sum(values**2))
    shares = {}
    for term in kept_terms:
        other_terms = [other for other in kept_terms if other != term]
        without = _solve(values, columns(other_terms))[1] if other_terms else total
        shares[term] = (without - residual) / total if total > 0.0 else 0.0
    places = _places({term: designs[term] for term in kept_terms})
    return FactorialFit(
        blocks={term: _expanded(coefficients[:, places[term]], term, levels) for term in kept_terms},
        shares=shares,
        rest=residual / total if total > 0.0 else 0.0,
        left_out=tuple(term for term in designs if term not in kept_terms),
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


def _expanded(coefficients: FloatArray, term: Term, levels: Sequence[int]) -> FloatArray:
    """Effects (S, *levels of the term) from coefficients (S, p)."""
    table: FloatArray = np.ones((1, 1))
    for i in term:
        table = np.asarray(np.kron(table, _coding(levels[i])), dtype=np.float64)
    return (coefficients @ table.T).reshape(len(coefficients), *(levels[i] for i in term))


def _places(designs: dict[Term, FloatArray]) -> dict[Term, IntArray]:
    """Columns that belong to each term, of all designs side by side."""
    ends = np.cumsum([design.shape[1] for design in designs.values()])
    return {
        term: np.arange(end - design.shape[1], end) for (term, design), end in zip(designs.items(), ends, strict=True)
    }


def _centred(rows: FloatArray, design: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values (S, C) and designs (S, C, p) about their means within each block; 0 where missing."""
    finite = np.isfinite(rows)
    counts = finite.sum(axis=1, keepdims=True)
    values = np.where(finite, rows - np.nanmean(rows, axis=1, keepdims=True), 0.0)
    means = (finite @ design) / counts
    return values, np.where(finite[:, :, None], design[None] - means[:, None, :], 0.0)


def _solve(values: FloatArray, centred: FloatArray) -> tuple[FloatArray, float]:
    """Pseudo-values of the coefficients (S, p), whose mean is the solution, and the sum of squares that is left."""
    grams = np.einsum("scp,scq->spq", centred, centred)
    rights = np.einsum("scp,sc->sp", centred, values)
    gram = grams.sum(axis=0)
    solution = np.linalg.solve(gram, rights.sum(axis=0))
    scores = rights - grams @ solution
    residual = float(np.sum((values - centred @ solution) ** 2))
    return solution + len(values) * np.linalg.solve(gram, scores.T).T, residual
