"""Verdict on policies: the uncertainty that the filter claims in the end, the true error, and their agreement.

A policy is paid for what its filter believes, and a filter may believe what is not so. So each policy is held against a
baseline, seed by seed, by both: the claimed uncertainty of the final pose, and the true error, at the end and along the
drive. They agree where both show the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice
from stereo_slam_env.benchmark.statistics.differences import Difference, Finding, listed, percent_words, signed
from stereo_slam_env.benchmark.statistics.measures import (
    CLAIM_AND_TRUTH,
    FINAL_ERROR,
    FINAL_SIGMA,
    POSITION,
    PairwiseTable,
    compare_all,
)
from stereo_slam_env.benchmark.statistics.verdict import (
    Consistency,
    consistency,
    lost_words,
    none_left,
    pose_nees,
    sureness,
)
from stereo_slam_env.evaluation.figures import readable
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.evaluation.run_figures import Figures
from stereo_slam_env.recording.recording import Recording

BASELINE = "fixed"
"""The policy that the others are compared with, where it takes part."""


class Agreement(Enum):
    """Agreement of claim and truth about a policy, against the baseline."""

    AGREE = "claim and truth agree"
    OPEN = "the truth may be as claimed, and does not show it"
    DISAGREE = "claim and truth disagree"
    NOTHING_SHOWN = "neither claim nor truth shows a difference"


_CLAIMS = {
    Consistency.OVERCONFIDENT: "is overconfident",
    Consistency.DOUBTFUL: "cannot be judged before calibration, frames and truth",
    Consistency.CAUTIOUS: "claims more uncertainty than it has",
}
_UNTRUE = (Consistency.OVERCONFIDENT, Consistency.DOUBTFUL)


@dataclass(frozen=True)
class ClaimAndTruth:
    """A policy against the baseline: the claimed uncertainty of the final position, and the true position error."""

    policy: str
    baseline: str
    claim: Difference
    final: Difference  # of the true error in the last frame
    path: Difference  # and along the drive
    consistency: Consistency  # of the filter with this policy
    agreement: Agreement  # whether claim and truth show the same
    words: str

    @property
    def is_sound(self) -> bool:
        """Whether the claim may be believed."""
        return self.agreement is not Agreement.DISAGREE and self.consistency not in _UNTRUE


@dataclass(frozen=True)
class PolicyVerdict:
    """Verdict on all policies: the first lines of their report."""

    baseline: str  # what all others are held against
    best: str | None  # whose filter claims the least uncertainty of the final position, of those that never diverged
    # By label of the other policies; those that cannot be compared are left out.
    comparisons: Mapping[str, ClaimAndTruth]
    compared: PairwiseTable  # each against the baseline, by every measure of `CLAIM_AND_TRUTH`
    headline: str  # the policy with the least uncertain pose, and every disagreement, in sentences


@dataclass(frozen=True, eq=False)
class Looks:
    """Baseline of the policies, and a recording of each competitor."""

    baseline: str  # label of a competitor
    recordings: Mapping[str, Recording]  # of one seed, by label


def baseline_of(competitors: Sequence[FilterChoice]) -> str:
    """Label of the competitor that looks straight ahead; where none does, of the first one."""
    looking = (choice.label for choice in competitors if choice.policy is not None and choice.policy.name == BASELINE)
    return next(looking, competitors[0].label)


def judge_policies(summaries: Sequence[FilterSummary], figures: Figures, *, baseline: str) -> PolicyVerdict:
    """Compare every policy with the baseline, by claimed uncertainty and by true error; raises as `compare_all`.

    Intervals and tests are corrected for the number of policies; each measure stands for itself.
    """
    compared = compare_all(summaries, figures, baseline=baseline, measures=CLAIM_AND_TRUTH)
    comparisons = {}
    for summary in summaries:
        claim, final, path = (
            compared.cell(measure, summary.filter_name, baseline) for measure in (FINAL_SIGMA, FINAL_ERROR, POSITION)
        )
        if claim is not None and final is not None and path is not None:
            comparisons[summary.filter_name] = _compared(summary, baseline, claim, final, path)
    steady = [s for s in summaries if s.diverged == 0 and s.final_position_sigma_m is not None]
    best = min(steady, key=lambda s: float(s.final_position_sigma_m or 0.0), default=None)
    return PolicyVerdict(
        baseline=baseline,
        best=None if best is None else best.filter_name,
        comparisons=comparisons,
        compared=compared,
        headline=_headline(best, summaries, baseline, comparisons),
    )


def _compared(
    summary: FilterSummary, baseline: str, claim: Difference, final: Difference, path: Difference
) -> ClaimAndTruth:
    policy, state, agreement = summary.filter_name, consistency(summary), _agreement(claim, [path, final])
    said = agreement.value
    if claim.too_few:
        said += f", for {claim.evidence}"
    if state in (*_UNTRUE, Consistency.CAUTIOUS):
        but = "and" if agreement is Agreement.DISAGREE else "but"
        what = _CLAIMS[state]
        said += f"; {but} it {what}, {sureness(summary)}: {_nees(summary)}"
    words = f"{_claim(policy, baseline, claim)}, {_truth(path, final)}: {said}."
    return ClaimAndTruth(policy, baseline, claim, final, path, state, agreement, words)


def _agreement(claim: Difference, truths: Sequence[Difference]) -> Agreement:
    """Agreement of the claimed difference with the true ones."""
    findings = {difference.finding for difference in truths} - {Finding.NOT_SHOWN}
    if findings == {claim.finding} - {Finding.NOT_SHOWN}:
        return Agreement.AGREE if findings else Agreement.NOTHING_SHOWN
    intervals = [difference.interval for difference in truths if difference.interval is not None]
    possible = all(low <= claim.estimate <= high for low, high in intervals)
    return Agreement.OPEN if not findings and possible else Agreement.DISAGREE


def _claim(policy: str, baseline: str, claim: Difference) -> str:
    if claim.identical:
        return f"{policy} claims exactly the uncertainty of {baseline}"
    if claim.tied:
        return f"{policy} claims the uncertainty of {baseline}, {claim.tie_words}"
    if not claim.shown:
        return f"{policy} is not shown to claim another uncertainty than {baseline} ({_change(claim)})"
    much = percent_words(claim.percent, "more", "less")
    return f"run by run {policy} claims {much} uncertainty of the final position than {baseline} ({claim.evidence})"


def _truth(path: Difference, final: Difference) -> str:
    parts = [(path, "along the drive"), (final, "at the end")]
    change_words = [f"{percent_words(d.percent)} {where} ({d.interval_words})" for d, where in parts if d.shown]
    if change_words:
        return f"and its true position error is, run by run, {' and '.join(change_words)}"
    open_ones = "; ".join(f"{where} {_change(d)}" for d, where in parts)
    return f"and the true position error does not differ significantly ({open_ones})"


def _nees(summary: FilterSummary) -> str:
    mean, band = pose_nees(summary)
    return f"pose NEES / 6 {mean} where {band} is consistent"


def _change(difference: Difference) -> str:
    is_known = difference.interval is not None and not difference.too_few
    return f"{signed(difference.percent)} %" + (f", {difference.interval_words}" if is_known else "")


def _headline(
    best: FilterSummary | None,
    summaries: Sequence[FilterSummary],
    baseline: str,
    comparisons: Mapping[str, ClaimAndTruth],
) -> str:
    if best is None:
        return none_left(summaries)
    held_against = next(s for s in summaries if s.filter_name == baseline)
    baseline_words = "" if best is held_against else f"; {baseline}: {_account(held_against)}"
    comparison = comparisons.get(best.filter_name)
    rivals = comparisons.values() if best is held_against else [comparison] if comparison is not None else []
    if any(rival.claim.tied for rival in rivals):
        first = f"No policy leaves the pose less uncertain at the end than {baseline}, by its own account"
    else:
        first = f"{best.filter_name} leaves the pose least uncertain at the end, by its own account"
    sentences = [f"{first}: {_account(best)}{baseline_words}."]
    if best.filter_name in comparisons:
        agreement = comparisons[best.filter_name].agreement.value
        sentences.append(f"{agreement[:1].upper()}{agreement[1:]}.")
    doubtful = [c.policy for c in comparisons.values() if not c.is_sound]
    if doubtful:
        sentences.append(f"Not to be taken at its word: {listed(doubtful)}; the lines below say why.")
    unseen = [c.policy for c in comparisons.values() if c.is_sound and c.agreement is Agreement.OPEN]
    if unseen:
        sentences.append(f"Claimed, and possible, but not shown by the true error of so many runs: {listed(unseen)}.")
    if (state := consistency(held_against)) in _UNTRUE:
        sentences.append(f"{baseline} itself {_CLAIMS[state]}, {sureness(held_against)}: {_nees(held_against)}.")
    lost = [f"{s.filter_name} {lost_words(s)}" for s in summaries if s.diverged]
    if lost:
        sentences.append(f"Lost: {listed(lost)}.")
    return " ".join(sentences)


def _account(summary: FilterSummary) -> str:
    sigma, determinant, error = summary.final_position_sigma_m, summary.final_pose_logdet, summary.end_error_m
    claimed = "nothing" if sigma is None else f"σ {readable(sigma)} m"
    claimed += "" if determinant is None else f", log det {determinant:.1f}".replace("-", "−")
    return claimed if error is None else f"{claimed}, true error {readable(error)} m"
