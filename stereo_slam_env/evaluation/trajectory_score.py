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
from scipy.stats import chi2

from filters import Pose, nees
from filters.consistency import are_definite
from filters.geometry import rotations
from filters.geometry.poses import relative_jacobian
from filters.motions.model import POSE_SIZE, POSITION, ROTATION
from filters.validation import FloatArray, IntArray, positive
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.bootstrap import MeanInterval, block_length, mean_interval, stationary_rows
from stereo_slam_env.evaluation.consistency import DOF, mean_band
from stereo_slam_env.evaluation.windows import WINDOWS, window_ends
from stereo_slam_env.recording.trajectory import Trajectory, pose_errors, tangent_jacobian, transformed
from stereo_slam_env.recording.trajectory_files import load_trajectory

COVERED = (0.5, 0.9, 0.95)
"""Probabilities of the ellipsoids whose coverage is counted."""
MAX_GAP = 0.01  # s, between an estimate and its reference
FEWEST = 3  # scored poses
_PARTS = {"pose": slice(0, POSE_SIZE), "position": POSITION, "rotation": ROTATION}
_LINE = 1e-3  # a path whose width is a smaller share of its length is a line

Alignment = Literal["none", "start", "rigid"]
"""As it is; first pose on first pose; all positions on all, by the best rigid motion."""


@dataclass(frozen=True)
class ClaimScore:
    """A claimed covariance against the errors: of the pose (6 numbers), the position or the rotation (3 each)."""

    dof: int
    frames: int  # scored: those with a covariance that is one
    unusable: int  # frames whose covariance is not positive definite: what is claimed of them has no score
    nees: MeanInterval  # over frames; `dof` is ideal; with the 95 % interval of the block bootstrap
    median_nees: float
    band: tuple[float, float]  # two-sided 95 % band of the mean of one run, as of one frame
    scale_gap: float  # k, median NEES by that of chi-square: the factor by which the covariance is too small
    coverage: Mapping[float, float]  # share of frames inside the ellipsoid of each probability
    log_score: MeanInterval  # -log density of the truth, nats: calibration + sharpness
    calibration: float  # mean of NEES / 2
    sharpness: float  # mean of (log det + dof log 2 pi) / 2

    @property
    def verdict(self) -> str:
        """What one run can tell of the claim, in words."""
        if self.unusable:
            return f"none: {self.unusable} of {self.frames + self.unusable} covariances are not positive definite"
        low, high = self.band
        if low <= self.nees.mean <= high:
            return "consistent, as far as one run can tell"
        return f"too {'tight' if self.nees.mean > high else 'loose'}, by {self.per_axis:.3g} per axis"

    @property
    def per_axis(self) -> float:
        """Factor of the standard deviations, > 1, by the mean NEES."""
        factor = float(np.sqrt(self.nees.mean / self.dof))
        return max(factor, 1.0 / factor) if factor > 0 else float("inf")


@dataclass(frozen=True)
class WindowScore:
    """Motion over windows of a length, which do not overlap, as seen from their first pose."""

    seconds: float
    windows: int
    translation_rmse_m: float
    rotation_rmse_deg: float
    # Mean NEES, 6 is ideal. A file does not say how the errors of two poses are correlated; taken as independent they
    # make a difference too uncertain, so this is a lower bound. None without covariances, or where one is none.
    least_nees: float | None


@dataclass(frozen=True, eq=False)
class TrajectoryScore:
    """A trajectory against a reference. Where both start at a given pose, the first one is not scored."""

    estimate: str
    reference: str
    alignment: Alignment
    frames: int  # scored
    unmatched: int  # poses of the estimate without one of the reference
    unusable: int  # scored poses whose covariance is not positive definite
    path_m: float
    position_rmse_m: float
    rotation_rmse_deg: float
    ate_rigid_m: float
    end_drift_percent: float | None  # None where the reference stands still
    claims: Mapping[str, ClaimScore]  # "pose", "position", "rotation"; empty where nothing is claimed
    windows: tuple[WindowScore, ...]
    # Frame by frame: times (N,), the scored poses in the world of the reference, with what they and the reference
    # claim as covariances, the reference's poses, and of each claim NEES and log score (N,).
    times: FloatArray = field(repr=False)
    poses: Trajectory = field(repr=False)
    reference_poses: Trajectory = field(repr=False)
    nees: Mapping[str, FloatArray] = field(repr=False)
    log_scores: Mapping[str, FloatArray] = field(repr=False)

    @property
    def position_errors(self) -> FloatArray:
        """Position errors (N, 3) in W, m."""
        return self.reference_poses.positions - self.poses.positions

    def as_dict(self) -> dict[str, Any]:
        """All but what is frame by frame, JSON-able."""
        series = ("times", "poses", "reference_poses", "nees", "log_scores")
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in series}
        claims = {
            name: {**asdict(claim), "coverage": {f"{p:g}": share for p, share in claim.coverage.items()}}
            | {"verdict": claim.verdict}
            for name, claim in self.claims.items()
        }
        return plain | {"claims": claims, "windows": [asdict(window) for window in self.windows]}

    def against(self, other: TrajectoryScore) -> PairedVerdict:
        """This estimate against another one of the same drive, on the frames that both have.

        Raises
        ------
        ValueError
            They have too few frames in common.
        """
        _, mine, others = np.intersect1d(self.times, other.times, return_indices=True)
        if len(mine) < FEWEST:
            raise ValueError(
                f"{self.estimate} and {other.estimate} have {len(mine)} scored poses in common, {FEWEST} are needed: "
                "give estimates of the same drive"
            )
        a, b = np.square(self.position_errors[mine]).sum(axis=1), np.square(other.position_errors[others]).sum(axis=1)
        rows = stationary_rows(len(a), max(block_length(a - b), 1.0), np.random.default_rng(0))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = float(np.sqrt(a.mean() / b.mean()))
            low, high = np.quantile(np.sqrt(a[rows].mean(axis=1) / b[rows].mean(axis=1)), [0.025, 0.975])
        scores = None
        if "pose" in self.claims and "pose" in other.claims and not self.unusable and not other.unusable:
            difference = self.log_scores["pose"][mine] - other.log_scores["pose"][others]
            scores = mean_interval(difference)
        return PairedVerdict(self.estimate, other.estimate, len(mine), (ratio, float(low), float(high)), scores)


@dataclass(frozen=True)
class PairedVerdict:
    """One estimate against another one on the same frames of one drive."""

    estimate: str
    other: str
    frames: int
    error_ratio: tuple[float, float, float]  # of the position RMSE, with its 95 % interval; < 1: the first is better
    log_score_difference: MeanInterval | None  # nats a frame; < 0: the first is better; None: no claim to score

    @property
    def words(self) -> str:
        """The verdict in two sentences."""
        ratio, low, high = self.error_ratio
        shown = self._better(low < 1.0 and high < 1.0, low > 1.0 and high > 1.0)
        text = f"Position error: {ratio:.3g} [{low:.3g}, {high:.3g}] times that of {self.other}: {shown}."
        if self.log_score_difference is None:
            return text
        found = self.log_score_difference
        shown = self._better(found.high < 0.0, found.low > 0.0)
        return f"{text} Log score of the pose: {found.mean:+.3g} [{found.low:+.3g}, {found.high:+.3g}] nats: {shown}."

    def _better(self, first: bool, second: bool) -> str:
        return f"{self.estimate} is better" if first else f"{self.other} is better" if second else "no difference shown"


def evaluate_trajectory(
    estimate: Trajectory | str | Path,
    reference: Trajectory | str | Path,
    *,
    align: Alignment | None = None,
    max_gap: float = MAX_GAP,
) -> TrajectoryScore:
    """Judge a trajectory against a reference: its errors, and the covariance that is claimed for them.

    Parameters
    ----------
    estimate : Trajectory, str or Path
        The trajectory, or a file as `load_trajectory` reads it.
    reference : Trajectory, str or Path
        Of the same body. Its own covariances, if it has any, are added to those of the estimate.
    align : {"none", "start", "rigid"}, optional
        How the estimate is brought into the world of the reference. None: as its file says, "rigid" where it has a
        world of its own.
    max_gap : float
        Largest difference between the times of a pose and its reference, s.

    Returns
    -------
    TrajectoryScore
        All figures; those of the covariance are left out where there is none.

    Raises
    ------
    ValueError
        A file is damaged, there are too few poses in common, the bodies differ, the alignment is not determined, or no
        covariance is positive definite.
    """
    estimate, reference = _loaded(estimate), _loaded(reference)
    max_gap = positive("max_gap", max_gap)
    if align is not None and align not in get_args(Alignment):
        raise ValueError(f"align must be one of {', '.join(get_args(Alignment))}, got {align!r}")
    if estimate.body and reference.body and estimate.body != reference.body:
        raise ValueError(
            f"estimate has poses of {estimate.body}, reference of {reference.body}: give both for the same body"
        )
    how: Alignment = align or ("rigid" if estimate.gauge == "se3" else "none")
    ours, theirs = _pairs(estimate, reference, max_gap)
    matched, truth = estimate.rows(ours), reference.rows(theirs)
    matched = matched.moved(_alignment(how, matched, truth))
    times = np.arange(len(ours), dtype=np.float64)
    if (stamps := truth.timestamps if truth.timestamps is not None else matched.timestamps) is not None:
        times = stamps
    covariances = _claimed(matched, truth)
    timed = estimate.timestamps is not None or reference.timestamps is not None
    windows = tuple(_window(length, matched, truth, times) for length in WINDOWS) if timed else ()
    scored = slice(0 if how == "rigid" else 1, None)
    matched, truth, times = matched.rows(scored), truth.rows(scored), times[scored]
    covariances = None if covariances is None else covariances[scored]
    claims, series, scores = _claims(matched, truth, covariances)
    path = metrics.path_length(truth.positions)
    return TrajectoryScore(
        estimate=estimate.name,
        reference=reference.name,
        alignment=how,
        frames=len(times),
        unmatched=len(estimate) - len(ours),
        unusable=int(np.isnan(series["pose"]).sum()) if series else 0,
        path_m=path,
        position_rmse_m=metrics.ate_unaligned(matched.positions, truth.positions),
        rotation_rmse_deg=_rotation_rmse_deg(matched.orientations, truth.orientations),
        ate_rigid_m=metrics.ate_rigid(matched.positions, truth.positions),
        end_drift_percent=metrics.end_drift_percent(matched.positions, truth.positions) if path > 0 else None,
        claims=claims,
        windows=tuple(window for window in windows if window.windows),
        times=times,
        poses=replace(matched, covariances=covariances),
        reference_poses=truth,
        nees=series,
        log_scores=scores,
    )


def _loaded(trajectory: Trajectory | str | Path) -> Trajectory:
    return trajectory if isinstance(trajectory, Trajectory) else load_trajectory(trajectory)


def _pairs(estimate: Trajectory, reference: Trajectory, max_gap: float) -> tuple[IntArray, IntArray]:
    """Rows of both that belong together: nearest in time, each once, or row by row where one has no times."""
    a, b = estimate.timestamps, reference.timestamps
    if a is None or b is None:
        if len(estimate) != len(reference):
            raise ValueError(
                f"estimate has {len(estimate)} poses, reference {len(reference)}: without times in both files their "
                "rows must be the same frames"
            )
        ours = theirs = np.arange(len(estimate))
    else:
        after = np.clip(np.searchsorted(b, a), 1, max(len(b) - 1, 1))
        before = after - 1
        after = np.minimum(after, len(b) - 1)
        nearest = np.where(np.abs(a - b[before]) <= np.abs(a - b[after]), before, after)
        gaps = np.abs(a - b[nearest])
        by_gap = np.lexsort((gaps, nearest))
        first_of_each = by_gap[np.unique(nearest[by_gap], return_index=True)[1]]
        ours = np.sort(first_of_each[gaps[first_of_each] <= max_gap])
        theirs = nearest[ours]
    if len(ours) <= FEWEST:
        raise ValueError(
            f"estimate and reference have {len(ours)} poses in common, more than {FEWEST} are needed: their clocks may "
            f"differ, or give a max_gap larger than {max_gap:g} s"
        )
    return ours, theirs


def _alignment(how: Alignment, estimate: Trajectory, reference: Trajectory) -> Pose:
    """The motion of the estimate's world that is asked for; refuses one that is not determined."""
    if how == "none":
        return Pose()
    if how == "start":
        return reference.pose(0) @ estimate.pose(0).inverse()
    for name, one in (("estimate", estimate), ("reference", reference)):
        length, width, _ = np.linalg.svd(one.positions - one.positions.mean(axis=0), compute_uv=False)
        if width <= _LINE * length or length == 0.0:
            raise ValueError(
                f"the {name} moves along a line or not at all, which does not determine a rigid alignment: align by "
                "'start', or 'none'"
            )
    R, t = metrics.rigid_motion(estimate.positions, reference.positions)
    return Pose(t, rotations.from_matrix(R))


def _claimed(estimate: Trajectory, reference: Trajectory) -> FloatArray | None:
    """Covariances of the errors of the estimate against the reference; None where it claims nothing."""
    if estimate.covariances is None or (doubt := reference.pose_covariances) is None:
        return estimate.covariances
    J = tangent_jacobian(estimate.tangent, estimate.positions, estimate.orientations)
    summed: FloatArray = estimate.covariances + transformed(J, doubt)
    return summed


def _claims(
    estimate: Trajectory, reference: Trajectory, covariances: FloatArray | None
) -> tuple[dict[str, ClaimScore], dict[str, FloatArray], dict[str, FloatArray]]:
    """The score of each part of the pose, and its NEES and log score frame by frame."""
    claims: dict[str, ClaimScore] = {}
    series: dict[str, FloatArray] = {}
    scores: dict[str, FloatArray] = {}
    if covariances is None:
        return claims, series, scores
    assert estimate.covariances is not None
    usable = are_definite(estimate.covariances)  # before what the reference claims is added, which would hide it
    if not usable.any():
        raise ValueError(
            f"none of the covariances of {estimate.name} is positive definite: correct them, or leave them out"
        )
    errors = estimate.errors(reference.positions, reference.orientations)
    for name, part in _PARTS.items():
        own = covariances[:, part, part]
        values = np.where(usable, nees(errors[:, part], own), np.nan)
        sharpness = np.full(len(values), np.nan)
        sharpness[usable] = 0.5 * (np.linalg.slogdet(own[usable])[1] + DOF[name] * np.log(2.0 * np.pi))
        series[name], scores[name] = values, 0.5 * values + sharpness
        claims[name] = _claim(DOF[name], values[usable], sharpness[usable], int(np.count_nonzero(~usable)))
    return claims, series, scores


def _claim(dof: int, values: FloatArray, sharpness: FloatArray, unusable: int) -> ClaimScore:
    median = float(np.median(values))
    return ClaimScore(
        dof=dof,
        frames=len(values),
        unusable=unusable,
        nees=mean_interval(values),
        median_nees=median,
        band=mean_band(dof, 1),
        scale_gap=median / float(chi2.ppf(0.5, dof)),
        coverage={p: float(np.mean(values <= chi2.ppf(p, dof))) for p in COVERED},
        log_score=mean_interval(0.5 * values + sharpness),
        calibration=0.5 * float(values.mean()),
        sharpness=float(sharpness.mean()),
    )


def _window(seconds: float, estimate: Trajectory, reference: Trajectory, times: FloatArray) -> WindowScore:
    ends = list(window_ends(times, seconds))
    claimed, doubt = estimate.pose_covariances, reference.pose_covariances
    errors, covariances = np.zeros((len(ends), POSE_SIZE)), np.zeros((len(ends), POSE_SIZE, POSE_SIZE))
    for k, (i, j) in enumerate(ends):
        first, last = estimate.pose(i), estimate.pose(j)
        moved, truly = first.inverse() @ last, reference.pose(i).inverse() @ reference.pose(j)
        errors[k] = pose_errors(
            "position-rotation", *(a[None] for T in (moved, truly) for a in (T.position, T.orientation))
        )[0]
        if claimed is not None:
            both = np.zeros((2 * POSE_SIZE, 2 * POSE_SIZE))
            for at, row in enumerate((i, j)):
                own = slice(POSE_SIZE * at, POSE_SIZE * (at + 1))
                both[own, own] = claimed[row] + (0.0 if doubt is None else doubt[row])
            J = relative_jacobian(first, last)
            covariances[k] = J @ both @ J.T
    # The first pose may be known exactly: both start there.
    known = ends and claimed is not None and are_definite(claimed[np.unique(ends)[1:]]).all()
    least = float(nees(errors, covariances).mean()) if known else float("nan")
    return WindowScore(
        seconds=seconds,
        windows=len(ends),
        translation_rmse_m=metrics.root_mean_square(errors[:, POSITION]) if ends else float("nan"),
        rotation_rmse_deg=float(np.rad2deg(metrics.root_mean_square(errors[:, ROTATION]))) if ends else float("nan"),
        least_nees=least if np.isfinite(least) else None,
    )


def _rotation_rmse_deg(estimate: FloatArray, reference: FloatArray) -> float:
    return float(np.rad2deg(metrics.root_mean_square(metrics.rotation_errors(estimate, reference))))
