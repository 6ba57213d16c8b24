"""The decision rule: from measured numbers to what may be said about a claim.

Every claim is made measurable: a quantity, and the range in which it must lie if the claim is true. A quantity is
measured under several conditions, each time with a 95 % confidence interval.

- One condition (`Finding`): the claim *holds* if the whole interval lies in the range, *does not hold* if the whole
  interval lies outside, and is *not shown* where the interval crosses a limit of the range, or there is no interval.
- The claim (`Claim`): *holds* if it holds under every condition; *holds only if ...* under some of them, which are
  then named; *does not hold* if it holds under none and is refuted under at least one; else *not shown*.

Nothing else decides. The limits of the ranges are in `limits`, each with its reason.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum


class Verdict(Enum):
    """What may be said."""

    HOLDS = "holds"
    HOLDS_ONLY_IF = "holds only if"
    DOES_NOT_HOLD = "does not hold"
    NOT_SHOWN = "not shown"


@dataclass(frozen=True)
class Interval:
    """A measured value and its 95 % confidence interval; NaN limits: too little data for one."""

    value: float
    low: float
    high: float

    @property
    def known(self) -> bool:
        """Whether value and limits are numbers; a limit may be infinite."""
        return not any(map(math.isnan, (self.value, self.low, self.high)))


@dataclass(frozen=True)
class Range:
    """Where a quantity must lie: from `low` to `high`, both included."""

    low: float = -math.inf
    high: float = math.inf

    def __str__(self) -> str:
        if self.low == self.high:
            return f"{self.low:g}"
        if self.low == -math.inf:
            return f"at most {self.high:.4g}"
        if self.high == math.inf:
            return f"at least {self.low:.4g}"
        return f"{self.low:.4g} to {self.high:.4g}"


def decide(measured: Interval, asked: Range) -> Verdict:
    """The rule for one condition.

    Parameters
    ----------
    measured : Interval
        What was measured.
    asked : Range
        Where it must lie if the claim is true.
    """
    if not measured.known:
        return Verdict.NOT_SHOWN
    if asked.low <= measured.low and measured.high <= asked.high:
        return Verdict.HOLDS
    if measured.high < asked.low or measured.low > asked.high:
        return Verdict.DOES_NOT_HOLD
    return Verdict.NOT_SHOWN


@dataclass(frozen=True)
class Finding:
    """A claim under one condition.

    Attributes
    ----------
    condition : mapping of str to str
        Factor -> level, e.g. {"noise": "pixels independent", "R": "full"}; the same factors in all of a claim.
    measured : Interval
        The quantity.
    asked : Range
        Where it must lie if the claim is true.
    """

    condition: Mapping[str, str]
    measured: Interval
    asked: Range

    @property
    def verdict(self) -> Verdict:
        """By `decide`."""
        return decide(self.measured, self.asked)


@dataclass(frozen=True)
class Sentence:
    """Something the paper says that can be checked.

    Attributes
    ----------
    key : str
        Short, unique.
    section : str
        Of the paper.
    claim : str
        What the paper says.
    statement : str
        What is measured, and when that counts as true.
    evidence : str
        Name of the figure that it is shown with.
    """

    key: str
    section: str
    claim: str
    statement: str
    evidence: str


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, and what was found about it: one finding a condition."""

    sentence: Sentence
    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> Verdict:
        """By the rule of this module."""
        found = {finding.verdict for finding in self.findings}
        if found == {Verdict.HOLDS}:
            return Verdict.HOLDS
        if Verdict.HOLDS in found:
            return Verdict.HOLDS_ONLY_IF
        return Verdict.DOES_NOT_HOLD if Verdict.DOES_NOT_HOLD in found else Verdict.NOT_SHOWN

    @property
    def says(self) -> str:
        """The verdict in words: under which conditions it holds, and how many of them show nothing."""
        words = str(self.verdict.value)
        every = [finding.condition for finding in self.findings]
        if self.verdict is Verdict.HOLDS_ONLY_IF:
            holding = [finding.condition for finding in self.findings if finding.verdict is Verdict.HOLDS]
            words = f"{words} {describe(holding, every)}"
        open_ = sum(finding.verdict is Verdict.NOT_SHOWN for finding in self.findings)
        if 0 < open_ < len(every):
            words = f"{words} (not shown under {open_} of {len(every)} conditions)"
        return words


def describe(chosen: Sequence[Mapping[str, str]], every: Sequence[Mapping[str, str]]) -> str:
    """Name those conditions among all, exactly and in few words.

    Conditions that are all those with certain levels of some factors are named by these levels; others are split by
    the levels of a factor until they are.

    Parameters
    ----------
    chosen, every : sequence of mappings
        Factor -> level, each combination at most once.
    """
    return "; or ".join(_terms(list(chosen), every))


def _terms(chosen: list[Mapping[str, str]], every: Sequence[Mapping[str, str]]) -> list[str]:
    levels = {factor: list(dict.fromkeys(c[factor] for c in chosen)) for factor in every[0]}
    if sum(all(c[factor] in named for factor, named in levels.items()) for c in every) == len(chosen):
        telling = {
            factor: " or ".join(named)
            for factor, named in levels.items()
            if len(named) < len({condition[factor] for condition in every})
        }
        return [", ".join(f"{factor}: {named}" for factor, named in telling.items())]
    splits = (
        [term for level in named for term in _terms([c for c in chosen if c[factor] == level], every)]
        for factor, named in levels.items()
        if len(named) > 1
    )
    fewest: list[str] = min(splits, key=len)
    return fewest
