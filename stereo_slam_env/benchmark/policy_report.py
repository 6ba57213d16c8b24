"""The first screen of a report on policies: who leaves the pose least uncertain, and whether that is true."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape

from stereo_slam_env.benchmark.measures import FINAL_ERROR, FINAL_LOGDET, FINAL_SIGMA, POSITION, Measure
from stereo_slam_env.benchmark.policy_verdict import Agreement, PolicyVerdict
from stereo_slam_env.benchmark.report_answers import Answer, Question, answers_table, consistency_question, short
from stereo_slam_env.benchmark.report_tables import finding_tone
from stereo_slam_env.benchmark.results import FilterSummary
from stereo_slam_env.benchmark.statistics import Finding, signed
from stereo_slam_env.benchmark.verdict import Consistency
from stereo_slam_env.viewer.page_tables import Tone

_TONES: dict[Agreement, Tone] = {
    Agreement.AGREE: "good",
    Agreement.DISAGREE: "bad",
    Agreement.NOTHING_SHOWN: "none",
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
        Question("How uncertain is the final position?", f"claimed σ, {against}", _by(FINAL_SIGMA, verdict)),
        Question("And the whole pose?", f"claimed log det, {against}", _by(FINAL_LOGDET, verdict)),
        Question("How wrong is it in truth?", f"final position error, {against}", _by(FINAL_ERROR, verdict)),
        Question("Along the drive?", f"position RMSE, {against}", _by(POSITION, verdict)),
        consistency_question(summaries),
        Question("Do claim and truth agree?", f"both against {verdict.baseline}", lambda s: _agreement(s, verdict)),
    ]
    sentences = "".join(f"<li>{escape(found.words)}</li>" for found in verdict.comparisons.values())
    return (
        f'<p class="headline">{escape(verdict.headline)}</p>{answers_table("Policy", questions, summaries)}'
        f'<ul class="quiet claims">{sentences}</ul>'
    )


def _by(measure: Measure, verdict: PolicyVerdict) -> Callable[[FilterSummary], Answer | None]:
    """The answer of a policy by one measure: its value, and the difference to the baseline."""

    def answer(summary: FilterSummary) -> Answer | None:
        value = measure.of(summary)
        shown = short(value, f" {measure.unit}" if measure.unit else "").replace("-", "−")
        if summary.filter_name == verdict.baseline:
            return Answer(shown, "what the others are held against", "none", key=value)
        found = verdict.compared.cell(measure, summary.filter_name, verdict.baseline)
        if found is None:
            return Answer(shown, "", "none", key=value)
        difference = found.difference
        change = f"{signed(difference.percent)} %" if measure.is_ratio else signed(difference.estimate, 2)
        words = [change, *([difference.interval_words] if difference.interval is not None else [])]
        if difference.too_few:
            words.append(f"{difference.count} runs are too few")
        elif difference.finding is Finding.NOT_SHOWN:
            words.append("not shown")
        return Answer(shown, ", ".join(words), finding_tone(difference.finding), key=value)

    return answer


def _agreement(summary: FilterSummary, verdict: PolicyVerdict) -> Answer | None:
    found = verdict.comparisons.get(summary.filter_name)
    if found is None:
        return None
    said = {Agreement.AGREE: "yes", Agreement.DISAGREE: "no", Agreement.NOTHING_SHOWN: "nothing shown"}[found.agreement]
    if found.consistency is Consistency.OVERCONFIDENT:
        return Answer(said, "but overconfident", "bad")
    return Answer(said, "", _TONES[found.agreement])
