"""Pictures of a run in one call: NEES, errors inside their 3 sigma, and the map.

A picture is a `Chart`: a notebook shows it, and `.save("nees.png")` writes it, as SVG or PNG.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from filters import LandmarkBelief
from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.trajectory_score import TrajectoryScore
from stereo_slam_env.report.charts import nees, series, trajectories
from stereo_slam_env.report.charts.accuracy import TRUTH, map_panel
from stereo_slam_env.report.charts.axes import INK, MUTED, WIDTH, filter_colours, label_room
from stereo_slam_env.report.charts.drawing import Chart, Curve, figure

if TYPE_CHECKING:
    from stereo_slam_env.api import Comparison, Evaluation

Shown: TypeAlias = "Evaluation | Comparison | FilterRun | Sequence[FilterRun] | TrajectoryScore"
_SIGMAS = 3.0
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 25)


def show_nees(run: Shown) -> Chart:
    """Pose NEES by its degrees of freedom over time, with the two-sided 95 % band of a consistent filter.

    Parameters
    ----------
    run : Evaluation, Comparison, FilterRun, sequence of FilterRun or TrajectoryScore
        Of several runs of a filter the mean is drawn, with the band of that many.

    Raises
    ------
    ValueError
        There is no NEES: no truth, or no claimed covariance.
    """
    if isinstance(run, TrajectoryScore):
        if not run.claims:
            raise ValueError(f"run must claim covariances, {run.estimate} has none: there is no NEES to show")
        return trajectories.plot_nees_over_time([run])
    runs = _runs(run)
    if not any(np.isfinite(one.pose_nees).any() for one in runs):
        raise ValueError("run must have a truth that counts and covariances: there is no NEES to show")
    return nees.plot_nees(runs)


def show_errors(run: Shown) -> Chart:
    """Pose errors inside the claimed 3 sigma, a panel a degree of freedom, of one run.

    Parameters
    ----------
    run : Evaluation, FilterRun or TrajectoryScore
        One run; of a comparison, one of its `runs`.

    Raises
    ------
    ValueError
        There are several runs, or there is no truth.
    """
    if isinstance(run, TrajectoryScore):
        return trajectories.plot_errors([run])[0]
    one = _only(run)
    if not np.isfinite(one.true_positions).any():
        raise ValueError("run must have a truth: without one there are no errors to show")
    return nees.plot_error_bounds(one)


def show_map(run: Shown) -> Chart:
    """Path and map from above: estimate, truth in grey, landmarks at the end with their 3 sigma ellipses.

    Parameters
    ----------
    run : Evaluation, FilterRun or TrajectoryScore
        One run. Landmarks are those of the filter's last frame, with `drop_unseen` those in view; a run that was stored
        has none.

    Raises
    ------
    ValueError
        There are several runs, or no pose.
    """
    if isinstance(run, TrajectoryScore):
        return trajectories.plot_paths([run])[0]
    one = _only(run)
    path, truth = (p[np.isfinite(p).all(axis=1)] for p in (one.positions, one.true_positions))
    if not len(path):
        raise ValueError(f"run must have poses, that of {one.filter_name} has none: there is no map to show")
    axes = series.map_axes(truth if len(truth) else path)
    colour = filter_colours([one.filter_name])[one.filter_name]
    points, outlines = _landmarks(one.final_map, axes)
    place = list(axes)
    inside = path[:, place].min(axis=0) - 60.0, path[:, place].max(axis=0) + 60.0
    near = ((points >= inside[0]) & (points <= inside[1])).all(axis=1)
    track = np.concatenate([path, truth, np.zeros((int(near.sum()), 3))])
    track[len(path) + len(truth) :, place] = points[near]
    across, up = axes
    names = {one.filter_name: colour} | ({series.reference_name(one): MUTED} if len(truth) else {})
    panel = map_panel(track, axes, WIDTH - 60 - label_room(names), 460.0, "Seen from above")
    if len(truth):
        panel.lines([Curve("", truth[:, across], truth[:, up], INK, said=series.reference_name(one), **TRUTH)])
    panel.lines(Curve("", line[:, 0], line[:, 1], MUTED, width=0.8, said=None) for line in outlines[near])
    if near.any():
        panel.dots([Curve("", points[near, 0], points[near, 1], MUTED, said="landmark")], 8.0)
    panel.lines([Curve(one.filter_name, path[:, across], path[:, up], colour, width=2.0)])
    panel.colour_key(names)
    if near.any():
        left_out = f", {len(near) - near.sum()} farther ones left out" if not near.all() else ""
        panel.note(f"{near.sum()} landmarks of the last frame with {_SIGMAS:g}σ ellipses{left_out}")
    return figure([panel])


def _landmarks(belief: LandmarkBelief | None, axes: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Positions (N, 2) in the plane of the map, and outlines (N, 25, 2) of their ellipses; of those with a place."""
    if belief is None:
        return np.zeros((0, 2)), np.zeros((0, len(_CIRCLE), 2))
    place = list(axes)
    points, P = belief.positions[:, place], belief.covariances[:, place][:, :, place]
    finite = np.isfinite(points).all(axis=1) & np.isfinite(P).all(axis=(1, 2))
    values, vectors = np.linalg.eigh(P[finite])
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    circle = np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)])
    return points[finite], points[finite, None] + _SIGMAS * (root @ circle).transpose(0, 2, 1)


def _runs(run: Evaluation | Comparison | FilterRun | Sequence[FilterRun]) -> list[FilterRun]:
    """Runs of what `evaluate`, `compare` and `run_filter` return."""
    found: Any = getattr(run, "series", getattr(run, "runs", run))
    runs = list(found) if isinstance(found, Sequence) else [found]
    if not runs or not all(isinstance(one, FilterRun) for one in runs):
        raise ValueError(f"run must be what sse.evaluate, sse.compare or evaluate_trajectory returns, got {run!r:.80}")
    return runs


def _only(run: Evaluation | Comparison | FilterRun | Sequence[FilterRun]) -> FilterRun:
    runs = _runs(run)
    if len(runs) > 1:
        raise ValueError(f"run must be a single one, got {len(runs)}: give one of them, as comparison.runs[0]")
    return runs[0]
