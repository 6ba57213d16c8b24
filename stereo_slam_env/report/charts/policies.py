"""Charts of policies: where they look, what they claim and what is true, and how one is learnt."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.motions.motion_model import POSITION
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.accuracy import map_panel
from stereo_slam_env.report.charts.axes import (
    GRID,
    INK,
    MUTED,
    PALETTE,
    WIDTH,
    Axis,
    filter_colours,
    label_room,
    panel_width,
)
from stereo_slam_env.report.charts.drawing import DASHED, Chart, Curve, Panel, figure, limit_of

_LOOK_EVERY = 0.5
"""s between two lines of sight in the map."""
_LOOK_LENGTH = 6.0
"""Of such a line, m."""
_LEARNT = {
    "final_position_sigma_m": "Claimed: position sigma at the end (m)",
    "position_rmse_m": "True: rms position error (m)",
}


def plot_gaze(recordings: Mapping[str, Recording]) -> Chart:
    """Pan and tilt of the head over time, a row for each policy."""
    colours = filter_colours(recordings)
    heads = {name: _head(recording) for name, recording in recordings.items()}
    reach = max((float(np.rad2deg(np.abs(angles).max(initial=0.0))) for _, angles in heads.values()), default=0.0)
    reach = max(1.15 * reach, 20.0)
    last = max((float(time[-1]) for time, _ in heads.values() if len(time)), default=1.0)
    panels: list[Panel] = []
    for row, (name, (time, angles)) in enumerate(heads.items(), start=1):
        x = Axis(0, last, "time (s)" if row == len(heads) else "")
        title = "" if panels else "Pan (°), positive to the right; tilt in grey"
        panel = Panel(x, Axis(-reach, reach), panel_width(1, label_room(colours)), 64.0, title)
        degrees = np.rad2deg(angles)
        panel.lines([Curve(name, time, degrees[:, 1], MUTED, width=1.1, opacity=0.8, said=f"{name}, tilt")])
        panel.lines([Curve(name, time, degrees[:, 0], colours[name], width=2.0, said=f"{name}, pan")])
        panel.end_labels([(name, 0.0, colours[name])])
        panels.append(panel)
    return figure(panels, colours, columns=1, row=34)


def plot_gaze_map(recordings: Mapping[str, Recording]) -> Chart:
    """Seen from above, a panel for each policy: the path, the landmarks seen (others faint), and where it looked."""
    colours = filter_colours(recordings)
    tracks = {name: _track(recording) for name, recording in recordings.items()}
    everything = np.concatenate([*(_seen_points(recording) for recording in recordings.values()), *tracks.values()])
    axes = series.map_axes(next(iter(tracks.values())))
    extent = np.ptp(everything[:, list(axes)], axis=0) + 2.0
    columns = min(len(recordings), 2 if extent[0] > 1.5 * extent[1] else 3)
    width = panel_width(columns, 10.0)
    panels = []
    for name, recording in recordings.items():
        points = _seen_points(recording)
        panel = map_panel(everything, axes, width, 460.0, f"{name}: {len(points)} landmarks seen")
        panel.title_colour = colours[name]
        if recording.landmarks is not None:
            panel.dots([_plan("", recording.landmarks.positions, axes, GRID, said="not seen")], 4)
        panel.lines([_plan(name, _lines_of_sight(recording), axes, MUTED, width=1.1, said=None)])
        panel.dots([_plan(name, points, axes, colours[name], opacity=0.7, said=f"{name}, landmark seen")], 7)
        panel.lines([_plan(name, tracks[name], axes, INK, width=2.0, said=f"{name}, path")])
        panels.append(panel)
    return figure(panels, colours, columns=columns)


def plot_claim_and_truth(runs: Sequence[FilterRun]) -> Chart:
    """Claimed standard deviation of the position and its true error along the drive, root mean squares over runs."""
    groups = series.by_filter(runs)
    colours = filter_colours(groups)
    kinds = {"Claimed: σ of the position (m)": _claimed_sigma, "True: position error (m)": series.position_error}
    times = {name: series.elapsed(max(group, key=len)) for name, group in groups.items()}
    arrays = {
        title: [
            Curve(name, times[name], np.sqrt(series.column_mean(np.square(table))), colours[name], width=2.0)
            for name, group in groups.items()
            for table in [series.stack(group, quantity)]
        ]
        for title, quantity in kinds.items()
    }
    limits = {title: limit_of(curves, spread=30.0) for title, curves in arrays.items()}
    x = Axis(0, max(float(time[-1]) for time in times.values()), "time (s)")
    y = Axis(0, 1.15 * max(limit.upper for limit in limits.values()))
    panels = []
    for title, curves in arrays.items():
        panel = Panel(x, y, panel_width(2, label_room(colours)), 240.0, title)
        panel.lines(curves)
        panel.note_beyond(limits[title], colours, " m")
        panels.append(panel)
    panels[-1].name_ends(curves, limits[title])
    return figure(panels, colours)


def plot_learning(
    runs: Sequence[Sequence[Mapping[str, float]]], idle: Mapping[str, float], merit: Callable[[Any], float]
) -> Chart:
    """What counts on the validation episodes against the decisions made; a curve a training.

    Claimed uncertainty and true error where there are such columns, else the return; `idle` has those of action 0,
    which looks straight ahead. The row with the largest `merit` is marked.
    """
    rows = [row for run in runs for row in run]
    judged = set(_LEARNT) <= rows[0].keys()
    best = max(rows, key=merit)
    x = Axis(0, max(row["decisions"] for row in rows) / 1000.0 or 1.0, "decisions, thousands")
    panels = []
    for name, title in _LEARNT.items() if judged else [("validation_return", "Return of the validation episodes")]:
        progress = [idle[name], *(row[name] for row in rows)]
        room = 0.15 * (max(progress) - min(0.0, *progress))
        y = Axis(min(0.0, min(progress) - room * (min(progress) < 0.0)), max(0.0, max(progress)) + room)
        panel = Panel(x, y, 0.5 * WIDTH - 70, 240.0, title)
        panel.rule(y=idle[name], dash=DASHED)
        label = "straight ahead" if judged else "action 0"
        panel.text(label, panel.width, panel.place(0, idle[name])[1] - 9, align="right")
        for run in runs:
            thousands = np.array([row["decisions"] / 1000.0 for row in run])
            panel.lines([Curve("learnt", thousands, np.array([row[name] for row in run]), PALETTE[0])])
        at, value = np.array([best["decisions"] / 1000.0]), np.array([best[name]])
        panel.dots([Curve("learnt", at, value, PALETTE[0], said="kept")], 60)
        right, down = panel.place(at[0], value[0])
        panel.text("kept", right - 6, down + 13, PALETTE[0], align="right")
        panels.append(panel)
    return figure(panels)


def _claimed_sigma(run: FilterRun) -> FloatArray:
    variances = np.trace(run.pose_covariances[:, POSITION, POSITION], axis1=1, axis2=2)
    return np.asarray(np.sqrt(variances), dtype=np.float64)


def _head(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Time (K,), s, and pan and tilt (K, 2), rad, of the frames that have them."""
    frames = [frame for frame in recording.frames if frame.head is not None]
    angles = np.array([frame.head for frame in frames], dtype=np.float64).reshape(len(frames), 2)
    return np.array([frame.timestamp for frame in frames], dtype=np.float64), angles


def _track(recording: Recording) -> FloatArray:
    """True positions (K, 3)."""
    poses = [frame.truth for frame in recording.frames if frame.truth is not None]
    return np.array([pose.position for pose in poses], dtype=np.float64).reshape(len(poses), 3)


def _seen_points(recording: Recording) -> FloatArray:
    """True positions (N, 3) of the landmarks that were seen."""
    if recording.landmarks is None:
        return np.zeros((0, 3))
    ids = np.unique(np.concatenate([frame.observation.ids for frame in recording.frames]))
    return recording.landmarks.positions[np.isin(recording.landmarks.ids, ids)]


def _lines_of_sight(recording: Recording) -> FloatArray:
    """From the camera along its optical axis, every now and then; (3 n, 3), with a row of NaN after each line."""
    rows, last = [], -np.inf
    for frame in recording.frames:
        if frame.truth is not None and frame.timestamp - last >= _LOOK_EVERY - 1e-9:
            last, forward = frame.timestamp, rotations.matrix(frame.truth.orientation)[:, 2]
            rows += [frame.truth.position, frame.truth.position + _LOOK_LENGTH * forward, np.full(3, np.nan)]
    return np.array(rows, dtype=np.float64).reshape(len(rows), 3)


def _plan(
    key: str,
    points: FloatArray,
    axes: tuple[int, int],
    colour: str,
    width: float = 1.0,
    opacity: float = 1.0,
    said: str | None = "",
) -> Curve:
    """Points (N, 3) seen from above."""
    return Curve(key, points[:, axes[0]], points[:, axes[1]], colour, width=width, opacity=opacity, said=said)
