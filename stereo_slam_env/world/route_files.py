"""Routes along recorded drives, and routes by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from filters import rotations
from filters.known_names import did_you_mean
from filters.validation import FloatArray, positive
from stereo_slam_env.files.readers import read_poses
from stereo_slam_env.world.routes import FRAME_PERIOD, ROUTES, Route

KITTI_PERIOD = 0.1037
"""Mean time between two frames of KITTI odometry, s."""
_SPACING = 0.25
"""Of the points along the smoothed path, m."""
_STRIDE = 0.3
"""Steps shorter than this do not tell a direction, m."""
_PATH_SMOOTHING = 1.5
"""m along the path."""
_TIME_SMOOTHING = 0.3
"""s."""
_AT_REST = 0.02
"""Speed that counts as standing still, m/s."""
_FASTEST = 60.0
"""m/s: poses further apart than that are not of one drive."""
_SHORTEST = 5.0
_STRAIGHT_BELOW = 0.08
"""rad/s; recorded drives are never quite straight."""


def kitti_route(path: str | Path, period: float = KITTI_PERIOD) -> Route:
    """The drive of a KITTI pose file, on flat ground and smooth.

    The horizontal path is smoothed over 1.5 m, the distance driven over 0.3 s, both are resampled to `FRAME_PERIOD`;
    the camera looks where it drives. W starts in the first direction of travel.

    Parameters
    ----------
    path : str or Path
        12 numbers a row: the upper 3x4 part of T_world_cam (x right, y down, z forward).
    period : float
        Time between two rows, s.

    Raises
    ------
    ValueError
        Not such a file, a jump between two rows, a drive backwards, or one shorter than 5 m: the message names the
        file.
    """
    positive("period", period)
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path} is not a file: give a KITTI pose file, 12 numbers a row")
    positions, orientations = read_poses(path)
    level = positions[:, [0, 2]] - positions[0, [0, 2]]
    _require_one_drive(path, level, np.array([rotations.matrix(q)[[0, 2], 2] for q in orientations]), period)

    strides, driven = _strides(level)
    if driven[-1] < _SHORTEST:
        raise ValueError(f"{path} drives only {driven[-1]:.1f} m: a route needs {_SHORTEST:.0f} m")
    arc, smooth = _smoothed(strides)
    tangents = np.gradient(smooth, axis=0)
    headings = np.unwrap(np.arctan2(tangents[:, 0], tangents[:, 1]))

    duration = (len(level) - 1) * period
    frames = int(duration / FRAME_PERIOD) + 1
    at = np.interp(np.arange(frames) * FRAME_PERIOD, np.arange(len(level)) * period, _steady(driven, period))
    speeds = np.diff(at) / FRAME_PERIOD
    heading = np.interp(at, arc, headings)
    return Route(
        str(path),
        np.where(speeds < _AT_REST, 0.0, speeds),
        np.diff(heading) / FRAME_PERIOD,
        straight_below=_STRAIGHT_BELOW,
    )


def named_route(name: str) -> Route:
    """A route by its name in `ROUTES`, or along the KITTI pose file at that path.

    Raises
    ------
    ValueError
        Neither; the message lists the names and the nearest one. Or the file is not a usable pose file.
    """
    if name in ROUTES:
        return ROUTES[name]()
    if Path(name).is_file():
        return kitti_route(name)
    hint = did_you_mean(name, ROUTES)
    raise ValueError(f"route must be one of {', '.join(map(repr, ROUTES))} or a KITTI pose file, got {name!r}{hint}")


def _require_one_drive(path: Path, level: FloatArray, forward: FloatArray, period: float) -> None:
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


def _strides(level: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points at least a stride apart (N, 2), and the distance driven at every row (K,), which never falls."""
    kept, last, driven, before = [level[0]], level[0], np.zeros(len(level)), 0.0
    for row, point in enumerate(level):
        step = float(np.hypot(*(point - last)))
        driven[row] = before + step
        if step >= _STRIDE:
            kept.append(point)
            last, before = point, before + step
    return np.array(kept), np.maximum.accumulate(driven)


def _steady(driven: FloatArray, period: float) -> FloatArray:
    """The distance at every row (K,), smoothed over time as if the speeds at both ends went on."""
    margin = min(int(4 * _TIME_SMOOTHING / period), len(driven) - 1)
    before, after = 2 * driven[0] - driven[margin:0:-1], 2 * driven[-1] - driven[-2 : -2 - margin : -1]
    smooth = gaussian_filter1d(np.concatenate([before, driven, after]), _TIME_SMOOTHING / period, mode="nearest")
    steady: FloatArray = smooth[margin : margin + len(driven)]
    return steady


def _smoothed(strides: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The path by arc length: lengths (N,) and points (N, 2), continued straight at both ends while smoothing."""
    margin = 4 * _PATH_SMOOTHING
    few = min(5, len(strides) - 1)
    first, last = _unit(strides[0] - strides[few]), _unit(strides[-1] - strides[-1 - few])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(strides, axis=0), axis=1))])
    knots = np.concatenate([[-margin], along, [along[-1] + margin]])
    points = np.concatenate([strides[:1] + margin * first, strides, strides[-1:] + margin * last])
    arc = np.arange(-margin, along[-1] + margin, _SPACING)
    dense = np.stack([np.interp(arc, knots, points[:, i]) for i in range(2)], axis=1)
    return arc, np.asarray(gaussian_filter1d(dense, _PATH_SMOOTHING / _SPACING, axis=0, mode="nearest"))


def _unit(vector: FloatArray) -> FloatArray:
    direction: FloatArray = vector / np.linalg.norm(vector)
    return direction
