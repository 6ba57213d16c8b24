"""Figures of where policies look: pan and tilt over time, the map from above, claimed and true error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from filters import rotations
from filters.motion import POSITION
from filters.validation import FloatArray
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.plots import frame_track, orientation
from stereo_slam_env.report.charts.style import (
    GRID,
    INK,
    MUTED,
    WIDTH_INCHES,
    EndLabel,
    filter_colours,
    label_ends,
    shared_limit,
    styled,
)

_LOOK_EVERY = 0.5
"""s between two lines of sight in the map."""
_LOOK_LENGTH = 6.0
"""Of such a line, m."""


@styled
def plot_gaze(recordings: Mapping[str, Recording]) -> Figure:
    """Pan and tilt of the head over time, a row a policy.

    Parameters
    ----------
    recordings : mapping of str to Recording
        By policy, with `head` in their frames.

    Returns
    -------
    matplotlib.figure.Figure
    """
    colours = filter_colours(recordings)
    height = 0.75 + 0.85 * len(recordings)
    figure = Figure(figsize=(WIDTH_INCHES, height))
    figure.subplots_adjust(left=0.06, right=0.87, top=1 - 0.3 / height, bottom=0.45 / height, hspace=0.35)
    panels = figure.subplots(len(recordings), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for ax, (name, recording) in zip(panels, recordings.items(), strict=True):
        time, angles = _head(recording)
        ax.plot(time, np.rad2deg(angles[:, 1]), color=MUTED, linewidth=0.9, alpha=0.8, label="tilt")
        ax.plot(time, np.rad2deg(angles[:, 0]), color=colours[name], linewidth=1.6, label=name)
        label_ends(ax, [EndLabel(name, 0.0, colours[name])])
    reach = max((float(np.abs(_head(r)[1]).max(initial=0.0)) for r in recordings.values()), default=0.0)
    reach = max(1.15 * float(np.rad2deg(reach)), 20.0)
    panels[0].set(ylim=(-reach, reach), title="Pan (°), positive to the right; tilt in grey")
    panels[-1].set(xlabel="time (s)", xlim=(0, None))
    return figure


@styled
def plot_gaze_map(recordings: Mapping[str, Recording]) -> Figure:
    """Seen from above, a panel a policy: the path, the landmarks seen (others faint), and where it looked.

    Parameters
    ----------
    recordings : mapping of str to Recording
        By policy, of one seed, with truth.

    Returns
    -------
    matplotlib.figure.Figure
    """
    colours = filter_colours(recordings)
    tracks = {name: _track(recording) for name, recording in recordings.items()}
    everything = np.concatenate([_shown_points(recording) for recording in recordings.values()] + list(tracks.values()))
    across, up = orientation(next(iter(tracks.values())))
    extent = np.ptp(everything[:, [across, up]], axis=0) + 2.0
    columns = 1 if len(recordings) == 1 else 2 if extent[0] > 1.5 * extent[1] else 3
    rows = -(-len(recordings) // columns)
    panel = min(0.92 * WIDTH_INCHES / columns * extent[1] / extent[0], 6.0) + 0.45
    height = rows * panel + 0.45
    figure = Figure(figsize=(WIDTH_INCHES, height))
    figure.subplots_adjust(left=0.05, right=0.99, top=1 - 0.25 / height, bottom=0.45 / height, hspace=0.3, wspace=0.12)
    panels = figure.subplots(rows, columns, squeeze=False)
    for ax in panels.flat[len(recordings) :]:
        ax.set_axis_off()
    for ax, (name, recording) in zip(panels.flat, recordings.items(), strict=False):
        _draw_map(ax, recording, tracks[name], colours[name], name, (across, up))
        frame_track(ax, everything, across, up)
    for ax in panels.flat[max(len(recordings) - columns, 0) : len(recordings)]:
        ax.set_xlabel({0: "x, right (m)", 2: "z, forward (m)"}[across])
    return figure


@styled
def plot_claim_and_truth(runs: Sequence[FilterRun]) -> Figure:
    """Claimed standard deviation of the position and its true error along the drive, root mean squares over runs.

    Parameters
    ----------
    runs : sequence of FilterRun
        Of all policies.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels with one scale: a policy whose curve is higher on the right than on the left is overconfident.
    """
    groups = series.by_filter(runs)
    colours = filter_colours(groups)
    figure = Figure(figsize=(WIDTH_INCHES, 3.3))
    figure.subplots_adjust(left=0.06, right=0.87, top=0.9, bottom=0.15, wspace=0.12)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    titles = ("Claimed: σ of the position (m)", "True: position error (m)")
    for ax, title, quantity in zip(panels, titles, (_claimed_sigma, series.position_error), strict=True):
        curves = {
            name: np.sqrt(series.column_mean(np.square(series.stack(group, quantity))))
            for name, group in groups.items()
        }
        for name, curve in curves.items():
            time = series.elapsed(max(groups[name], key=len))
            ax.plot(time, curve, color=colours[name], linewidth=1.6, label=name)
        ax.set(title=title, xlabel="time (s)", xlim=(0, None))
    limit = shared_limit({name: series.peak(curve) for name, curve in curves.items()}, spread=30.0)
    panels[0].set_ylim(0, 1.15 * limit.upper)
    label_ends(panels[1], [EndLabel(name, series.last_known(curve), colours[name]) for name, curve in curves.items()])
    return figure


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


def _shown_points(recording: Recording) -> FloatArray:
    """True positions (N, 3) of the landmarks that were seen."""
    if recording.landmarks is None:
        return np.zeros((0, 3))
    ids = np.unique(np.concatenate([frame.observation.ids for frame in recording.frames]))
    return recording.landmarks.positions[np.isin(recording.landmarks.ids, ids)]


def _draw_map(ax: Axes, recording: Recording, track: FloatArray, colour: str, name: str, axes: tuple[int, int]) -> None:
    across, up = axes
    if recording.landmarks is not None:
        everywhere = recording.landmarks.positions
        ax.scatter(everywhere[:, across], everywhere[:, up], s=3, color=GRID, linewidths=0, zorder=0, label="_not seen")
    seen = _shown_points(recording)
    ax.scatter(seen[:, across], seen[:, up], s=5, color=colour, alpha=0.7, linewidths=0, zorder=2, label=name)
    lines = _lines_of_sight(recording)[:, [across, up]]
    ax.plot(lines[:, 0], lines[:, 1], color=MUTED, linewidth=0.9, alpha=0.9, zorder=1, label="looks")
    ax.plot(track[:, across], track[:, up], color=INK, linewidth=1.6, zorder=3, label="path")
    ax.set_title(f"{name}: {len(seen)} landmarks seen", color=colour)


def _lines_of_sight(recording: Recording) -> FloatArray:
    """From the camera along its optical axis, every now and then; (3 n, 3), with a row of NaN after each line."""
    rows, last = [], -np.inf
    for frame in recording.frames:
        if frame.truth is not None and frame.timestamp - last >= _LOOK_EVERY - 1e-9:
            last, forward = frame.timestamp, rotations.matrix(frame.truth.orientation)[:, 2]
            rows += [frame.truth.position, frame.truth.position + _LOOK_LENGTH * forward, np.full(3, np.nan)]
    return np.array(rows, dtype=np.float64).reshape(len(rows), 3)
