"""The table of a report's first screen: a row for each competitor, a column for each question."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from stereo_slam_env.benchmark.statistics.measures import POSE_NEES
from stereo_slam_env.benchmark.statistics.remarks import innovation_factor, times_the_claim
from stereo_slam_env.benchmark.statistics.verdict import Consistency, consistency, loss
from stereo_slam_env.evaluation.consistency_figures import DOF
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.report.charts.figures import CSS_VARIABLES
from stereo_slam_env.report.charts.style import filter_colours
from stereo_slam_env.report.page_tables import UNKNOWN, Tone

TONES: dict[Consistency, Tone] = {
    Consistency.CONSISTENT: "good",
    Consistency.OVERCONFIDENT: "bad",
    Consistency.CAUTIOUS: "fair",
    Consistency.UNKNOWN: "none",
}
MARK_WIDTH, MARK_HEIGHT = 120, 12


@dataclass(frozen=True)
class Answer:
    """What one competitor has to say to one question.

    Attributes
    ----------
    value, word, tone : str
        A value, and a word on it below.
    mark : str
        Drawn beside the value, markup.
    key : float, optional
        What sorting goes by.
    """

    value: str
    word: str = ""
    tone: Tone = "none"
    mark: str = ""
    key: float | None = None


@dataclass(frozen=True)
class Question:
    """A column: the question, how it is measured, and what answers it (None: nothing)."""

    words: str
    measure: str
    answer: Callable[[FilterSummary], Answer | None]


def answers_table(who: str, questions: Sequence[Question], summaries: Sequence[FilterSummary]) -> str:
    """Markup; questions that nobody has an answer to are left out.

    Parameters
    ----------
    who : str
        What a row is: "Filter".
    questions : sequence of Question
        Columns.
    summaries : sequence of FilterSummary
        Rows.
    """
    colours = filter_colours(s.filter_name for s in summaries)
    answers = [[question.answer(summary) for summary in summaries] for question in questions]
    shown = [(q, column) for q, column in zip(questions, answers, strict=True) if any(a is not None for a in column)]
    heads = "".join(f'<th scope="col">{q.words}<small>{escape(q.measure)}</small></th>' for q, _ in shown)
    rows = "".join(
        f"<tr>{_name(summary.filter_name, colours)}{''.join(_cell(column[i]) for _, column in shown)}</tr>"
        for i, summary in enumerate(summaries)
    )
    return (
        '<div class="scroll"><table class="sortable answers"><thead><tr>'
        f'<th scope="col">{who}<small>&nbsp;</small></th>{heads}</tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _name(name: str, colours: dict[str, str]) -> str:
    variable = CSS_VARIABLES[colours[name]]
    label = escape(name)
    return f'<th scope="row" class="filter" style="--colour: var({variable})" data-value="{label}">{label}</th>'


def _cell(answer: Answer | None) -> str:
    if answer is None:
        return f'<td class="none" data-value="">{UNKNOWN}</td>'
    key = "" if answer.key is None or not np.isfinite(answer.key) else repr(float(answer.key))
    word = f'<span class="{answer.tone}">{escape(answer.word)}</span>' if answer.word else ""
    return f'<td data-value="{key}"><div><b>{escape(answer.value)}</b>{answer.mark}</div>{word}</td>'


def consistency_question(summaries: Sequence[FilterSummary], *, with_share: bool = True) -> Question:
    """Whether NEES, or else NIS, is what a consistent filter has; `with_share`: and in how many frames."""
    if all(s.pose_anees is None for s in summaries):
        return Question("Is it consistent?", "NIS / dof, 1 is ideal", _innovations)
    bands = {s.pose_anees_band for s in summaries if s.pose_anees_band is not None}
    band = " to ".join(f"{end / DOF['pose']:.2f}" for end in next(iter(bands))) if len(bands) == 1 else "of each"
    return Question("Is it consistent?", f"pose NEES / 6, band {band}", lambda s: _honesty(s, with_share))


def _honesty(summary: FilterSummary, with_share: bool) -> Answer | None:
    if summary.pose_anees is None:
        return None
    state = consistency(summary)
    word = state.value
    if with_share and summary.frames_in_band_percent is not None:
        word += f", {summary.frames_in_band_percent:.0f} % of frames inside"
    mean = POSE_NEES.of(summary)
    return Answer(short(mean), word, TONES[state], _band_mark(summary), mean)


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
        f'fill="var(--{TONES[consistency(summary)]})"/>'
    )
    return drawn(shapes, width)


def _innovations(summary: FilterSummary) -> Answer | None:
    if summary.nis is None:
        return None
    factor = innovation_factor(summary)
    if factor is None:
        return Answer(short(summary.nis), key=summary.nis)
    state = Consistency.CAUTIOUS if factor < 1.0 else Consistency.OVERCONFIDENT
    return Answer(short(summary.nis), f"innovations {times_the_claim(factor)}", TONES[state], key=summary.nis)


def drawn(shapes: str, width: int = MARK_WIDTH) -> str:
    """A small drawing beside a value, from SVG shapes."""
    size = f'width="{width}" height="{MARK_HEIGHT}" viewBox="0 0 {width} {MARK_HEIGHT}"'
    return f'<svg aria-hidden="true" {size}>{shapes}</svg>'


def lost(summary: FilterSummary) -> str:
    """In how many runs a filter diverged or failed, in short: "diverged 3/10"."""
    return f"{loss(summary)} {summary.diverged}/{summary.runs}"


def short(value: float | None, unit: str = "") -> str:
    """Three digits that count, or a dash."""
    if value is None or not np.isfinite(value):
        return UNKNOWN
    return (
        f"{value:.3g}{unit}"
        if abs(value) < 1000
        else f"{value:,.0f}{unit}"
        if abs(value) < 1e6
        else f"{value:.1e}{unit}"
    )
