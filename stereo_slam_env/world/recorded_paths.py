"""Smooth paths from recorded positions on the ground."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from filters.geometry.arrays import FloatArray

_SPACING = 0.25
"""Of the points along the smoothed path, m."""
_STRIDE = 0.3
"""Steps shorter than this do not tell a direction, m."""
_PATH_SMOOTHING = 1.5
"""Over which positions are smoothed, m along the path."""
_TIME_SMOOTHING = 0.3
"""Over which they are smoothed in time, s."""
_FASTEST = 60.0
"""m/s: poses further apart than that are not of one drive."""


def require_one_drive(path: Path, level: FloatArray, forward: FloatArray, period: float) -> None:
    """A `ValueError` where positions (K, 2) jump, or go against the directions (K, 2) in which it looks."""
    steps = np.diff(level, axis=0)
    far = np.flatnonzero(np.linalg.norm(steps, axis=1) > _FASTEST * period)
    if far.size:
        raise ValueError(
            f"{path} jumps by {np.linalg.norm(steps[far[0]]):.1f} m from row {far[0]} to the next: "
            "give the poses of one drive"
        )
    ahead = (steps * forward[:-1]).sum(axis=1)
    back = np.flatnonzero(ahead < -_STRIDE)
    if back.size:
        raise ValueError(f"{path} drives backwards at row {back[0]}: z must be forward, and the car must not reverse")


def strides(level: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points at least a stride apart (N, 2), and the distance driven at every row (K,), which never falls."""
    stations_kept, last, driven, before = [level[0]], level[0], np.zeros(len(level)), 0.0
    for row, point in enumerate(level):
        step = float(np.hypot(*(point - last)))
        driven[row] = before + step
        if step >= _STRIDE:
            stations_kept.append(point)
            last, before = point, before + step
    return np.array(stations_kept), np.maximum.accumulate(driven)


def steady(driven: FloatArray, period: float) -> FloatArray:
    """The distance at every row (K,), smoothed over time as if the speeds at both ends went on."""
    margin = min(int(4 * _TIME_SMOOTHING / period), len(driven) - 1)
    going_on = np.pad(driven, margin, mode="reflect", reflect_type="odd")
    smooth: FloatArray = gaussian_filter1d(going_on, _TIME_SMOOTHING / period, mode="nearest")
    return smooth[margin : margin + len(driven)]


def smoothed(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The path by arc length: lengths (N,) and points (N, 2), continued straight at both ends while smoothing."""
    margin = 4 * _PATH_SMOOTHING
    few = min(5, len(points) - 1)
    ends = np.stack([points[0] - points[few], points[-1] - points[-1 - few]])
    first, last = ends / np.linalg.norm(ends, axis=1, keepdims=True)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    knots = np.concatenate([[-margin], along, [along[-1] + margin]])
    longer = np.concatenate([points[:1] + margin * first, points, points[-1:] + margin * last])
    arc = np.arange(-margin, along[-1] + margin, _SPACING)
    dense = np.stack([np.interp(arc, knots, longer[:, i]) for i in range(2)], axis=1)
    return arc, np.asarray(gaussian_filter1d(dense, _PATH_SMOOTHING / _SPACING, axis=0, mode="nearest"))
