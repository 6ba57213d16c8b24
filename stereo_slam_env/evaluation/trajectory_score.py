"""Judgement of anybody's trajectory against a reference: errors, and whether the covariance claimed for it is true.

What a reference claims of its own errors is added to what the estimate claims. The log score of a Gaussian belief is
half its NEES ("calibration") plus half the log volume of its covariance ("sharpness"): the smaller, the better.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from filters import Pose
from filters.contract.validation import finite_number, positive
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.bands import block_length, mean_interval, stationary_rows
from stereo_slam_env.evaluation.body_frames import find_body_offset
from stereo_slam_env.evaluation.claims import ClaimScore, GaugeScore, claims_differ, score_claims, score_gauges
from stereo_slam_env.evaluation.comparability import explanation, find_obstacles, gauge_of, without_fillers
from stereo_slam_env.evaluation.gauges import (
    UP,
    AlignmentKind,
    Correlation,
    aligned_pair,
    find_alignment,
    is_fixed_at_start,
    is_zero_at_start,
)
from stereo_slam_env.evaluation.paired_verdict import PairedVerdict
from stereo_slam_env.evaluation.state_claims import score_states
from stereo_slam_env.evaluation.synchronisation import FEWEST, MAX_GAP, find_time_offset, paired, shifted
from stereo_slam_env.evaluation.windows import LENGTHS, WindowScore, score_windows
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import load_trajectory

SCHEMA = 5
"""Version of what `TrajectoryScore.as_dict` gives."""


@dataclass(frozen=True, eq=False)
class TrajectoryScore:
    """A trajectory against a reference. Poses that the alignment fixes, as the first one of "start", are not scored."""

    estimate: str
    """Name of the estimate."""
    reference: str
    """Name of the reference."""
    alignment: AlignmentKind
    """How the world of the estimate was brought to that of the reference."""
    aligned_by: int
    """Poses that determined it."""
    scale: float
    """By which the estimate's positions were multiplied."""
    correlation: Correlation
    """How errors of two poses were taken to be correlated where the claim was carried through the alignment."""
    time_offset_s: float
    """Added to the times of the estimate, s."""
    frames: int
    """Scored poses."""
    unmatched: int
    """Poses of the estimate without one of the reference."""
    unusable: int
    """Scored poses whose covariance is not positive definite."""
    covered: float | None
    """Share of the reference's time from the first to the last pair; None where it has no times."""
    path_m: float
    """Length of the reference's path, m."""
    position_rmse_m: float
    """Root mean square of the distance, m."""
    rotation_rmse_deg: float | None
    """Root mean square of the angle, degrees; None where positions alone are compared."""
    ate_rigid_m: float
    """Position RMSE after the best rigid motion, m."""
    end_drift_percent: float | None
    """None where the reference stands still."""
    diverged_at_s: float | None
    """Time from the first pair after which the estimate is no trajectory of this drive, s; None where it is one."""
    claims: Mapping[str, ClaimScore]
    """"pose", "position", "rotation", or "position" alone; "velocity", "gyro-bias" and "accelerometer-bias" where they
    are claimed and the reference has them; empty where nothing is claimed."""
    state_rmse: Mapping[str, float]
    """Root mean square of the error of each of these three, m/s, rad/s and m/s^2; empty where there are none."""
    gauges: tuple[GaugeScore, ...]
    """The claim on the pose under each alignment that the poses determine; empty where nothing is claimed."""
    gauge_is_open: bool
    """Whether neither the caller nor the file says the alignment."""
    windows: tuple[WindowScore, ...]
    """Motion over windows."""
    notes: tuple[str, ...]
    """What was left out, taken for granted or found to be strange, each in a sentence."""
    times: FloatArray = field(repr=False)
    """(N,), s, of the scored poses."""
    poses: Trajectory = field(repr=False)
    """They, in the world of the reference, with what they and the reference claim, carried through the alignment."""
    reference_poses: Trajectory = field(repr=False)
    """The reference's."""
    nees: Mapping[str, FloatArray] = field(repr=False)
    """(N,) of each claim."""
    log_scores: Mapping[str, FloatArray] = field(repr=False)
    """(N,) of each claim."""

    @property
    def position_errors(self) -> FloatArray:
        """Position errors (N, 3) in W, m."""
        return self.reference_poses.positions - self.poses.positions

    @property
    def claim(self) -> ClaimScore | None:
        """The claim that the verdict is on: of the pose, or of the position where that is all there is."""
        return self.claims.get("pose", self.claims.get("position"))

    @property
    def depends_on_the_gauge(self) -> bool:
        """Whether no header says the gauge, and the claim on the pose is another one under another alignment."""
        return self.gauge_is_open and claims_differ(self.gauges)

    @property
    def verdict(self) -> str:
        """The verdict on the claim, in words."""
        if (claim := self.claim) is None:
            return "none: no covariance is claimed"
        if not self.depends_on_the_gauge or claim.obstacle:
            return claim.verdict
        dof, ratios = (self.gauges[0].dof, (f"{one.nees / one.dof:.3g} ({one.alignment})" for one in self.gauges))
        doubt = "but it depends on the alignment, which no header says"
        return f"{claim.verdict}; {doubt}: NEES / {dof} is {', '.join(ratios)}"

    def _repr_html_(self) -> str:
        from stereo_slam_env.recording import notebook_html as html

        drift = "" if self.end_drift_percent is None else f", {self.end_drift_percent:.3g} % at the end"
        rows = {
            "poses": f"{self.frames} scored, {self.unmatched} without a reference",
            "alignment": self.alignment
            + (f" by {self.aligned_by} poses, scale {self.scale:.4g}" if self.aligned_by else ""),
            "position": f"{self.position_rmse_m:.4g} m of {self.path_m:.4g} m{drift}",
            "rotation": "-" if self.rotation_rmse_deg is None else f"{self.rotation_rmse_deg:.3g} degrees",
            "claim": self.verdict,
        }
        for name, claim in self.claims.items():
            rows[f"NEES / {claim.dof}, {name}"] = f"{claim.nees.mean / claim.dof:.3g}"
        distances = np.linalg.norm(self.position_errors, axis=1)
        chart = html.lines_chart({"distance from the reference": (self.times, distances)}, "s", "m")
        notes_html = "".join(map(html.paragraph, self.notes))
        return html.heading(f"{self.estimate} against {self.reference}") + html.facts(rows) + chart + notes_html

    def as_dict(self) -> dict[str, Any]:
        """All figures as plain data for JSON, without the series; `docs/evaluate.md` has what they are."""
        series = {"times", "poses", "reference_poses", "nees", "log_scores"}
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in series}
        claims = {
            name: asdict(claim)
            | {"coverage": {f"{p:g}": share for p, share in claim.coverage.items()}, "verdict": claim.verdict}
            for name, claim in self.claims.items()
        }
        gauges = [asdict(one) | {"verdict": one.verdict} for one in self.gauges]
        lists = {"gauges": gauges, "windows": [asdict(one) for one in self.windows]}
        words = {"verdict": self.verdict, "depends_on_the_gauge": self.depends_on_the_gauge, "notes": list(self.notes)}
        return {"schema": SCHEMA} | plain | {"claims": claims} | lists | words

    def against(self, other: TrajectoryScore) -> PairedVerdict:
        """This estimate against another one of the same drive, on the frames that both have.

        Raises
        ------
        ValueError
            They have too few frames in common.
        """
        _, mine, theirs = np.intersect1d(self.times, other.times, return_indices=True)
        if len(mine) < FEWEST:
            raise ValueError(
                f"{self.estimate} and {other.estimate} have {len(mine)} scored poses in common, {FEWEST} are needed: "
                "give estimates of the same drive"
            )
        a, b = np.square(self.position_errors[mine]).sum(axis=1), np.square(other.position_errors[theirs]).sum(axis=1)
        rows = stationary_rows(len(a), max(block_length(a - b), 1.0), np.random.default_rng(0))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = float(np.sqrt(a.mean() / b.mean()))
            low, high = np.quantile(np.sqrt(a[rows].mean(axis=1) / b[rows].mean(axis=1)), [0.025, 0.975])
        scores = None
        judged = [one.claim and not one.unusable and not one.claim.obstacle for one in (self, other)]
        name = "pose" if "pose" in self.claims else "position"
        if all(judged) and name in other.claims and self.claims[name].dof == other.claims[name].dof:
            scores = mean_interval(self.log_scores[name][mine] - other.log_scores[name][theirs])
        return PairedVerdict(self.estimate, other.estimate, len(mine), (ratio, float(low), float(high)), scores)


def evaluate_trajectory(
    estimate: Trajectory | str | Path,
    reference: Trajectory | str | Path,
    *,
    align: AlignmentKind | None = None,
    align_seconds: float | None = None,
    up: str = "z",
    body: Pose | Literal["estimated"] | None = None,
    time_offset: float | Literal["auto"] = 0.0,
    interpolate: bool = False,
    max_gap: float = MAX_GAP,
    pair: bool = False,
) -> TrajectoryScore:
    """Judge a trajectory against a reference: its errors, and the covariance that is claimed for them.

    Parameters
    ----------
    estimate : Trajectory, str or Path
        The trajectory, or a file as `load_trajectory` reads it.
    reference : Trajectory, str or Path
        Its own covariances, if it has any, are added to those of the estimate; so it may be a second estimate.
    align : {"none", "start", "gravity-yaw", "rigid", "sim3"}, optional
        How the estimate is brought into the world of the reference. None: by the gauge that the estimate was made in,
        "start" where what it claims is zero there.
    align_seconds : float, optional
        Align by the poses of so many seconds from the first one; 0: by the first pose. None: by all.
    up : {"x", "y", "z"}
        Axis of the reference's world that gravity is along, for "gravity-yaw".
    body : Pose or "estimated", optional
        Pose T_bc of the reference's body in that of the estimate, m; "estimated": the one that fits best. None: they
        are the same.
    time_offset : float or "auto"
        Added to the times of the estimate, s; "auto": the one up to 1 s that fits best.
    interpolate : bool
        Take the reference at the times of the estimate, between its poses, in place of the nearest pose.
    max_gap : float
        Largest difference between the times of a pose and its reference, s.
    pair : bool
        The reference is another estimate of the same drive, with covariances of its own: do the two contradict each
        other? Then the alignment, if none is given, is "start" where both claim nothing there, else "rigid".

    Returns
    -------
    TrajectoryScore
        All figures; those of the covariance are left out where there is none.

    Raises
    ------
    ValueError
        A file is damaged, there are too few poses in common, the bodies are named and differ, the alignment, the
        offset or the body is not determined, or no covariance is positive definite.
    """
    estimate, reference = _loaded(estimate), _loaded(reference)
    max_gap = positive("max_gap", max_gap)
    if align is not None and align not in get_args(AlignmentKind):
        raise ValueError(f"align must be one of {', '.join(get_args(AlignmentKind))}, got {align!r}")
    if up not in UP:
        raise ValueError(f"up must be one of {', '.join(UP)}, got {up!r}")
    if body is None and estimate.body and reference.body and estimate.body != reference.body:
        raise ValueError(
            f"estimate has poses of {estimate.body}, reference of {reference.body}: give both for the same body, or "
            f"the pose of {reference.body} in {estimate.body} as body"
        )
    notes = [f"{one.name}: {note}" for one in (estimate, reference) for note in one.notes]
    if reference.plane is not None and estimate.plane is None:
        reference = replace(reference, covariances=None, plane=None)
        if estimate.covariances is not None:
            notes.append(f"what {reference.name} claims in a plane is not added to a claim of the whole pose")
    offset = (
        find_time_offset(estimate, reference) if time_offset == "auto" else finite_number("time_offset", time_offset)
    )
    if offset:
        estimate = shifted(estimate, offset)
    try:
        pairs = paired(estimate, reference, max_gap, interpolate)
    except ValueError as error:
        raise ValueError(f"{error}{_other_clock(estimate, reference)}") from error
    matched, truth, fillers = without_fillers(pairs.estimate, pairs.reference)
    pairs = replace(pairs, estimate=matched, reference=truth)
    notes += fillers
    if not matched.is_oriented and (body is not None or align == "start"):
        what = "body" if body is not None else "align 'start'"
        raise ValueError(f"{what} needs orientations, and positions alone are to be had: align by 'rigid', or 'none'")
    if body is not None:
        T_bc = body if isinstance(body, Pose) else find_body_offset(pairs.estimate, pairs.reference).T_bc
        pairs = replace(pairs, estimate=pairs.estimate.of_body(T_bc))
        if not isinstance(body, Pose):
            notes.append(f"the body was moved {np.linalg.norm(T_bc.position):.3g} m by what fits best: errors are low")
    matched, truth = pairs.estimate, pairs.reference
    usual, said = gauge_of(matched, truth)
    if pair:
        if truth.covariances is None or matched.covariances is None:
            raise ValueError("pair needs covariances in both files: without a truth they are all there is to judge")
        usual, said = ("start" if is_zero_at_start(matched) and is_zero_at_start(truth) else "rigid"), ""
    if not matched.is_oriented and usual == "start":
        usual = "rigid"
    if align is None and said:
        notes.append(said)
    rows = _rows_within(truth, align_seconds)
    if not matched.is_oriented and np.count_nonzero(rows) < FEWEST and (align or usual) != "none":
        raise ValueError(f"align_seconds leaves {np.count_nonzero(rows)} positions to align by: give more seconds")
    is_fixed = is_fixed_at_start(matched)
    if align is None and align_seconds is None and usual == "gravity-yaw" and is_fixed:
        rows = np.arange(len(matched)) == 0
        notes.append("aligned by the first pose, whose position is claimed to be known, and with it the heading")
    alignment = find_alignment(align or usual, matched, truth, rows, UP[up])
    by_one = alignment.rows.sum() == 1
    is_exact = alignment.kind == "none" or bool(
        by_one and (is_zero_at_start(matched) or (alignment.kind == "gravity-yaw" and is_fixed))
    )
    in_world = aligned_pair(matched, truth, alignment)
    findings = find_obstacles(pairs, (estimate, reference), in_world)
    stamps = truth.timestamps if truth.timestamps is not None else matched.timestamps
    times = np.arange(len(matched), dtype=np.float64) if stamps is None else stamps
    timed = stamps is not None and in_world.estimate.is_oriented
    windows = [score_windows(s, in_world.estimate, in_world.reference, times) for s in LENGTHS if timed]
    scored = in_world.rows(in_world.scored)
    aligned, truth = scored.estimate, scored.reference
    obstacles = findings.verdicts
    claims = score_claims(scored, obstacles, pair)
    bands = {name: claim.band for name, claim in claims.claims.items()}
    doubted = pair or "pose" not in claims.claims or any(obstacles.values())
    if not doubted and (why := explanation(bands, scored)):
        claims = score_claims(scored, dict.fromkeys(obstacles, f"calibration, frames or truth: {why}"), pair)
        notes.append(why)
    states = score_states(scored, obstacles["pose"], is_exact=is_exact, of_a_pair=pair)
    path = metrics.path_length(truth.positions)
    return TrajectoryScore(
        estimate=estimate.name,
        reference=reference.name,
        alignment=alignment.kind,
        aligned_by=int(alignment.rows.sum()),
        scale=alignment.scale,
        correlation=in_world.correlation,
        time_offset_s=offset,
        frames=len(aligned),
        unmatched=len(estimate) - len(pairs.rows),
        unusable=next((claim.unusable for claim in claims.claims.values()), 0),
        covered=_covered(pairs.reference, reference),
        path_m=path,
        position_rmse_m=metrics.ate_unaligned(aligned.positions, truth.positions),
        rotation_rmse_deg=_rotation_rmse_deg(aligned.orientations, truth.orientations) if aligned.is_oriented else None,
        ate_rigid_m=metrics.ate_rigid(aligned.positions, truth.positions),
        end_drift_percent=metrics.end_drift_percent(aligned.positions, truth.positions) if path > 0 else None,
        diverged_at_s=findings.diverged_at_s,
        claims={**claims.claims, **states.claims},
        state_rmse=states.rmse,
        gauges=score_gauges(matched, pairs.reference, in_world),
        gauge_is_open=align is None and not pair and matched.gauge is None and not is_zero_at_start(matched),
        windows=tuple(window for window in windows if window is not None),
        notes=(*notes, *findings.notes, *states.notes),
        times=times[in_world.scored],
        poses=replace(aligned, covariances=scored.covariances),
        reference_poses=truth,
        nees={**claims.nees, **states.nees},
        log_scores={**claims.log_scores, **states.log_scores},
    )


def _loaded(trajectory: Trajectory | str | Path) -> Trajectory:
    return trajectory if isinstance(trajectory, Trajectory) else load_trajectory(trajectory)


def _other_clock(estimate: Trajectory, reference: Trajectory) -> str:
    """The offset of the clocks that would bring trajectories together, in words; empty where none is found."""
    try:
        offset = find_time_offset(estimate, reference)
    except ValueError:
        return ""
    if abs(offset) < MAX_GAP:
        return ""
    return f"; the paths fit with {offset:+.3f} s added to the times of the estimate: --time-offset auto does that"


def _covered(common: Trajectory, whole: Trajectory) -> float | None:
    if common.timestamps is None or whole.timestamps is None:
        return None
    return float(np.ptp(common.timestamps) / np.ptp(whole.timestamps))


def _rows_within(reference: Trajectory, seconds: float | None) -> BoolArray:
    """The poses to align by."""
    if seconds is None:
        return np.ones(len(reference), dtype=bool)
    if reference.timestamps is None:
        raise ValueError("align_seconds needs times, and the reference has none: align by all, or by 'start'")
    positive("align_seconds", seconds, allow_zero=True)
    return np.asarray(reference.timestamps <= reference.timestamps[0] + seconds)


def _rotation_rmse_deg(estimate: FloatArray, reference: FloatArray) -> float:
    return float(np.rad2deg(metrics.root_mean_square(metrics.rotation_errors(estimate, reference))))
