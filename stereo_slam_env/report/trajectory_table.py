"""Scores of trajectories in words and as rows of a table, a column an estimate; on the console."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from rich.console import Console
from rich.markup import escape

from filters.checks.consistency import chi_square_quantile
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.evaluation.claims import COVERED, ClaimScore, fit_of
from stereo_slam_env.evaluation.figures import FIGURES, UNKNOWN, readable
from stereo_slam_env.evaluation.trajectory_runs import RunsScore, labels_of
from stereo_slam_env.evaluation.trajectory_score import TrajectoryScore
from stereo_slam_env.evaluation.windows import WindowScore
from stereo_slam_env.recording.state_beliefs import UNITS_OF
from stereo_slam_env.report.table import Column, Table, show_table

_NOTES = 5
"""Notes on runs that are printed."""
_Row = tuple[str, Callable[[TrajectoryScore], str]]


def show_trajectory_scores(console: Console, scores: Sequence[TrajectoryScore]) -> None:
    """Print errors, claims and windows of estimates against one reference; rows that none of them has are left out."""
    show_table(console, score_table(scores))
    for note in notes_of(scores):
        console.print(f"[yellow]note[/yellow]: {escape(note)}", highlight=False, soft_wrap=True)
    for score in scores:
        console.print(escape(headline(score)), highlight=False, soft_wrap=True)


def show_runs_score(console: Console, score: RunsScore, notes: Sequence[str] = ()) -> None:
    """Print what the runs of one estimator show together, and the first few of the notes on them."""
    if score.claims:
        show_table(console, runs_table(score))
    show_table(console, runs_errors_table(score))
    for note in notes[:_NOTES]:
        console.print(f"[yellow]note[/yellow], {escape(note)}", highlight=False, soft_wrap=True)
    if len(notes) > _NOTES:
        console.print(f"and {len(notes) - _NOTES} more notes: --out writes them", highlight=False)
    console.print(escape(score.words), highlight=False, soft_wrap=True)


def notes_of_runs(scores: Sequence[TrajectoryScore]) -> list[str]:
    """Notes on runs, the most frequent first, with how many runs have them; those that diverged say so elsewhere."""
    counts: Counter[str] = Counter()
    for score in scores:
        if score.diverged_at_s is None:
            heads = (f"{score.estimate}: ", f"{score.reference}: ")
            counts.update({next((n.removeprefix(h) for h in heads if n.startswith(h)), n) for n in score.notes})
    return [f"{count} of {len(scores)} runs: {note}" for note, count in counts.most_common()]


def runs_table(score: RunsScore) -> Table:
    """Claims of several runs together, on the pose, its parts, velocity and biases, a row each.

    The verdict has the errors in claimed standard deviations.
    """
    numbers = (Column("ANEES / dof"), Column("95 % band"), Column("frames in it", "%"), Column("one by one"))
    columns = [Column("claim on", kind="text"), Column("runs"), *numbers, Column("verdict", kind="words")]
    rows = []
    for name, claim in score.claims.items():
        mean, low, high, least, most = (
            readable(value / claim.dof) for value in (claim.mean, *claim.band, min(claim.each), max(claim.each))
        )
        share, runs = f"{100.0 * claim.inside:.0f}", f"{len(claim.each)}"
        rows.append([name, runs, mean, f"{low} to {high}", share, f"{least} to {most}", claim.short_verdict])
    return Table(columns, rows)


def runs_errors_table(score: RunsScore) -> Table:
    """Errors of several runs that did not diverge, and how many did and failed, a row each."""
    units = {"position": "m", "rotation": "degrees"} | UNITS_OF
    columns = [
        Column(f"{score.total} runs, aligned: {score.alignment}", kind="text"),
        Column("mean"),
        Column("worst"),
        Column("runs"),
    ]
    rows = [
        [f"{name} RMSE, {units[name]}", readable(error.mean), readable(error.worst), f"{error.runs}"]
        for name, error in score.errors.items()
    ]
    if when := sorted(score.diverged.values()):
        median = readable(float(np.median(when)))
        rows.append(["diverged, s after the start (median, first)", median, readable(when[0]), f"{len(when)}"])
    else:
        rows.append(["diverged", UNKNOWN, UNKNOWN, "0"])
    if score.ended_early:
        shares = list(score.ended_early.values())
        mean, worst = (f"{100.0 * share:.0f}" for share in (np.mean(shares), min(shares)))
        rows.append(["ended early, % of the longest (mean, first)", mean, worst, f"{len(shares)}"])
    rows.append(["left nothing to score", UNKNOWN, UNKNOWN, f"{len(score.failed)}"])
    return Table(columns, rows)


def notes_of(scores: Sequence[TrajectoryScore]) -> list[str]:
    """Notes on the scores, each sentence once; of several estimates, with the name of the one that it is on."""
    notes = ((score.estimate, note) for score in scores for note in (*score.notes, unusable_note(score)) if note)
    named = (note if len(scores) == 1 or name in note else f"{name}: {note}" for name, note in notes)
    return list(dict.fromkeys(named))


def score_table(scores: Sequence[TrajectoryScore]) -> Table:
    """Errors, claims and windows, a column an estimate; rows that none of them has are left out."""
    columns = [Column(f"against {scores[0].reference}", kind="text"), *map(Column, labels_of(scores))]
    kinds = {(name, claim.dof): None for score in scores for name, claim in score.claims.items()}
    claims = [row for kind in kinds for row in _claim_rows(*kind)]
    figures = [*_ERRORS, *map(_state_row, UNITS_OF), *claims, *_windows(scores)]
    rows = [(title, [text(score) for score in scores]) for title, text in figures]
    return Table(columns, [[title, *cells] for title, cells in rows if set(cells) != {UNKNOWN}])


def headline(score: TrajectoryScore) -> str:
    """The verdict on one estimate, in a sentence."""
    error = FIGURES["position_rmse_m"].text(score.position_rmse_m)
    claim = score.claim
    claim_words = f"its covariance is {score.verdict}"
    if claim is None:
        states = ", ".join(f"{name} is {fit_of(one.nees.mean, one.band)}" for name, one in score.claims.items())
        claim_words = "it claims no covariance" + (
            f" of its pose; as far as one run can tell {states}" if states else ""
        )
    elif claim.obstacle:
        claim_words = f"its covariance is not judged ({claim.obstacle})"
    elif claim.of_a_pair:
        claim_words = score.verdict
    return f"{score.estimate}: position error {error} m RMS over {readable(score.path_m)} m; {claim_words}."


def unusable_note(score: TrajectoryScore) -> str:
    """How many covariances of an estimate are none; empty where all are usable."""
    if not score.unusable:
        return ""
    return f"{score.estimate} has {score.unusable} covariances that are not positive definite: what it claims is none"


def alignment_text(score: TrajectoryScore) -> str:
    """How the worlds were aligned, and by how many poses."""
    by = f" by {score.aligned_by} poses" if score.aligned_by > 1 else ""
    return score.alignment + by + (f", scale {score.scale:.4g}" if score.alignment == "sim3" else "")


def _frames(score: TrajectoryScore) -> str:
    return f"{score.frames}" + (f" ({score.unmatched} more without reference)" if score.unmatched else "")


def _figure(name: str) -> _Row:
    """A figure that runs of filters have, too."""
    figure = FIGURES[name]
    return figure.title, lambda score: UNKNOWN if (value := getattr(score, name)) is None else figure.text(value)


def _state_row(name: str) -> _Row:
    """The error of a state beside the pose."""
    title = f"{name} RMSE, {UNITS_OF[name]}"
    return title, lambda score: readable(score.state_rmse[name]) if name in score.state_rmse else UNKNOWN


def _of(name: str, dof: int, text: Callable[[ClaimScore], str]) -> Callable[[TrajectoryScore], str]:
    return lambda score: text(claim) if (claim := score.claims.get(name)) and claim.dof == dof else UNKNOWN


def _nees(claim: ClaimScore) -> str:
    mean = claim.nees
    return f"{mean.mean / claim.dof:.2f} [{mean.low / claim.dof:.2f}, {mean.high / claim.dof:.2f}]"


def _distances(claim: ClaimScore) -> str:
    if claim.crps is None or claim.energy_score is None:
        return UNKNOWN
    return f"{readable(claim.crps)}, {readable(claim.energy_score)}"


def _scale_gap(claim: ClaimScore) -> str:
    changed = abs(claim.claimed_scale_gap / claim.scale_gap - 1.0) > 1e-9 if claim.scale_gap else False
    return readable(claim.scale_gap) + (f" (as claimed {readable(claim.claimed_scale_gap)})" if changed else "")


def _coverage(claim: ClaimScore) -> str:
    return " / ".join(f"{100.0 * claim.coverage[p]:.0f}" for p in COVERED)


def _claim_rows(name: str, dof: int) -> list[_Row]:
    of, shares = partial(_of, name, dof), " / ".join(f"{100.0 * p:.0f}" for p in COVERED)
    low, high = (end / dof for end in mean_band(dof, 1))
    return [
        (f"{name} NEES / {dof} [95 %] (one run: {low:.2f} to {high:.2f})", of(_nees)),
        (f"  scale gap k, median NEES / {chi_square_quantile(0.5, dof):.2f}", of(_scale_gap)),
        (f"  inside the {shares} % ellipsoid, %", of(_coverage)),
        ("  log score = calibration + sharpness, nats", of(_log_score)),
        ("  CRPS, energy score, m", of(_distances)),
        ("  claim", of(lambda claim: "not judged" if claim.obstacle else claim.verdict)),
    ]


def gauge_table(scores: Sequence[TrajectoryScore]) -> Table:
    """The claim on the pose under each alignment: a row an alignment and estimate."""
    columns = [Column("estimate", kind="text"), Column("alignment", kind="text")]
    columns += [Column("position RMSE", unit="m"), Column("NEES / dof"), Column("verdict", kind="words")]
    rows = [
        [score.estimate, one.alignment, readable(one.position_rmse_m), readable(one.nees / one.dof), one.verdict]
        for score in scores
        for one in score.gauges
    ]
    return Table(columns, rows)


def _log_score(claim: ClaimScore) -> str:
    return f"{claim.log_score.mean:.2f} = {claim.calibration:.2f} {claim.sharpness:+.2f}"


def _windows(scores: Sequence[TrajectoryScore]) -> list[_Row]:
    lengths = sorted({window.seconds for score in scores for window in score.windows})
    rows: list[_Row] = []
    for seconds in lengths:

        def text(value: Callable[[WindowScore], str], seconds: float = seconds) -> Callable[[TrajectoryScore], str]:
            return lambda score: next((value(w) for w in score.windows if w.seconds == seconds), UNKNOWN)

        def claimed(window: WindowScore) -> str:
            if window.nees is None:
                return UNKNOWN
            value = f"{window.nees / 6.0:.2f}"
            return f"≥ {value}" if window.coverage is None else f"{value} ({100.0 * window.coverage:.0f} % inside)"

        def error(window: WindowScore) -> str:
            return f"{window.translation_rmse_m:.3f} m, {window.rotation_rmse_deg:.3f}° ({window.windows})"

        rows.append((f"motion over {seconds:g} s, RMSE (windows)", text(error)))
        rows.append(("  its NEES / 6 (share inside the 90 % ellipsoid)", text(claimed)))
    return rows


_ERRORS: list[_Row] = [
    ("scored poses", _frames),
    ("aligned", alignment_text),
    *map(_figure, ("path_m", "position_rmse_m", "rotation_rmse_deg", "ate_rigid_m", "end_drift_percent")),
]
