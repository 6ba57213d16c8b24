"""The first screen of a report on policies: who leaves the pose least uncertain, and whether that is true."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from html import escape

import numpy as np

from stereo_slam_env.benchmark.statistics.differences import Finding, signed
from stereo_slam_env.benchmark.statistics.measures import FINAL_ERROR, FINAL_LOGDET, FINAL_SIGMA, POSITION, Measure
from stereo_slam_env.benchmark.statistics.policy_verdict import Agreement, PolicyVerdict
from stereo_slam_env.benchmark.statistics.verdict import Consistency
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.report.answers import Answer, Question, answers_table, consistency_question, short
from stereo_slam_env.report.page_tables import Tone
from stereo_slam_env.report.tables import finding_tone

_SAID: dict[Agreement, tuple[str, Tone]] = {
    Agreement.AGREE: ("yes", "good"),
    Agreement.OPEN: ("not shown", "none"),
    Agreement.DISAGREE: ("no", "bad"),
    Agreement.NOTHING_SHOWN: ("not shown", "none"),
}


def policy_overview(summaries: Sequence[FilterSummary], verdict: PolicyVerdict) -> str:
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
    sentences = "".join(f"<li>{escape(found.words)}</li>" for found in verdict.comparisons.values())
    return (
        f'<p class="headline">{escape(verdict.headline)}</p>{answers_table("Policy", questions, summaries)}'
        f'<ul class="quiet claims">{sentences}</ul>'
    )


def _claimed(summary: FilterSummary, verdict: PolicyVerdict) -> Answer | None:
    determinant = FINAL_LOGDET.of(summary)
    beside = f"<span>{short(determinant)}</span>".replace("-", "−") if np.isfinite(determinant) else ""
    return dataclasses.replace(_by(FINAL_SIGMA, summary, verdict), mark=beside)


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
