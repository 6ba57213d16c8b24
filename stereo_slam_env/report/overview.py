"""First screens of reports: which filter is best and by how much; what policies claim and whether it is true."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from stereo_slam_env.benchmark.statistics.differences import Finding, signed
from stereo_slam_env.benchmark.statistics.measures import FINAL_ERROR, FINAL_LOGDET, FINAL_SIGMA, POSITION, Measure
from stereo_slam_env.benchmark.statistics.policy_verdict import Agreement, PolicyVerdict
from stereo_slam_env.benchmark.statistics.remarks import limit_reached
from stereo_slam_env.benchmark.statistics.verdict import Comparison, Consistency, Verdict
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.report.answers import (
    MARK_HEIGHT,
    MARK_WIDTH,
    Answer,
    Question,
    answers_table,
    consistency_question,
    drawn,
    lost,
    short,
)
from stereo_slam_env.report.page import joined, part
from stereo_slam_env.report.page_tables import UNKNOWN, Tone
from stereo_slam_env.report.tables import finding_tone


def overview(summaries: Sequence[FilterSummary], verdict: Verdict) -> Markup:
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
    first = "Which is best?" if len(summaries) > 1 else "How accurate is it?"
    questions = [
        Question(first, "position RMSE", lambda s: _accuracy(s, verdict)),
        Question("By how much, is it sure?", _against(verdict), lambda s: _difference(s, verdict)),
        consistency_question(summaries),
        Question("How far from the limit?", _limit_of(summaries), _efficiency),
        Question("What does it cost?", "median time a frame", lambda s: _cost(s, summaries)),
    ]
    return joined([part("paragraph", verdict.headline, "headline"), answers_table("Filter", questions, summaries)])


# ---- accuracy -------------------------------------------------------------------------------------------------------


def _accuracy(summary: FilterSummary, verdict: Verdict) -> Answer | None:
    if summary.position_rmse_m is None:
        return Answer(UNKNOWN, lost(summary), "bad") if summary.diverged else None
    value = short(summary.position_rmse_m, " m")
    word, tone = _standing(summary, verdict)
    return Answer(value, word, tone, key=summary.position_rmse_m)


def _standing(summary: FilterSummary, verdict: Verdict) -> tuple[str, Tone]:
    if summary.diverged:
        return lost(summary), "bad"
    if summary.filter_name in verdict.leaders:
        tied = len(verdict.leaders) > 1
        if verdict.is_shown:
            return "best, a tie" if tied else "best", "good"
        return "tie" if tied else "smallest" if verdict.comparisons else "", "none"
    comparison = verdict.comparisons.get(summary.filter_name)
    return ("worse", "bad") if comparison is not None and comparison.shown else ("", "none")


def _against(verdict: Verdict) -> str:
    return f"error against {verdict.best}, 95 % interval" if verdict.best else "error against the best"


def _difference(summary: FilterSummary, verdict: Verdict) -> Answer | None:
    if not verdict.comparisons:
        return None
    if summary.filter_name == verdict.best:
        return Answer("0 %", "what the others are held against", "none", _interval_mark(None, verdict), 0.0)
    comparison = verdict.comparisons.get(summary.filter_name)
    if comparison is None or not np.isfinite(comparison.excess_percent):
        return None
    word, tone = _finding(comparison)
    value = f"{signed(comparison.excess_percent)} %"
    if comparison.interval_percent is not None and not comparison.tied:
        word = f"{word}, {comparison.difference.interval_words}"
    return Answer(value, word, tone, _interval_mark(comparison, verdict), comparison.excess_percent)


def _finding(comparison: Comparison) -> tuple[str, Tone]:
    if comparison.tied:
        return f"tie, {comparison.difference.tie_words}", "none"
    if comparison.shown:
        return "worse", "bad"
    if comparison.finding is Finding.BETTER:
        return "better run by run", "fair"
    if comparison.difference.too_few and comparison.interval_percent is not None:
        return f"too few runs to be sure ({comparison.runs})", "none"
    if comparison.interval_percent is None:
        return f"{comparison.runs} run{'' if comparison.runs == 1 else 's'}, {Finding.NOT_SHOWN.value}", "none"
    return Finding.NOT_SHOWN.value, "none"


def _interval_mark(comparison: Comparison | None, verdict: Verdict) -> Markup:
    """The interval as a bar on a scale that all rows share; the line is "no difference"."""
    ends = [p for c in verdict.comparisons.values() for p in (c.interval_percent or (c.excess_percent,))]
    logs = np.clip(np.log1p(np.array([p for p in ends if np.isfinite(p)] + [0.0]) / 100), -1.5, 2.5)
    low, high = float(logs.min()), float(logs.max())
    room = 0.06 * max(high - low, 0.02)

    def place(percent: float) -> float:
        value = np.clip(np.log1p(percent / 100), low, high)
        return float(round(MARK_WIDTH * (value - low + room) / (high - low + 2 * room), 1))

    middle, zero = MARK_HEIGHT / 2, place(0.0)
    line = ("line", {"x1": zero, "x2": zero, "y1": 0, "y2": MARK_HEIGHT, "stroke": "var(--muted)"})
    if comparison is None:
        return drawn(line)
    colour = "var(--bad)" if comparison.shown else "var(--muted)"
    dot = ("circle", {"cx": place(comparison.excess_percent), "cy": middle, "r": 3.5, "fill": colour})
    if comparison.interval_percent is None:
        return drawn(line, dot)
    start, end = (place(percent) for percent in comparison.interval_percent)
    size = {"x": start, "y": middle - 2, "width": max(end - start, 1), "height": 4, "rx": 2}
    return drawn(line, ("rect", {**size, "fill": colour, "opacity": 0.4}), dot)


# ---- the other questions --------------------------------------------------------------------------------------------


def _limit_of(summaries: Sequence[FilterSummary]) -> str:
    bounds = {short(s.bound_position_m, " m") for s in summaries if s.bound_position_m is not None}
    return f"bound {next(iter(bounds))} / RMSE, 95 % interval" if len(bounds) == 1 else "bound / RMSE, 95 % interval"


def _efficiency(summary: FilterSummary) -> Answer | None:
    found = limit_reached(summary)
    if found is None:
        return None
    width, share = 90, float(np.clip(found.percent / 100, 0.0, 1.0))
    bar = {"x": 0, "y": 3, "height": 6, "rx": 3}
    mark = drawn(
        ("rect", {**bar, "width": width, "fill": "var(--band)"}),
        ("rect", {**bar, "width": max(share * width, 2), "fill": "var(--series-0)"}),
        width=width,
    )
    return Answer(found.value, found.sureness, "none", mark, found.percent)


def _cost(summary: FilterSummary, summaries: Sequence[FilterSummary]) -> Answer | None:
    quickest = min((s.ms_per_frame for s in summaries if s.ms_per_frame), default=None)
    if summary.ms_per_frame is None or not quickest:
        return None
    excess = 100.0 * (summary.ms_per_frame / quickest - 1.0)
    words = [f"{signed(excess)} %" if excess else "quickest"] if len(summaries) > 1 else []
    if summary.memory_mb is not None and summary.memory_mb >= 0.5:
        words.append(f"{summary.memory_mb:.0f} MB")
    return Answer(f"{summary.ms_per_frame:.2f} ms", ", ".join(words), "none", key=summary.ms_per_frame)


# ---- policies -------------------------------------------------------------------------------------------------------

_SAID: dict[Agreement, tuple[str, Tone]] = {
    Agreement.AGREE: ("yes", "good"),
    Agreement.OPEN: ("not shown", "none"),
    Agreement.DISAGREE: ("no", "bad"),
    Agreement.NOTHING_SHOWN: ("not shown", "none"),
}


def policy_overview(summaries: Sequence[FilterSummary], verdict: PolicyVerdict) -> Markup:
    """Headline, answers and a sentence for each policy.

    Parameters
    ----------
    summaries : sequence of FilterSummary
        One for each policy.
    verdict : PolicyVerdict
        On the same policies.

    Returns
    -------
    str
        Markup.
    """
    against = f"and against {verdict.baseline}, 95 % interval"
    questions = [
        Question(
            "What does it claim at the end?",
            f"σ of the position {against}; log det of the pose",
            lambda s: _claimed(s, verdict),
        ),
        Question("How wrong is it then?", f"true position error, {against}", lambda s: _by(FINAL_ERROR, s, verdict)),
        Question("And along the drive?", f"position RMSE, {against}", lambda s: _by(POSITION, s, verdict)),
        consistency_question(summaries, with_share=False),
        Question("Is the claim true?", f"by the difference to {verdict.baseline}", lambda s: _agreement(s, verdict)),
    ]
    return joined(
        [
            part("paragraph", verdict.headline, "headline"),
            answers_table("Policy", questions, summaries),
            part("items", [found.words for found in verdict.comparisons.values()], "quiet claims"),
        ]
    )


def _claimed(summary: FilterSummary, verdict: PolicyVerdict) -> Answer | None:
    determinant = FINAL_LOGDET.of(summary)
    beside = Markup("<span>{}</span>").format(short(determinant).replace("-", "−"))
    return dataclasses.replace(_by(FINAL_SIGMA, summary, verdict), mark=beside if np.isfinite(determinant) else None)


def _by(measure: Measure, summary: FilterSummary, verdict: PolicyVerdict) -> Answer:
    """The value of a measure, and its difference to that of the baseline."""
    value = measure.of(summary)
    shown = short(value, f" {measure.unit}")
    if summary.filter_name == verdict.baseline:
        return Answer(shown, "baseline", "none", key=value)
    found = verdict.compared.cell(measure, summary.filter_name, verdict.baseline)
    if found is None:
        return Answer(shown, "", "none", key=value)
    difference = found.difference
    words = [f"{signed(difference.percent)} %"]
    if difference.too_few:
        words.append(f"{difference.count} runs are too few")
    else:
        words.append(difference.interval_words)
        if difference.finding is Finding.NOT_SHOWN:
            words.append("not shown")
    return Answer(shown, ", ".join(words), finding_tone(difference.finding), key=value)


def _agreement(summary: FilterSummary, verdict: PolicyVerdict) -> Answer | None:
    found = verdict.comparisons.get(summary.filter_name)
    if found is None:
        return None
    word, tone = _SAID[found.agreement]
    if found.agreement is Agreement.AGREE and found.consistency is Consistency.OVERCONFIDENT:
        return Answer("in part", "too much is claimed", "fair")
    return Answer(word, "", tone)
