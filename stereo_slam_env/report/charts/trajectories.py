"""Charts of judged trajectories: paths with covariance tubes, errors against 3 sigma, NEES, calibration, windows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtr

from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.evaluation.trajectory_runs import RunsScore, labels_of
from stereo_slam_env.evaluation.trajectory_score import TrajectoryScore
from stereo_slam_env.recording.trajectory import pose_errors
from stereo_slam_env.report.charts.accuracy import TRUTH, map_panel
from stereo_slam_env.report.charts.axes import (
    INK,
    MUTED,
    WIDTH,
    Axis,
    filter_colours,
    label_room,
    log_axis,
    nested_widths,
    panel_width,
)
from stereo_slam_env.report.charts.drawing import DASHED, Chart, Curve, Panel, figure
from stereo_slam_env.report.charts.nees import band_chart, pose_error_chart, shared_error_limits

SIGMAS = 3.0
"""Half width of a tube."""
_SEEN = 0.02
"""Errors and tubes are magnified until the largest of them is this share of the path's extent."""
_FACTORS = tuple(factor * 10.0**decade for decade in range(7) for factor in (1.0, 2.0, 5.0))


def pose_error(score: TrajectoryScore) -> tuple[FloatArray, FloatArray]:
    """Pose errors (N, 6), position in W, m, and rotation in the body, rad, and the claimed deviations, NaN if none."""
    poses, truth = score.poses, score.reference_poses
    error = pose_errors("position-rotation", poses.positions, poses.orientations, truth.positions, truth.orientations)
    claimed = poses.pose_covariances
    if claimed is None:
        return error, np.full_like(error, np.nan)
    if poses.plane is not None:  # up, roll and pitch are filled in
        claimed = np.where(np.isin(np.arange(6), (0, 1, 5))[:, None], claimed, np.nan)
    with np.errstate(invalid="ignore"):
        return error, np.sqrt(np.diagonal(claimed, axis1=1, axis2=2))


def plot_paths(scores: Sequence[TrajectoryScore]) -> tuple[Chart, float]:
    """Paths in the plane of their largest extent, in tubes of 3 sigma, and how many times these are magnified.

    The reference is where it is. An estimate and its tube are drawn at its error times the factor, so the reference is
    inside a tube where the error is below 3 sigma.
    """
    labels = labels_of(scores)
    colours = filter_colours(labels)
    track = np.concatenate([score.reference_poses.positions for score in scores])
    by_extent = sorted((1, 0, 2), key=lambda axis: float(np.ptp(track[:, axis])))
    up, across = by_extent[1:]
    plane = [across, up]
    half_widths = [_across_path(score, plane) for score in scores]
    factor = _magnification(scores, half_widths, plane)
    title = f"{'xyz'[up]} over {'xyz'[across]}, {scores[0].reference} in grey"
    view = map_panel(track, (across, up), WIDTH - 60 - label_room(labels), 420.0, title, ("x (m)", "y (m)", "z (m)"))
    tubes, paths = [], []
    for label, score, (normal, half), width in zip(
        labels, scores, half_widths, nested_widths(len(scores)), strict=True
    ):
        truth = score.reference_poses.positions[:, plane]
        drawn = truth - factor * score.position_errors[:, plane]
        paths.append(Curve(label, drawn[:, 0], drawn[:, 1], colours[label], width=width))
        if np.isfinite(half).any():
            finite = np.isfinite(half)
            side = factor * half[finite, None] * normal[finite]
            outline = np.concatenate([drawn[finite] + side, (drawn[finite] - side)[::-1]])
            tubes.append(Curve(label, outline[:, 0], outline[:, 1], colours[label], opacity=0.16, said=None))
    view.outlines(tubes)
    truths = {id(score): score.reference_poses.positions for score in scores}
    view.lines(Curve("", p[:, across], p[:, up], INK, said=scores[0].reference, **TRUTH) for p in truths.values())
    view.lines(paths)
    view.colour_key(colours)
    return figure([view], colours), factor


def plot_errors(scores: Sequence[TrajectoryScore]) -> list[Chart]:
    """Pose errors of each estimate inside what it claims, 3 sigma, a panel a degree of freedom; equal scales."""
    found = dict(zip(labels_of(scores), map(pose_error, scores), strict=True))
    limits = shared_error_limits(found)
    return [
        pose_error_chart(label, score.times - score.times[0], *errors, limits)
        for (label, errors), score in zip(found.items(), scores, strict=True)
    ]


def plot_nees_over_time(scores: Sequence[TrajectoryScore]) -> Chart:
    """NEES / 6 (3 in a plane) of the pose over time, of all that claim covariances, against the band of one run."""
    claimed = {label: score for label, score in zip(labels_of(scores), scores, strict=True) if score.claims}
    dof = max(score.claim.dof for score in claimed.values() if score.claim)
    times = np.unique(np.concatenate([score.times for score in claimed.values()]))
    low, high = (np.full(len(times), end / dof) for end in mean_band(dof, 1))
    curves = {label: _at(times, score) / score.claim.dof for label, score in claimed.items() if score.claim}
    return band_chart(f"NEES / {dof} (1 is ideal)", times - times[0], curves, (low, high))


def plot_calibration(scores: Sequence[TrajectoryScore]) -> Chart:
    """How often the truth is inside the ellipsoid of each probability, and how its own probabilities are spread."""
    claimed = {label: score for label, score in zip(labels_of(scores), scores, strict=True) if score.claims}
    colours = filter_colours(claimed)
    ideal = np.linspace(0.0, 1.0, 101)
    width = panel_width(2, label_room([*claimed, "right claim"]))
    inside = Panel(Axis(0, 100, "probability of the ellipsoid (%)"), Axis(0, 100), width, 230.0, "Poses inside it (%)")
    spread = Panel(Axis(0, 100, "probability of the truth's own ellipsoid (%)"), Axis(0, 4), width, 230.0)
    spread.title = "Density (PIT; 1 is ideal)"
    inside.lines([Curve("", 100 * ideal, 100 * ideal, MUTED, width=0.9, said=None)], DASHED)
    spread.rule(y=1.0, dash=DASHED)
    curves, steps = [], []
    for label, score in claimed.items():
        values = _nees(score)[np.isfinite(_nees(score))]
        shares = np.sort(chdtr(score.claim.dof if score.claim else 0, values))
        share = np.searchsorted(shares, ideal, side="right") / len(shares)
        curves.append(Curve(label, 100 * ideal, 100 * share, colours[label]))
        density, edges = np.histogram(shares, bins=20, range=(0.0, 1.0), density=True)
        steps.append(Curve(label, 100 * np.repeat(edges, 2)[1:-1], np.repeat(density, 2), colours[label]))
    inside.lines(curves)
    spread.y = Axis(0, max(2.0, 1.05 * max(float(np.asarray(step.y).max()) for step in steps)))
    spread.lines(steps)
    spread.colour_key(colours)
    return figure([inside, spread], colours)


def plot_windows(scores: Sequence[TrajectoryScore]) -> Chart:
    """Error of the motion over windows by their length."""
    with_windows = {label: score for label, score in zip(labels_of(scores), scores, strict=True) if score.windows}
    colours = filter_colours(with_windows)
    width = panel_width(2, label_room(with_windows))
    panels = []
    for title, name in (("Displacement, RMSE (m)", "translation_rmse_m"), ("Turn, RMSE (°)", "rotation_rmse_deg")):
        curves = [
            Curve(
                label,
                [window.seconds for window in score.windows],
                [getattr(window, name) or np.nan for window in score.windows],
                colours[label],
            )
            for label, score in with_windows.items()
        ]
        x, y = (log_axis([np.asarray(getattr(curve, of), dtype=np.float64) for curve in curves]) for of in "xy")
        panel = Panel(Axis(x.low, x.high, "length of the window (s)", log=True), y, width, 230.0, title)
        panel.lines(curves)
        panel.dots(curves)
        panels.append(panel)
    panels[-1].colour_key(colours)
    return figure(panels, colours)


def plot_runs(score: RunsScore) -> Chart:
    """Mean NEES of the pose, or of the position alone, by its dof, over several runs, against its 95 % band."""
    pose = score.claims[score.judged]
    low, high = (end / pose.dof for end in pose.bands)
    curves = {f"{len(score.runs)} runs": pose.by_frame / pose.dof}
    return band_chart(
        f"{score.judged.capitalize()} ANEES / {pose.dof} (1 is ideal)",
        score.times - score.times[0],
        curves,
        (low, high),
    )


def _at(times: FloatArray, score: TrajectoryScore) -> FloatArray:
    """NEES of the pose at `times`; between its own, that of the frame before, so that lines have no gaps."""
    rows = np.searchsorted(score.times, times, side="right") - 1
    inside = (rows >= 0) & (times <= score.times[-1])
    return np.where(inside, _nees(score)[np.maximum(rows, 0)], np.nan)


def _nees(score: TrajectoryScore) -> FloatArray:
    """NEES of the pose, or of the position where that is all there is."""
    return score.nees.get("pose", score.nees.get("position", np.empty(0)))


def _across_path(score: TrajectoryScore, plane: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Unit normals (N, 2) of the reference's path in the plane, and 3 sigma of the position along them (N,), m."""
    path = score.reference_poses.positions[:, plane]
    ahead = np.gradient(path, axis=0) if len(path) > 1 else np.zeros_like(path)
    length = np.linalg.norm(ahead, axis=1)
    moving = length > 0
    # Where the body stands, the direction of its last motion holds.
    last = np.maximum.accumulate(np.where(moving, np.arange(len(path)), 0))
    ahead = np.where(moving[last, None], ahead[last] / np.maximum(length[last], 1e-300)[:, None], [1.0, 0.0])
    normal = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    claimed = score.poses.pose_covariances
    if claimed is None:
        return normal, np.full(len(path), np.nan)
    in_plane = claimed[:, plane][:, :, plane]
    with np.errstate(invalid="ignore"):
        return normal, SIGMAS * np.sqrt(np.einsum("ki,kij,kj->k", normal, in_plane, normal))


def _magnification(
    scores: Sequence[TrajectoryScore],
    half_widths: Sequence[tuple[FloatArray, FloatArray]],
    plane: Sequence[int],
) -> float:
    """Largest round factor that leaves errors and tubes within the share of the path's extent that is well seen."""
    track = np.concatenate([score.reference_poses.positions[:, plane] for score in scores])
    extent = float(np.ptp(track, axis=0).max())
    reach = max(
        float(np.nanmax([*np.abs(score.position_errors[:, plane]).ravel(), *half[np.isfinite(half)]]))
        for score, (_, half) in zip(scores, half_widths, strict=True)
    )
    return max((factor for factor in _FACTORS if factor * reach <= 2.0 * _SEEN * extent), default=1.0)
