"""Score of a claimed covariance: NEES, coverage, log score, CRPS and energy score of the errors that it is of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy  # its `stats`, slow to import, is loaded where it is used
from scipy.special import ndtr, ndtri

from filters import nees
from filters.checks.consistency import are_definite, chi_square_quantile
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.bands import MeanInterval, mean_band, mean_interval
from stereo_slam_env.evaluation.figures import readable
from stereo_slam_env.evaluation.gauges import AlignedPair, AlignmentKind, aligned_pair, find_alignment
from stereo_slam_env.recording.trajectory import Trajectory, transformed

PARTS = {"pose": slice(0, POSE_SIZE), "position": POSITION, "rotation": ROTATION}
"""What of an error each claim is of."""
_PLANE = {"pose": slice(0, 3), "position": slice(0, 2), "rotation": slice(2, 3)}
"""Likewise, where an error is one in a plane: x, y and the angle about up."""
COVERED = (0.5, 0.9, 0.95)
"""Probabilities of the ellipsoids whose coverage is counted."""
_DRAWS = 256
"""Points of the Gaussian that the energy score is a mean over; the same for every frame."""
_PIECE = 2000
"""Frames whose points are held at a time."""


@dataclass(frozen=True)
class ClaimScore:
    """A claimed covariance against the errors: of the pose (6 numbers), the position or the rotation (3 each).

    Velocity and biases have 3, too. Of a robot in a plane they are 3, 2 and 1.
    """

    dof: int
    """Numbers of an error."""
    frames: int
    """Scored: those with a covariance that is one."""
    unusable: int
    """Frames whose covariance is not positive definite: what is claimed of them has no score."""
    nees: MeanInterval
    """Over frames; `dof` is ideal; with the 95 % interval of the block bootstrap."""
    median_nees: float
    """Its median."""
    band: tuple[float, float]
    """Two-sided 95 % band of the mean of one run, as of one frame."""
    scale_gap: float
    """k, median NEES by that of chi-square: the factor by which the covariance is too small."""
    claimed_scale_gap: float
    """k of the covariances as they are claimed, not carried through the alignment: that of smfeval."""
    coverage: Mapping[float, float]
    """Share of frames inside the ellipsoid of each probability."""
    log_score: MeanInterval
    """-log density of the truth, nats: calibration + sharpness."""
    calibration: float
    """Mean of NEES / 2."""
    sharpness: float
    """Mean of (log det + dof log 2 pi) / 2."""
    crps: float | None
    """Continuous ranked probability score, mean over axes and frames, m; None but for the position."""
    energy_score: float | None
    """Energy score, mean over frames, m; None but for the position."""
    obstacle: str
    """Why the claim is not judged; empty where it is."""
    of_a_pair: bool
    """Whether the reference is an estimate, too: what both have in common is in no difference of theirs."""

    @property
    def verdict(self) -> str:
        """Verdict of one run on the claim, in words."""
        if self.obstacle:
            return self.obstacle
        if self.unusable:
            return f"none: {self.unusable} of {self.frames + self.unusable} covariances are not positive definite"
        if not self.of_a_pair:
            return verdict_of(self.nees.mean, self.dof, self.band)
        if self.nees.mean <= self.band[1]:
            return "the two claims do not contradict each other"
        ratio = readable(self.error_ratio)
        return f"the two claims together are overconfident: differences are at least {ratio} times the claimed sigma"

    @property
    def error_ratio(self) -> float:
        """Errors over the claimed standard deviation, root mean square over the axes."""
        return error_ratio(self.nees.mean, self.dof)


class Fit(StrEnum):
    """A claim against the errors that there are."""

    CONSISTENT = "consistent"
    TIGHT = "overconfident"
    LOOSE = "too cautious"
    UNKNOWN = "unknown"


def fit_of(mean_nees: float, band: tuple[float, float]) -> Fit:
    """A mean NEES against its band."""
    low, high = band
    if low <= mean_nees <= high:
        return Fit.CONSISTENT
    return Fit.TIGHT if mean_nees > high else Fit.LOOSE if mean_nees < low else Fit.UNKNOWN


def verdict_of(mean_nees: float, dof: int, band: tuple[float, float], runs: str = "one run") -> str:
    """A mean NEES against its band, in words."""
    fit = fit_of(mean_nees, band)
    if fit is Fit.CONSISTENT:
        return f"{fit}, as far as {runs} can tell"
    if fit is Fit.UNKNOWN:
        return "none: NEES is not finite"
    return f"{fit}: errors are {readable(error_ratio(mean_nees, dof))} times the claimed sigma"


def error_ratio(mean_nees: float, dof: int) -> float:
    """Errors over the claimed standard deviation, root mean square over the axes, by a mean NEES."""
    return float(np.sqrt(mean_nees / dof))


def crps(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Continuous ranked probability score (K,) of errors (K, n), mean over axes, of Gaussians (K, n, n).

    Source: Gneiting and Raftery, "Strictly proper scoring rules, prediction, and estimation", JASA 102, 2007, eq. 21.
    """
    sigmas = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    z = errors / sigmas
    density = np.exp(-(z**2) / 2.0) / np.sqrt(2.0 * np.pi)
    axes = sigmas * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / np.sqrt(np.pi))
    return np.asarray(axes.mean(axis=1), dtype=np.float64)


def energy_scores(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Energy score E|X - e| - E|X - X'| / 2 (K,) of errors (K, n) under Gaussians (K, n, n), by fixed points.

    Source: Gneiting and Raftery, 2007, section 4.2.
    """
    n = errors.shape[1]
    points = ndtri(scipy.stats.qmc.Sobol(n, scramble=True, rng=np.random.default_rng(0)).random(_DRAWS)).T
    scores = np.zeros(len(errors))
    for at in range(0, len(errors), _PIECE):
        rows = slice(at, at + _PIECE)
        drawn = np.linalg.cholesky(covariances[rows]) @ points
        far = np.linalg.norm(drawn - errors[rows, :, None], axis=1).mean(axis=1)
        scores[rows] = far - 0.5 * np.sqrt(2.0) * np.linalg.norm(drawn, axis=1).mean(axis=1)
    return scores


def claimed_numbers(trajectory: Trajectory) -> dict[str, FloatArray]:
    """Numbers that each claim is of, as matrices (n, 6), or (K, n, 6), that take the error of a pose to its numbers.

    Of positions without orientations there is no claim but that on the position.
    """
    parts = PARTS if trajectory.is_oriented else {"position": POSITION}
    if trajectory.plane is None:
        return {name: np.eye(POSE_SIZE)[part] for name, part in parts.items()}
    in_plane = np.zeros((len(trajectory), 3, POSE_SIZE))
    in_plane[:, :2, POSITION] = trajectory.plane[:2]
    in_plane[:, 2, ROTATION] = trajectory.plane[2] @ rotations.matrix(trajectory.orientations)
    return {name: in_plane[:, _PLANE[name]] for name in parts}


def nees_of(numbers: FloatArray, errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """NEES (K,) of the numbers that a claim is of."""
    return nees(rotations.turned(numbers, errors), transformed(numbers, covariances))


@dataclass(frozen=True, eq=False)
class ScoredClaims:
    """Scores of what a trajectory claims of its pose, position and rotation."""

    claims: Mapping[str, ClaimScore]
    """By name; empty where nothing is claimed."""
    nees: Mapping[str, FloatArray]
    """(K,) of each, NaN where a covariance is none."""
    log_scores: Mapping[str, FloatArray]
    """(K,) of each."""


def score_claims(pair: AlignedPair, obstacles: Mapping[str, str], of_a_pair: bool = False) -> ScoredClaims:
    """Score what is claimed of each part of the pose.

    `obstacles` say why a part is not judged; `of_a_pair` as of `ClaimScore`.

    Raises
    ------
    ValueError
        No covariance of the estimate is positive definite.
    """
    estimate = pair.estimate
    if pair.covariances is None or pair.as_claimed is None or estimate.covariances is None:
        return ScoredClaims({}, {}, {})
    usable = are_definite(estimate.covariances)  # before what the reference claims is added, which would hide it
    if not usable.any():
        raise ValueError(
            f"none of the covariances of {estimate.name} is positive definite: correct them, or leave them out"
        )
    errors, covariances, as_claimed = pair.errors[usable], pair.covariances[usable], pair.as_claimed[usable]
    claims: dict[str, ClaimScore] = {}
    series: dict[str, FloatArray] = {}
    scores: dict[str, FloatArray] = {}
    for name, numbers in claimed_numbers(estimate.rows(usable)).items():
        own_errors, variances = rotations.turned(numbers, errors), transformed(numbers, covariances)
        nees_as_claimed = nees_of(numbers, errors, as_claimed)
        everything, rows = np.ones(len(usable), dtype=bool), np.full((len(usable), *variances.shape[1:]), np.nan)
        all_errors = np.full((len(usable), own_errors.shape[1]), np.nan)
        rows[usable], all_errors[usable] = variances, own_errors
        claims[name], series[name], scores[name] = score_of(
            name, all_errors, rows, usable, everything, obstacles[name], of_a_pair, nees_as_claimed
        )
    return ScoredClaims(claims, series, scores)


def score_of(
    name: str,
    errors: FloatArray,
    covariances: FloatArray,
    usable: BoolArray,
    claimed: BoolArray,
    obstacle: str,
    of_a_pair: bool,
    nees_as_claimed: FloatArray | None = None,
) -> tuple[ClaimScore, FloatArray, FloatArray]:
    """Score of a claim, and its NEES and log scores (K,), NaN but where it is usable.

    Parameters
    ----------
    name : str
        What it is of.
    errors, covariances : (K, n) and (K, n, n) arrays
        The errors, and what is claimed of them.
    usable, claimed : (K,) masks
        Where a covariance is positive definite, and where there should be one.
    obstacle, of_a_pair
        As of `ClaimScore`.
    nees_as_claimed : (number of usable,) array, optional
        NEES of the covariances that were not carried through an alignment; None: they are the same.
    """
    dof, own_errors, variances = errors.shape[1], errors[usable], covariances[usable]
    values, ideal = nees(own_errors, variances), chi_square_quantile(0.5, dof)
    sharpness = 0.5 * (np.linalg.slogdet(variances)[1] + dof * np.log(2.0 * np.pi))
    series, scores = np.full((2, len(usable)), np.nan)
    series[usable], scores[usable] = values, 0.5 * values + sharpness
    median, is_position = float(np.median(values)), name == "position"
    as_claimed = median if nees_as_claimed is None else float(np.median(nees_as_claimed))
    claim = ClaimScore(
        dof=dof,
        frames=len(values),
        unusable=int(np.count_nonzero(claimed & ~usable)),
        nees=mean_interval(values),
        median_nees=median,
        band=mean_band(dof, 1),
        scale_gap=median / ideal,
        claimed_scale_gap=as_claimed / ideal,
        coverage={p: float(np.mean(values <= chi_square_quantile(p, dof))) for p in COVERED},
        log_score=mean_interval(0.5 * values + sharpness),
        calibration=0.5 * float(values.mean()),
        sharpness=float(sharpness.mean()),
        crps=float(crps(own_errors, variances).mean()) if is_position else None,
        energy_score=float(energy_scores(own_errors, variances).mean()) if is_position else None,
        obstacle=obstacle,
        of_a_pair=of_a_pair,
    )
    return claim, series, scores


@dataclass(frozen=True)
class GaugeScore:
    """Score of a claim under one alignment."""

    alignment: AlignmentKind
    """How the world would be aligned, by all poses but for "start"."""
    nees: float
    """Mean NEES of the pose, or of the position where that is all there is; `dof` is ideal."""
    dof: int
    """Numbers of an error: 6, or 3 of a position or in a plane."""
    position_rmse_m: float
    """Root mean square of the distance, m."""
    fit: Fit
    """The claim under it."""

    @property
    def error_ratio(self) -> float:
        """Standard deviation of the errors over the claimed one, root mean square over the axes."""
        return error_ratio(self.nees, self.dof)

    @property
    def verdict(self) -> str:
        """The same in words."""
        return verdict_of(self.nees, self.dof, mean_band(self.dof, 1))


ANOTHER_SIZE = 2.0
"""Ratio of errors to claims, per axis, between two alignments from which on the claim is another one."""


def claims_differ(gauges: Sequence[GaugeScore]) -> bool:
    """Whether a claim fits otherwise under another alignment, or is wrong by another size."""
    sizes = [gauge.error_ratio for gauge in gauges if gauge.fit is not Fit.UNKNOWN]
    otherwise = len({gauge.fit for gauge in gauges}) > 1
    return otherwise or (bool(sizes) and max(sizes) > ANOTHER_SIZE * min(sizes))


def score_gauges(estimate: Trajectory, reference: Trajectory, chosen: AlignedPair) -> tuple[GaugeScore, ...]:
    """The claim on the pose under every alignment; without those of a world or a scale that the chosen one denies."""
    if chosen.covariances is None:
        return ()
    kinds: list[AlignmentKind] = [*(["start"] if estimate.is_oriented else []), "gravity-yaw", "rigid"]  # type: ignore[list-item]
    if chosen.alignment.kind == "none":
        kinds.insert(0, "none")
    elif chosen.alignment.kind == "sim3":
        kinds.append("sim3")
    everything, scores = np.ones(len(estimate), dtype=bool), []
    for kind in kinds:
        try:
            alignment = find_alignment(kind, estimate, reference, everything, chosen.alignment.up)
        except ValueError:
            continue  # what the poses do not determine is no choice
        pair = aligned_pair(estimate, reference, alignment)
        pair = pair.rows(pair.scored)
        assert pair.covariances is not None
        numbers = next(iter(claimed_numbers(pair.estimate).values()))
        values, dof = nees_of(numbers, pair.errors, pair.covariances), numbers.shape[-2]
        mean = float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")
        error = metrics.ate_unaligned(pair.estimate.positions, pair.reference.positions)
        scores.append(GaugeScore(kind, mean, dof, error, fit_of(mean, mean_band(dof, 1))))
    return tuple(scores)
