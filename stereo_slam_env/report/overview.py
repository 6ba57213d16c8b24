"""First screens of reports: which filter is best and by how much; what policies claim and whether it is true."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from markupsafe import Markup

from stereo_slam_env.benchmark.statistics.differences import MIN_PAIRS, Finding, signed
from stereo_slam_env.benchmark.statistics.measures import (
    FINAL_ERROR,
    FINAL_LOGDET,
    FINAL_SIGMA,
    POSE_NEES,
    POSITION,
)
from stereo_slam_env.benchmark.statistics.policy_verdict import Agreement, PolicyVerdict
from stereo_slam_env.benchmark.statistics.remarks import innovation_factor, limit_reached
from stereo_slam_env.benchmark.statistics.sentences import sentence
from stereo_slam_env.benchmark.statistics.verdict import (
    Consistency,
    FilterComparison,
    Verdict,
    consistency,
)
from stereo_slam_env.evaluation.bands import DOF
from stereo_slam_env.evaluation.figures import UNKNOWN, Figure, readable
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.report.charts.axes import filter_colours
from stereo_slam_env.report.page import on_page, part
from stereo_slam_env.report.table import Column, Table, TableCell, Tone, filter_cell, number
from stereo_slam_env.report.tables import FINDING_TONES

TONES: dict[Consistency, Tone] = {
    Consistency.CONSISTENT: "good",
    Consistency.OVERCONFIDENT: "bad",
    Consistency.DOUBTFUL: "none",
    Consistency.CAUTIOUS: "fair",
    Consistency.UNKNOWN: "none",
}
MARK_WIDTH, MARK_HEIGHT = 120, 12
RUN_BY_RUN = (
    "geometric mean of the ratios run by run: one hard run does not decide it, so it is not the ratio of two root mean"
    " squares over runs"
)
"""Explanation of a column of differences beside one of values."""


Question = tuple[Column, Callable[[FilterSummary], TableCell | None]]
"""A column: the question and how it is measured, and what answers it (None: nothing)."""


def answer(
    value: str, word: str = "", tone: Tone = "none", mark: Markup | None = None, key: float | None = None
) -> TableCell:
    """A value with a mark beside it, and a word on it below."""
    has_key = key is not None and np.isfinite(key)
    return TableCell(value, float(key or 0.0) if has_key else None, note=word, note_tone=tone, mark=mark)


def colour_key(names: Sequence[str]) -> Markup:
    """A line with the colours of the filters and what colours of words mean; it stays in sight."""
    tones = (
        ("good", "significantly better, or consistent"),
        ("bad", "significantly worse, overconfident, or diverged"),
        ("fair", "too cautious"),
        ("none", "not significant"),
    )
    return part("colour_key", list(filter_colours(names).items()), tones)


def answers_table(who: str, questions: Sequence[Question], summaries: Sequence[FilterSummary]) -> Markup:
    """Table with a row for each summary, `who`; questions that nobody has an answer to are left out."""
    colours = filter_colours(s.filter_name for s in summaries)
    answered_columns = [(column, [answered(summary) for summary in summaries]) for column, answered in questions]
    columns_kept = [(column, cells) for column, cells in answered_columns if any(cell is not None for cell in cells)]
    rows = [
        [filter_cell(s.filter_name, colours), *(cells[i] or number(None) for _, cells in columns_kept)]
        for i, s in enumerate(summaries)
    ]
    return on_page(Table([Column(who), *(column for column, _ in columns_kept)], rows, "answers"))


def consistency_question(summaries: Sequence[FilterSummary], *, with_share: bool = True) -> Question:
    """Whether NEES, or else NIS, is what a consistent filter has; `with_share`: and in how many frames."""
    if all(s.pose_anees is None for s in summaries):
        return Column("Is it consistent?", "NIS / dof, 1 is ideal"), _innovations
    bands = {s.pose_anees_band for s in summaries if s.pose_anees_band is not None}
    band = " to ".join(f"{end / DOF['pose']:.2f}" for end in next(iter(bands))) if len(bands) == 1 else "of each"
    return Column("Is it consistent?", f"pose NEES / 6, band {band}"), lambda s: _honesty(s, with_share)


def _honesty(summary: FilterSummary, with_share: bool) -> TableCell | None:
    if summary.pose_anees is None:
        return None
    state = consistency(summary)
    few = summary.consistency["pose"].runs if "pose" in summary.consistency else summary.runs
    word = state.value if few >= MIN_PAIRS else f"{state.value}, by {few} run{'s' if few > 1 else ''}"
    if with_share and summary.frames_in_band_percent is not None:
        word += f", {summary.frames_in_band_percent:.0f} % of frames inside"
    mean = POSE_NEES.of(summary)
    return answer(POSE_NEES.text_of(mean), word, TONES[state], _band_mark(summary), mean)


def _band_mark(summary: FilterSummary) -> Markup:
    """Mark of the NEES on a logarithmic scale around its band."""
    if summary.pose_anees is None or summary.pose_anees_band is None:
        return Markup()
    low, high = np.log(summary.pose_anees_band)
    centre, reach = 0.5 * (low + high), max(2.2 * (high - low), 0.8)
    width = 90

    def place(value: float) -> float:
        return float(round(np.clip(0.5 + 0.5 * (value - centre) / reach, 0.04, 0.96) * width, 1))

    at = place(float(np.log(summary.pose_anees)))
    return drawn(
        ("rect", {"x": 0, "y": 5.25, "width": width, "height": 1.5, "fill": "var(--grid)"}),
        (
            "rect",
            {"x": place(low), "y": 1, "width": place(high) - place(low), "height": 10, "rx": 2, "fill": "var(--band)"},
        ),
        ("circle", {"cx": at, "cy": 6, "r": 3.5, "fill": f"var(--{TONES[consistency(summary)]})"}),
        width=width,
    )


def _innovations(summary: FilterSummary) -> TableCell | None:
    if summary.nis is None:
        return None
    factor = innovation_factor(summary)
    if factor is None:
        return answer(short(summary.nis), key=summary.nis)
    state = Consistency.CAUTIOUS if factor < 1.0 else Consistency.OVERCONFIDENT
    return answer(
        short(summary.nis), f"innovations {sentence('times_the_claim', factor)}", TONES[state], key=summary.nis
    )


def drawn(*shapes: tuple[str, Mapping[str, object]], width: int = MARK_WIDTH) -> Markup:
    """A small drawing beside a value, from the elements of SVG and their attributes."""
    plain = [
        (name, {key: value if isinstance(value, str) else f"{value:.4g}" for key, value in values.items()})
        for name, values in shapes
    ]
    return part("mark", width, MARK_HEIGHT, plain)


def lost(summary: FilterSummary) -> str:
    """In how many runs a filter diverged or failed, in short: "diverged 3/10"."""
    return f"{sentence('loss', summary)} {summary.diverged}/{summary.runs}"


def short(value: float | None, unit: str = "") -> str:
    """Three digits that count, or a dash."""
    if value is None or not np.isfinite(value):
        return UNKNOWN
    return f"{value:,.0f}{unit}" if 1000 <= abs(value) < 1e6 else f"{readable(value)}{unit}"


def overview(summaries: Sequence[FilterSummary], verdict: Verdict) -> Markup:
    """Headline and answers: a row for each filter, a column for each question that can be answered."""
    first = "Which is best?" if len(summaries) > 1 else "How accurate is it?"
    questions: list[Question] = [
        (Column(first, "position RMSE"), lambda s: _accuracy(s, verdict)),
        (Column("By how much, is it sure?", _against(verdict), RUN_BY_RUN), lambda s: _difference(s, verdict)),
        consistency_question(summaries),
        (Column("How far from the limit?", _limit_of(summaries)), _efficiency),
        (Column("What does it cost?", "median time a frame"), lambda s: _cost(s, summaries)),
    ]
    answers = answers_table("Filter", questions, summaries)
    return Markup("\n").join([part("items", verdict.lines, "headline"), answers])


# ---- accuracy -------------------------------------------------------------------------------------------------------


def _accuracy(summary: FilterSummary, verdict: Verdict) -> TableCell | None:
    if summary.position_rmse_m is None:
        return answer(UNKNOWN, lost(summary), "bad") if summary.diverged else None
    value = short(summary.position_rmse_m, " m")
    word, tone = _standing(summary, verdict)
    return answer(value, word, tone, key=summary.position_rmse_m)


def _standing(summary: FilterSummary, verdict: Verdict) -> tuple[str, Tone]:
    if summary.diverged:
        return lost(summary), "bad"
    if summary.filter_name in verdict.leaders:
        tied = len(verdict.leaders) > 1
        if verdict.is_shown:
            return "best, a tie" if tied else "best", "good"
        return "tie" if tied else "smallest" if verdict.comparisons else "", "none"
    comparison = verdict.comparisons.get(summary.filter_name)
    worse = comparison is not None and comparison.difference.finding is Finding.WORSE
    return ("worse", "bad") if worse else ("", "none")


def _against(verdict: Verdict) -> str:
    sure = any(c.difference.interval is not None for c in verdict.comparisons.values())
    return f"error against {verdict.best or 'the best'} run by run{', 95 % interval' if sure else ''}"


def _difference(summary: FilterSummary, verdict: Verdict) -> TableCell | None:
    if not verdict.comparisons:
        return None
    if summary.filter_name == verdict.best:
        return answer("0 %", "reference", "none", _interval_mark(None, verdict), 0.0)
    comparison = verdict.comparisons.get(summary.filter_name)
    if comparison is None or not comparison.difference.count:
        return None
    word, tone = _finding(comparison)
    change = comparison.difference
    if change.interval is not None and not comparison.tied:
        word = f"{word}, {change.interval_words}"
    return answer(f"{signed(change.percent)} %", word, tone, _interval_mark(comparison, verdict), change.percent)


def _finding(comparison: FilterComparison) -> tuple[str, Tone]:
    difference = comparison.difference
    if comparison.tied:
        return f"tie, {difference.tie_words}", "none"
    if difference.finding is Finding.WORSE:
        return "worse", "bad"
    if difference.finding is Finding.BETTER:
        return "better run by run", "fair"
    if difference.too_few:
        return f"{difference.count} run{' is' if difference.count == 1 else 's are'} too few to show it", "none"
    return Finding.NOT_SHOWN.value, "none"


def _interval_mark(comparison: FilterComparison | None, verdict: Verdict) -> Markup:
    """The interval as a bar on a scale that all rows share; the line is "no difference"."""
    differences = [c.difference for c in verdict.comparisons.values()]
    ends = [p for d in differences for p in (d.interval_percent or (d.percent,))]
    shares = np.array([p for p in ends if np.isfinite(p)] + [0.0]) / 100
    logs = np.log1p(np.clip(shares, *np.expm1([-1.5, 2.5])))
    low, high = float(logs.min()), float(logs.max())
    room = 0.06 * max(high - low, 0.02)

    def place(percent: float) -> float:
        value = np.log1p(np.clip(percent / 100, *np.expm1([low, high])))
        return float(round(MARK_WIDTH * (value - low + room) / (high - low + 2 * room), 1))

    middle, zero = MARK_HEIGHT / 2, place(0.0)
    line = ("line", {"x1": zero, "x2": zero, "y1": 0, "y2": MARK_HEIGHT, "stroke": "var(--muted)"})
    if comparison is None:
        return drawn(line)
    difference = comparison.difference
    colour = "var(--bad)" if difference.finding is Finding.WORSE else "var(--muted)"
    dot = ("circle", {"cx": place(difference.percent), "cy": middle, "r": 3.5, "fill": colour})
    if difference.interval_percent is None:
        return drawn(line, dot)
    start, end = (place(percent) for percent in difference.interval_percent)
    size = {"x": start, "y": middle - 2, "width": max(end - start, 1), "height": 4, "rx": 2}
    return drawn(line, ("rect", {**size, "fill": colour, "opacity": 0.4}), dot)


# ---- the other questions --------------------------------------------------------------------------------------------


def _limit_of(summaries: Sequence[FilterSummary]) -> str:
    bounds = {short(s.bound_position_m, " m") for s in summaries if s.bound_position_m is not None}
    sure = any(reached is not None and reached.interval is not None for reached in map(limit_reached, summaries))
    bound = f"bound {next(iter(bounds))} / RMSE" if len(bounds) == 1 else "bound / RMSE"
    return f"{bound}, 95 % interval" if sure else bound


def _efficiency(summary: FilterSummary) -> TableCell | None:
    limit = limit_reached(summary)
    if limit is None:
        return None
    width, share = 90, float(np.clip(limit.percent / 100, 0.0, 1.0))
    bar = {"x": 0, "y": 3, "height": 6, "rx": 3}
    mark = drawn(
        ("rect", {**bar, "width": width, "fill": "var(--band)"}),
        ("rect", {**bar, "width": max(share * width, 2), "fill": "var(--series-0)"}),
        width=width,
    )
    return answer(limit.value, limit.sureness, "none", mark, limit.percent)


def _cost(summary: FilterSummary, summaries: Sequence[FilterSummary]) -> TableCell | None:
    quickest = min((s.ms_per_frame for s in summaries if s.ms_per_frame), default=None)
    if summary.ms_per_frame is None or not quickest:
        return None
    excess = 100.0 * (summary.ms_per_frame / quickest - 1.0)
    words = [f"{signed(excess)} %" if excess else "quickest"] if len(summaries) > 1 else []
    if summary.memory_mb is not None and summary.memory_mb >= 0.5:
        words.append(f"{summary.memory_mb:.0f} MB")
    words += filter(None, [sentence("timed", summary)])
    return answer(f"{summary.ms_per_frame:.2f} ms", ", ".join(words), "none", key=summary.ms_per_frame)


# ---- policies -------------------------------------------------------------------------------------------------------

_SAID: dict[Agreement, tuple[str, Tone]] = {
    Agreement.AGREE: ("yes", "good"),
    Agreement.OPEN: ("not shown", "none"),
    Agreement.DISAGREE: ("no", "bad"),
    Agreement.NOTHING_SHOWN: ("not shown", "none"),
}


def policy_overview(summaries: Sequence[FilterSummary], verdict: PolicyVerdict) -> Markup:
    """Headline, answers and a sentence for each policy."""
    against = f"and run by run against {verdict.baseline}, 95 % interval"
    questions: list[Question] = [
        (
            Column("What does it claim at the end?", f"σ of the position {against}; log det of the pose"),
            lambda s: _claimed(s, verdict),
        ),
        (Column("How wrong is it then?", f"true position error, {against}"), lambda s: _by(FINAL_ERROR, s, verdict)),
        (Column("And along the drive?", f"position RMSE, {against}"), lambda s: _by(POSITION, s, verdict)),
        consistency_question(summaries, with_share=False),
        (Column("Is the claim true?", f"by the difference to {verdict.baseline}"), lambda s: _agreement(s, verdict)),
    ]
    return Markup("\n").join(
        [
            part("paragraph", verdict.headline, "headline"),
            answers_table("Policy", questions, summaries),
            part("items", [comparison.words for comparison in verdict.comparisons.values()], "quiet claims"),
        ]
    )


def _claimed(summary: FilterSummary, verdict: PolicyVerdict) -> TableCell | None:
    determinant = FINAL_LOGDET.of(summary)
    beside = Markup("<span>{}</span>").format(short(determinant).replace("-", "−"))
    return dataclasses.replace(_by(FINAL_SIGMA, summary, verdict), mark=beside if np.isfinite(determinant) else None)


def _by(measure: Figure, summary: FilterSummary, verdict: PolicyVerdict) -> TableCell:
    """The value of a measure, and its difference to that of the baseline."""
    value = measure.of(summary)
    text = short(value, f" {measure.unit}")
    if summary.filter_name == verdict.baseline:
        return answer(text, "baseline", "none", key=value)
    difference = verdict.compared.cell(measure, summary.filter_name, verdict.baseline)
    if difference is None:
        return answer(text, "", "none", key=value)
    words = [f"{signed(difference.percent)} %"]
    if difference.too_few:
        words.append(f"{difference.count} run{' is' if difference.count == 1 else 's are'} too few")
    else:
        words.append(difference.interval_words)
        if difference.finding is Finding.NOT_SHOWN:
            words.append(difference.finding.value)
    return answer(text, ", ".join(words), FINDING_TONES[difference.finding], key=value)


def _agreement(summary: FilterSummary, verdict: PolicyVerdict) -> TableCell | None:
    agreement = verdict.comparisons.get(summary.filter_name)
    if agreement is None:
        return None
    word, tone = _SAID[agreement.agreement]
    if agreement.agreement is Agreement.AGREE and agreement.consistency is Consistency.OVERCONFIDENT:
        return answer("in part", "too much is claimed", "fair")
    return answer(word, "", tone)
