"""Table of a report's first screen: a row for each competitor, a column for each question."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from stereo_slam_env.benchmark.statistics.measures import POSE_NEES
from stereo_slam_env.benchmark.statistics.remarks import innovation_factor, times_the_claim
from stereo_slam_env.benchmark.statistics.verdict import Consistency, consistency, loss
from stereo_slam_env.evaluation.consistency_figures import DOF
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.report.charts.style import filter_colours
from stereo_slam_env.report.page import part
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
    mark: Markup | None = None
    key: float | None = None

    @property
    def sorted_by(self) -> str:
        """The key as text, "" where it is not known."""
        return "" if self.key is None or not np.isfinite(self.key) else repr(float(self.key))


@dataclass(frozen=True)
class Question:
    """A column: the question, how it is measured, and what answers it (None: nothing)."""

    words: str
    measure: str
    answer: Callable[[FilterSummary], Answer | None]


def answers_table(who: str, questions: Sequence[Question], summaries: Sequence[FilterSummary]) -> Markup:
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
    rows = [
        (s.filter_name, colours[s.filter_name], [column[i] for _, column in shown]) for i, s in enumerate(summaries)
    ]
    return part("answers", who, [question for question, _ in shown], rows)


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


def _band_mark(summary: FilterSummary) -> Markup:
    """Where the NEES lies, on a logarithmic scale around its band."""
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


def _innovations(summary: FilterSummary) -> Answer | None:
    if summary.nis is None:
        return None
    factor = innovation_factor(summary)
    if factor is None:
        return Answer(short(summary.nis), key=summary.nis)
    state = Consistency.CAUTIOUS if factor < 1.0 else Consistency.OVERCONFIDENT
    return Answer(short(summary.nis), f"innovations {times_the_claim(factor)}", TONES[state], key=summary.nis)


def drawn(*shapes: tuple[str, Mapping[str, object]], width: int = MARK_WIDTH) -> Markup:
    """A small drawing beside a value, from the elements of SVG and their attributes."""
    plain = [
        (name, {key: value if isinstance(value, str) else f"{value:.4g}" for key, value in values.items()})
        for name, values in shapes
    ]
    return part("mark", width, MARK_HEIGHT, plain)


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
