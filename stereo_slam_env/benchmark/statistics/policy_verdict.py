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
from stereo_slam_env.benchmark.statistics.differences import Difference, Finding
from stereo_slam_env.benchmark.statistics.measures import (
    CLAIM_AND_TRUTH,
    FINAL_ERROR,
    FINAL_SIGMA,
    POSITION,
    PairwiseTable,
    compare_all,
)
from stereo_slam_env.benchmark.statistics.sentences import sentence
from stereo_slam_env.benchmark.statistics.verdict import Consistency, consistency
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


_UNTRUE = (Consistency.OVERCONFIDENT, Consistency.DOUBTFUL)


@dataclass(frozen=True)
class ClaimAndTruth:
    """A policy against the baseline: the claimed uncertainty of the final position, and the true position error."""

    summary: FilterSummary  # of the policy
    baseline: str
    claim: Difference
    final: Difference  # of the true error in the last frame
    path: Difference  # and along the drive

    @property
    def policy(self) -> str:
        """Label of the policy."""
        return self.summary.filter_name

    @property
    def consistency(self) -> Consistency:
        """Consistency of the filter with this policy."""
        return consistency(self.summary)

    @property
    def agreement(self) -> Agreement:
        """Whether claim and truth show the same."""
        return agreement_of(self.claim, [self.path, self.final])

    @property
    def is_sound(self) -> bool:
        """Whether the claim may be believed."""
        return self.agreement is not Agreement.DISAGREE and self.consistency not in _UNTRUE

    @property
    def words(self) -> str:
        """The comparison in a sentence."""
        return sentence("claim_and_truth", self)


@dataclass(frozen=True)
class PolicyVerdict:
    """Verdict on all policies: the first lines of their report."""

    baseline: str  # the policy that the others are compared with
    best: str | None  # whose filter claims the least uncertainty of the final position, of those that never diverged
    # By label of the other policies; those that cannot be compared are left out.
    comparisons: Mapping[str, ClaimAndTruth]
    compared: PairwiseTable  # each against the baseline, by every measure of `CLAIM_AND_TRUTH`
    summaries: Sequence[FilterSummary]  # of all policies

    @property
    def headline(self) -> str:
        """The policy with the least uncertain pose, and every disagreement, in sentences."""
        return sentence("policies", self)

    def summary_of(self, name: str | None) -> FilterSummary | None:
        """Figures of a policy; None where it has none."""
        return next((s for s in self.summaries if s.filter_name == name), None)

    @property
    def ties(self) -> bool:
        """Whether the best policy claims the same as the baseline, or the baseline the same as another one."""
        rivals = self.comparisons.values() if self.best == self.baseline else [self.comparisons.get(self.best or "")]
        return any(rival is not None and rival.claim.tied for rival in rivals)

    @property
    def doubtful(self) -> list[str]:
        """Policies whose claim is not to be believed."""
        return [c.policy for c in self.comparisons.values() if not c.is_sound]

    @property
    def unseen(self) -> list[str]:
        """Policies whose claim is possible and not shown by the true error."""
        return [c.policy for c in self.comparisons.values() if c.is_sound and c.agreement is Agreement.OPEN]

    @property
    def baseline_consistency(self) -> Consistency:
        """Consistency of the filter with the baseline."""
        return consistency(next(s for s in self.summaries if s.filter_name == self.baseline))


@dataclass(frozen=True, eq=False)
class Looks:
    """Baseline of the policies, and a recording of each competitor."""

    baseline: str  # label of a competitor
    recordings: Mapping[str, Recording]  # of one seed, by label


def agreement_of(claim: Difference, truths: Sequence[Difference]) -> Agreement:
    """Agreement of the claimed difference with the true ones."""
    findings = {difference.finding for difference in truths} - {Finding.NOT_SHOWN}
    if findings == {claim.finding} - {Finding.NOT_SHOWN}:
        return Agreement.AGREE if findings else Agreement.NOTHING_SHOWN
    intervals = [difference.interval for difference in truths if difference.interval is not None]
    possible = all(low <= claim.estimate <= high for low, high in intervals)
    return Agreement.OPEN if not findings and possible else Agreement.DISAGREE


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
            comparisons[summary.filter_name] = ClaimAndTruth(summary, baseline, claim, final, path)
    steady = [s for s in summaries if s.diverged == 0 and s.final_position_sigma_m is not None]
    best = min(steady, key=lambda s: float(s.final_position_sigma_m or 0.0), default=None)
    return PolicyVerdict(baseline, None if best is None else best.filter_name, comparisons, compared, summaries)
