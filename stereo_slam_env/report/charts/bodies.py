"""Charts of moving bodies: where they are on the map, and how consistent they are along the drive."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.bands import DOF, mean_band
from stereo_slam_env.evaluation.results import BodyScores, FilterRun
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.accuracy import TRUTH, map_panel
from stereo_slam_env.report.charts.axes import BAND, INK, WIDTH, Axis, filter_colours, label_room, panel_width
from stereo_slam_env.report.charts.drawing import DASHED, Chart, Curve, Panel, figure

INSTANTS = 6
"""Frames of which the bodies are drawn on the map."""
SIGMAS = 3.0
"""Size of their ellipses."""
_ROUND = np.linspace(0.0, 2.0 * np.pi, 33)


def plot_body_map(run: FilterRun, bodies: BodyScores) -> Chart:
    """Bodies of a run from above at a few instants: ellipses of their positions, arrows of a second's motion."""
    colour, name = filter_colours([run.filter_name])[run.filter_name], run.filter_name
    path = run.true_positions[np.isfinite(run.true_positions).all(axis=1)]
    across, up = axes = series.map_axes(path)
    track = np.concatenate([path, bodies.positions, bodies.positions + bodies.velocities])
    panel = map_panel(track, axes, WIDTH - 120, 420.0, "Seen from above, truth in grey")
    panel.lines([Curve("", path[:, across], path[:, up], INK, said="camera", **TRUTH)])
    panel.lines(_true_paths(bodies, across, up))
    times, drawn = series.elapsed(run), np.unique(bodies.frames)
    instants = drawn[np.linspace(0, len(drawn) - 1, min(INSTANTS, len(drawn))).astype(int)]
    rows = np.flatnonzero(np.isin(bodies.frames, instants))
    values, vectors = np.linalg.eigh(bodies.covariances[rows][:, axes][:, :, axes])
    reach = vectors * (SIGMAS * np.sqrt(np.maximum(values, 0.0)))[:, None, :]
    for row, spread in zip(rows, reach, strict=True):
        label = f"{name}, body {bodies.numbers[row]}, {times[bodies.frames[row]]:.1f} s"
        place, step = bodies.positions[row][list(axes)], bodies.velocities[row][list(axes)]
        ellipse = place + np.column_stack([np.cos(_ROUND), np.sin(_ROUND)]) @ spread.T
        panel.outlines([Curve(name, ellipse[:, 0], ellipse[:, 1], colour, opacity=0.35)])
        for line in (ellipse, _arrow(place, step)):
            panel.lines([Curve(name, line[:, 0], line[:, 1], colour, width=1.2, said=label)])
    panel.dots([Curve("", path[:1, across], path[:1, up], INK, said="start of the camera")])
    return figure([panel], {name: colour})


def _true_paths(bodies: BodyScores, across: int, up: int) -> Iterator[Curve]:
    for number in np.unique(bodies.numbers):
        path = bodies.true_positions[bodies.numbers == number]
        yield Curve("", path[:, across], path[:, up], INK, said=None, width=4.0, opacity=0.15)


def _arrow(place: FloatArray, step: FloatArray) -> FloatArray:
    """Points (5, 2) of an arrow from a place."""
    tip, side = place + step, 0.25 * np.array([-step[1], step[0]])
    return np.array([place, tip, tip - 0.25 * step + 0.5 * side, tip, tip - 0.25 * step - 0.5 * side])


def plot_body_nees(runs: Sequence[FilterRun]) -> Chart:
    """NEES / 6 of the pose of every body along the drive, and the 95 % band of a single one."""
    colours = filter_colours(run.filter_name for run in runs)
    curves = [
        Curve(
            run.filter_name,
            line[:, 0],
            line[:, 1],
            colours[run.filter_name],
            width=1.2,
            said=f"{run.filter_name}, body {number}",
        )
        for run in runs
        if run.bodies is not None
        for number, line in _by_body(run, run.bodies)
    ]
    low, high = (end / DOF["pose"] for end in mean_band(DOF["pose"], 1))
    values = np.concatenate([np.asarray(curve.y) for curve in curves] or [np.ones(1)])
    y = Axis(0.8 * min(low, max(float(values.min()), 0.02)), 1.2 * max(high, float(values.max())), log=True)
    time = max((series.elapsed(run) for run in runs), key=len)
    title = "Pose NEES / 6 of each body since its birth (1 is ideal)"
    panel = Panel(Axis(0, float(time[-1]), "time (s)"), y, panel_width(1, label_room(colours)), 220.0, title)
    ends = time[[0, -1]]
    panel.bands([Curve("", ends, np.full(2, low), BAND, np.full(2, low), np.full(2, high))])
    panel.rule(y=1.0, dash=DASHED)
    panel.lines(curves)
    panel.colour_key({**colours})
    return figure([panel], colours)


def _by_body(run: FilterRun, bodies: BodyScores) -> Iterator[tuple[int, FloatArray]]:
    """Number of each body, and its times and values (n, 2)."""
    scored, times = np.isfinite(bodies.pose_nees), series.elapsed(run)
    for number in np.unique(bodies.numbers[scored]).tolist():
        rows = np.flatnonzero(scored & (bodies.numbers == number))
        yield number, np.column_stack([times[bodies.frames[rows]], bodies.pose_nees[rows] / DOF["pose"]])
