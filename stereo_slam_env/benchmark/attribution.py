"""Which choice makes the difference? Effects of the options of a filter, from runs of their combinations.

Every response is a logarithm (of an error, of NEES by its degrees of freedom, of time), so that effects are factors.
The model is additive in the logarithms: seed (a block: a hard recording is hard for all) + main effects + interactions
of two factors, in sum-to-zero coding, by least squares.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from stereo_slam_env.benchmark.statistics import Finding


@dataclass(frozen=True)
class Effect:
    """What a level does against the average of all, or two levels together beyond what each does alone.

    Attributes
    ----------
    factors : tuple of str
        One name (a main effect) or two (an interaction).
    levels : tuple
        The level of each.
    percent : float
        By how much the response is larger with it, %: +100 doubles it.
    interval_percent : pair of float, optional
        Its confidence interval, corrected for the number of such effects; None with too few seeds.
    shown : bool
        Whether the runs show that there is any effect.
    """

    factors: tuple[str, ...]
    levels: tuple[Any, ...]
    percent: float
    interval_percent: tuple[float, float] | None
    shown: bool


@dataclass(frozen=True)
class Contrast:
    """One level of a factor instead of its first one, all else being averaged over.

    Attributes
    ----------
    factor : str
        Name.
    level, instead_of : value
        The two levels.
    percent : float
        By how much the response is larger, %.
    interval_percent : pair of float, optional
        Its confidence interval, corrected for the number of contrasts; None with too few seeds.
    p_value : float
        Of the signed-rank test over seeds, corrected in the same way.
    finding : Finding
        Whether the response is shown to be better (smaller), worse, or neither.
    words : str
        One clause.
    """

    factor: str
    level: Any
    instead_of: Any
    percent: float
    interval_percent: tuple[float, float] | None
    p_value: float
    finding: Finding
    words: str


@dataclass(frozen=True)
class Share:
    """How much of the variance between combinations, on the same seed, a factor or an interaction explains.

    Attributes
    ----------
    factors : tuple of str
        One name, two for an interaction, none for the rest.
    percent : float
        Of the variance of the logarithms, %.
    """

    factors: tuple[str, ...]
    percent: float


@dataclass(frozen=True)
class ResponseAttribution:
    """The effects on one response.

    Attributes
    ----------
    response : str
        Its name: "position error", "pose NEES / 6", "time".
    unit : str
        Of `mean`: "m", "", "ms".
    mean : float
        Geometric mean over combinations and seeds, in `unit`.
    effects : tuple of Effect
        Main effects, in the order of factors and levels.
    interactions : tuple of Effect
        Of two factors, those that can be estimated.
    contrasts : tuple of Contrast
        Every level against the first of its factor.
    shares : tuple of Share
        Largest first, the rest last.
    conclusion : str
        One sentence.
    """

    response: str
    unit: str
    mean: float
    effects: tuple[Effect, ...]
    interactions: tuple[Effect, ...]
    contrasts: tuple[Contrast, ...]
    shares: tuple[Share, ...]
    conclusion: str


@dataclass(frozen=True)
class Attribution:
    """Which choice makes the difference, and how much.

    Attributes
    ----------
    factors : mapping of str to tuple
        Levels of every factor, the first one is what the others are held against.
    seeds, combinations : int
        Numbers of them that took part.
    responses : tuple of ResponseAttribution
        One for each response.
    diverged_percent : mapping of (factor, level) to float
        Share of the runs with that level that diverged or failed.
    notes : tuple of str
        What was left out, and why.
    conclusion : str
        A few sentences.
    """

    factors: Mapping[str, tuple[Any, ...]]
    seeds: int
    combinations: int
    responses: tuple[ResponseAttribution, ...]
    diverged_percent: Mapping[tuple[str, Any], float]
    notes: tuple[str, ...]
    conclusion: str
