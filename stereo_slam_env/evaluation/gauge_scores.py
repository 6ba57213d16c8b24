"""Scores of a claim under each alignment, with the covariances carried through it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from filters.checks.consistency import are_definite
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.claims import claimed_numbers, nees_of, verdict_of
from stereo_slam_env.evaluation.consistency import mean_band
from stereo_slam_env.evaluation.gauges import (
    Alignment,
    AlignmentKind,
    Correlation,
    carried,
    correlation_of,
    find_alignment,
    is_zero_at_start,
)
from stereo_slam_env.recording.trajectory import Trajectory, tangent_jacobian, transformed

_LEFT = 1e-9
"""A direction in which a carried covariance keeps a smaller share of what was claimed is fixed by the alignment."""


@dataclass(frozen=True)
class GaugeScore:
    """What a claim would be found to be under an alignment."""

    alignment: AlignmentKind
    """How the world would be aligned, by all poses but for "start"."""
    nees: float
    """Mean NEES of the pose, or of the position where that is all there is; `dof` is ideal."""
    dof: int
    """Numbers of an error: 6, or 3 of a position or in a plane."""
    position_rmse_m: float
    """Root mean square of the distance, m."""
    verdict: str
    """In words."""


def claimed_through(
    aligned: Trajectory, reference: Trajectory, alignment: Alignment, correlation: Correlation
) -> tuple[FloatArray | None, FloatArray | None]:
    """Covariances of the errors of an aligned estimate against its reference: as claimed, and through the alignment."""
    own = aligned.covariances
    if own is None:
        return None, None
    through = carried(own, aligned, alignment, correlation)
    if (doubt := reference.pose_covariances) is None:
        return own, through
    doubt = transformed(tangent_jacobian(aligned.tangent, aligned.positions, aligned.orientations), doubt)
    return own + doubt, through + carried(doubt, aligned, alignment, correlation_of(reference))


def scored_rows(
    aligned: Trajectory, alignment: Alignment, as_claimed: FloatArray | None, covariances: FloatArray | None
) -> BoolArray:
    """Which poses are scored: not those that both have in common by the alignment, or from the start."""
    scored = np.ones(len(aligned), dtype=bool)
    if alignment.rows.sum() == 1:
        scored &= ~alignment.rows
    scored[0] &= alignment.kind != "none" and not is_zero_at_start(aligned)
    if as_claimed is not None and covariances is not None and covariances is not as_claimed:
        usable = are_definite(as_claimed)
        L = np.linalg.inv(np.linalg.cholesky(as_claimed[usable]))
        scored[usable] &= np.linalg.eigvalsh(transformed(L, covariances[usable]))[:, 0] > _LEFT
    return scored


def turned_as(reference: Trajectory, aligned: Trajectory) -> Trajectory:
    """The reference, with the orientations of the aligned estimate where one of the two has none to be compared."""
    return reference if aligned.is_oriented else replace(reference, orientations=aligned.orientations)


def score_gauges(
    estimate: Trajectory, reference: Trajectory, chosen: Alignment, correlation: Correlation
) -> tuple[GaugeScore, ...]:
    """The claim on the pose under every alignment; without those of a world or a scale that the chosen one denies."""
    kinds: list[AlignmentKind] = [*(["start"] if estimate.is_oriented else []), "gravity-yaw", "rigid"]  # type: ignore[list-item]
    if chosen.kind == "none":
        kinds.insert(0, "none")
    elif chosen.kind == "sim3":
        kinds.append("sim3")
    found = []
    for kind in kinds:
        try:
            alignment = find_alignment(kind, estimate, reference, np.ones(len(estimate), dtype=bool), chosen.up)
        except ValueError:
            continue  # what the poses do not determine is no choice
        aligned = alignment.apply(estimate)
        truth = turned_as(reference, aligned)
        as_claimed, covariances = claimed_through(aligned, truth, alignment, correlation)
        assert as_claimed is not None
        assert covariances is not None
        scored = scored_rows(aligned, alignment, as_claimed, covariances)
        errors = aligned.errors(truth.positions, truth.orientations)
        numbers = next(iter(claimed_numbers(aligned.rows(scored)).values()))
        values, dof = nees_of(numbers, errors[scored], covariances[scored]), numbers.shape[-2]
        mean = float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")
        found.append(
            GaugeScore(
                alignment=kind,
                nees=mean,
                dof=dof,
                position_rmse_m=metrics.ate_unaligned(aligned.positions[scored], reference.positions[scored]),
                verdict=verdict_of(mean, dof, mean_band(dof, 1)),
            )
        )
    return tuple(found)
