"""The first screen of a report: who is best, by how much, is it sure, how honest, how near the limit, at what cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from stereo_slam_env.benchmark.limits import efficiency_interval
from stereo_slam_env.benchmark.results import FilterSummary
from stereo_slam_env.benchmark.statistics import CONFIDENCE, MIN_PAIRS, Finding
from stereo_slam_env.benchmark.verdict import Comparison, Consistency, Verdict, consistency
from stereo_slam_env.viewer.figures import CSS_VARIABLES
from stereo_slam_env.viewer.page_tables import UNKNOWN, Tone
from stereo_slam_env.viewer.style import filter_colours

_TONES: dict[Consistency, Tone] = {
    Consistency.CONSISTENT: "good",
    Consistency.OVERCONFIDENT: "bad",
    Consistency.CAUTIOUS: "fair",
    Consistency.UNKNOWN: "none",
}


@dataclass(frozen=True)
class _Answer:
    """What one filter has to say to one question: a value, a word on it, and a mark drawn beside them."""

    value: str
    word: str = ""
    tone: Tone = "none"
    mark: str = ""
    key: float | None = None


@dataclass(frozen=True)
class _Question:
    words: str
    measure: str
    answer: Callable[[FilterSummary], _Answer | None]


def overview(summaries: Sequence[FilterSummary], verdict: Verdict) -> str:
    """Headline and answers: a row for each filter, a column for each question that can be answered.

    Parameters
    ----------
    summaries : sequence of FilterSummary
        One for each filter.
    verdict : Verdict
        Of the same filters.

    Returns
    -------
    str
        Markup.
    """
    questions = [
        _Question("Which is best?", "position RMSE", lambda s: _accuracy(s, verdict)),
        _Question("By how much, is it sure?", _against(verdict), lambda s: _difference(s, verdict)),
        _consistency_question(summaries),
        _Question("How far from the limit?", _limit_of(summaries), _efficiency),
        _Question("What does it cost?", "median time a frame", lambda s: _cost(s, summaries)),
    ]
    colours = filter_colours(s.filter_name for s in summaries)
    answers = [[question.answer(summary) for summary in summaries] for question in questions]
    shown = [(q, column) for q, column in zip(questions, answers, strict=True) if any(a is not None for a in column)]
    heads = "".join(f'<th scope="col">{q.words}<small>{escape(q.measure)}</small></th>' for q, _ in shown)
    rows = "".join(
        f"<tr>{_name(summary.filter_name, colours)}{''.join(_cell(column[i]) for _, column in shown)}</tr>"
        for i, summary in enumerate(summaries)
    )
    return (
        f'<p class="headline">{escape(verdict.headline)}</p>'
        '<div class="scroll"><table class="sortable answers"><thead><tr>'
        f'<th scope="col">Filter<small>&nbsp;</small></th>{heads}</tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _name(name: str, colours: dict[str, str]) -> str:
    variable = CSS_VARIABLES[colours[name]]
    label = escape(name)
    return f'<th scope="row" class="filter" style="--colour: var({variable})" data-value="{label}">{label}</th>'


def _cell(answer: _Answer | None) -> str:
    if answer is None:
        return f'<td class="none" data-value="">{UNKNOWN}</td>'
    key = "" if answer.key is None or not np.isfinite(answer.key) else repr(float(answer.key))
    word = f'<span class="{answer.tone}">{escape(answer.word)}</span>' if answer.word else ""
    return f'<td data-value="{key}"><div><b>{escape(answer.value)}</b>{answer.mark}</div>{word}</td>'


# ---- accuracy -------------------------------------------------------------------------------------------------------


def _accuracy(summary: FilterSummary, verdict: Verdict) -> _Answer | None:
    if summary.position_rmse_m is None:
        return _Answer(UNKNOWN, f"diverged {summary.diverged}/{summary.runs}", "bad") if summary.diverged else None
    value = _short(summary.position_rmse_m, " m")
    word, tone = _standing(summary, verdict)
    return _Answer(value, word, tone, key=summary.position_rmse_m)


def _standing(summary: FilterSummary, verdict: Verdict) -> tuple[str, Tone]:
    if summary.diverged:
        return f"diverged {summary.diverged}/{summary.runs}", "bad"
    if summary.filter_name == verdict.best:
        alone = bool(verdict.comparisons) and all(c.shown for c in verdict.comparisons.values())
        return ("best", "good") if alone else ("smallest" if verdict.comparisons else "", "none")
    comparison = verdict.comparisons.get(summary.filter_name)
    return ("worse", "bad") if comparison is not None and comparison.shown else ("", "none")


def _against(verdict: Verdict) -> str:
    return f"error against {verdict.best}, 95 % interval" if verdict.best else "error against the best"


def _difference(summary: FilterSummary, verdict: Verdict) -> _Answer | None:
    if not verdict.comparisons:
        return None
    if summary.filter_name == verdict.best:
        return _Answer("0 %", "what the others are held against", "none", _interval_mark(None, verdict), 0.0)
    comparison = verdict.comparisons.get(summary.filter_name)
    if comparison is None or not np.isfinite(comparison.excess_percent):
        return None
    word, tone = _finding(comparison)
    value = _signed(comparison.excess_percent)
    if comparison.interval_percent is not None:
        low, high = comparison.interval_percent
        word = f"{word}, {_signed(low, '')} to {_signed(high)}"
    return _Answer(value, word, tone, _interval_mark(comparison, verdict), comparison.excess_percent)


def _finding(comparison: Comparison) -> tuple[str, Tone]:
    if comparison.shown:
        return "worse", "bad"
    if comparison.finding is Finding.BETTER:
        return "better run by run", "fair"
    if comparison.difference.too_few and comparison.interval_percent is not None:
        return f"too few runs to be sure ({comparison.runs})", "none"
    if comparison.interval_percent is None:
        return f"{comparison.runs} run{'' if comparison.runs == 1 else 's'}, {Finding.NOT_SHOWN.value}", "none"
    return Finding.NOT_SHOWN.value, "none"


_WIDTH, _HEIGHT = 120, 12


def _interval_mark(comparison: Comparison | None, verdict: Verdict) -> str:
    """The interval as a bar on a scale that all rows share; the line is "no difference"."""
    ends = [p for c in verdict.comparisons.values() for p in (c.interval_percent or (c.excess_percent,))]
    logs = np.clip(np.log1p(np.array([p for p in ends if np.isfinite(p)] + [0.0]) / 100), -1.5, 2.5)
    low, high = float(logs.min()), float(logs.max())
    room = 0.06 * max(high - low, 0.02)

    def place(percent: float) -> float:
        value = np.clip(np.log1p(percent / 100), low, high)
        return float(round(_WIDTH * (value - low + room) / (high - low + 2 * room), 1))

    middle, zero = _HEIGHT / 2, place(0.0)
    shapes = f'<line x1="{zero}" x2="{zero}" y1="0" y2="{_HEIGHT}" stroke="var(--muted)"/>'
    if comparison is not None:
        colour = "var(--bad)" if comparison.shown else "var(--muted)"
        at = place(comparison.excess_percent)
        if comparison.interval_percent is not None:
            start, end = (place(p) for p in comparison.interval_percent)
            width = max(end - start, 1)
            box = f'x="{start}" y="{middle - 2}" width="{width:.1f}" height="4" rx="2"'
            shapes += f'<rect {box} fill="{colour}" opacity=".4"/>'
        shapes += f'<circle cx="{at}" cy="{middle}" r="3.5" fill="{colour}"/>'
    return _mark(shapes)


# ---- the other questions --------------------------------------------------------------------------------------------


def _consistency_question(summaries: Sequence[FilterSummary]) -> _Question:
    if all(s.pose_anees is None for s in summaries):
        return _Question("Is it consistent?", "NIS, 1 is ideal", _innovations)
    bands = {s.pose_anees_band for s in summaries if s.pose_anees_band is not None}
    band = " to ".join(f"{bound:.2f}" for bound in next(iter(bands))) if len(bands) == 1 else "of each"
    return _Question("Is it consistent?", f"pose NEES, band {band}", _honesty)


def _honesty(summary: FilterSummary) -> _Answer | None:
    if summary.pose_anees is None:
        return None
    state = consistency(summary)
    word = state.value
    if summary.frames_in_band_percent is not None:
        word += f", {summary.frames_in_band_percent:.0f} % of frames inside"
    return _Answer(_short(summary.pose_anees), word, _TONES[state], _band_mark(summary), summary.pose_anees)


def _band_mark(summary: FilterSummary) -> str:
    """Where the NEES lies, on a logarithmic scale around its band."""
    if summary.pose_anees is None or summary.pose_anees_band is None:
        return ""
    low, high = np.log(summary.pose_anees_band)
    centre, reach = 0.5 * (low + high), max(2.2 * (high - low), 0.8)
    width = 90

    def place(value: float) -> float:
        return float(round(np.clip(0.5 + 0.5 * (value - centre) / reach, 0.04, 0.96) * width, 1))

    shapes = (
        f'<rect x="0" y="5.25" width="{width}" height="1.5" fill="var(--grid)"/>'
        f'<rect x="{place(low)}" y="1" width="{place(high) - place(low):.1f}" height="10" rx="2" fill="var(--band)"/>'
        f'<circle cx="{place(float(np.log(summary.pose_anees)))}" cy="6" r="3.5" '
        f'fill="var(--{_TONES[consistency(summary)]})"/>'
    )
    return _mark(shapes, width)


def _innovations(summary: FilterSummary) -> _Answer | None:
    return None if summary.nis is None else _Answer(_short(summary.nis), "", "none", key=summary.nis)


def _limit_of(summaries: Sequence[FilterSummary]) -> str:
    bounds = {_short(s.bound_position_m, " m") for s in summaries if s.bound_position_m is not None}
    return f"bound {next(iter(bounds))} / RMSE, 95 % interval" if len(bounds) == 1 else "bound / RMSE, 95 % interval"


def _efficiency(summary: FilterSummary) -> _Answer | None:
    percent = summary.efficiency_percent
    if percent is None or summary.bound_position_m is None or summary.position_rmse_m is None:
        return None
    width, share = 90, float(np.clip(percent / 100, 0.0, 1.0))
    shapes = (
        f'<rect x="0" y="3" width="{width}" height="6" rx="3" fill="var(--band)"/>'
        f'<rect x="0" y="3" width="{max(share * width, 2):.1f}" height="6" rx="3" fill="var(--series-0)"/>'
    )
    word = _distance(summary.position_rmse_m / summary.bound_position_m, _efficiency_interval(summary))
    return _Answer(_percent(percent), word, "none", _mark(shapes, width), percent)


def _distance(excess: float, interval: tuple[float, float] | None) -> str:
    """How far from the limit, and how sure that is."""
    times = f"{excess:.2f} × the least error" if excess < 10 else f"{excess:,.0f} × the least error"
    if interval is None:
        return times if excess > 1 else "at the limit"
    low, high = interval
    if low > 100:
        return f"beyond it, {low:.0f} to {high:.0f} %"
    return f"at the limit, {low:.0f} to {high:.0f} %" if high >= 100 else f"{times}, {low:.0f} to {high:.0f} %"


def _efficiency_interval(summary: FilterSummary) -> tuple[float, float] | None:
    """95 % interval of the efficiency, over runs."""
    errors, efficiencies = np.array(summary.position_rmse_by_run), np.array(summary.efficiency_by_run)
    if len(errors) != len(efficiencies):
        return None
    known = np.isfinite(errors) & np.isfinite(efficiencies)
    if known.sum() < MIN_PAIRS:
        return None
    return efficiency_interval(0.01 * efficiencies[known] * errors[known], errors[known], CONFIDENCE)


def _cost(summary: FilterSummary, summaries: Sequence[FilterSummary]) -> _Answer | None:
    quickest = min((s.ms_per_frame for s in summaries if s.ms_per_frame), default=None)
    if summary.ms_per_frame is None or not quickest:
        return None
    ratio = summary.ms_per_frame / quickest
    words = ["quickest" if ratio == 1 else f"{ratio:.2f} ×"] if len(summaries) > 1 else []
    if summary.memory_mb is not None and summary.memory_mb >= 0.5:
        words.append(f"{summary.memory_mb:.0f} MB")
    return _Answer(f"{summary.ms_per_frame:.2f} ms", ", ".join(words), "none", key=summary.ms_per_frame)


def _mark(shapes: str, width: int = _WIDTH) -> str:
    return f'<svg aria-hidden="true" width="{width}" height="{_HEIGHT}" viewBox="0 0 {width} {_HEIGHT}">{shapes}</svg>'


def _signed(percent: float, unit: str = " %") -> str:
    text = f"{percent:+,.0f}" if abs(percent) < 1e5 else f"{percent:+.1e}"
    return text.replace("-", "−") + unit


def _percent(value: float) -> str:
    return f"{value:.0f} %" if value >= 1 else f"{value:.1g} %"


def _short(value: float | None, unit: str = "") -> str:
    if value is None or not np.isfinite(value):
        return UNKNOWN
    return (
        f"{value:.3g}{unit}"
        if abs(value) < 1000
        else f"{value:,.0f}{unit}"
        if abs(value) < 1e6
        else f"{value:.1e}{unit}"
    )
