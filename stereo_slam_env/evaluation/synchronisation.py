"""Association of the poses of an estimate with those of its reference, by time or by number of the frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy  # its `optimize` and `signal`, slow to import, are loaded where they are used
from scipy.spatial.transform import Rotation, Slerp

from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.recording.state_beliefs import StateBelief
from stereo_slam_env.recording.trajectory import Trajectory

MAX_GAP = 0.01
"""s, between a pose and its reference."""
FEWEST = 3
"""Scored poses."""
RISKY = 0.3
"""Share of the claimed deviation that the reference moves in the time between it and the estimate."""
_SEARCHED = 1.0
"""s, to either side, that an offset of the clocks is searched in."""
_CLEARLY = 0.5
"""An offset farther away is taken where it leaves a smaller share of the error."""
_SAMPLES, _FEWEST_SAMPLES = 20_000, 10
"""Of the motion, that are correlated: most, and least in common."""
_POSES = 500
"""Poses that it is searched with."""
_HOLE = 5.0
"""Between two poses of a reference that are so many times as far apart as usual nothing is interpolated."""


@dataclass(frozen=True, eq=False)
class PosePairs:
    """Poses that belong together, row by row."""

    estimate: Trajectory
    """(K poses)."""
    reference: Trajectory
    """(K poses), at the times of the reference, or, interpolated, of the estimate."""
    rows: IntArray
    """(K,): rows of the whole estimate."""
    gaps: FloatArray
    """(K,): time from a pose to the reference that it is held against, s; 0 without times and where interpolated."""


def paired(
    estimate: Trajectory, reference: Trajectory, max_gap: float = MAX_GAP, interpolate: bool = False
) -> PosePairs:
    """Poses nearest in time, each once; or at the times of the estimate; or of the same frame where one has no times.

    Raises
    ------
    ValueError
        Too few poses belong together: one line that says what may be the reason.
    """
    a, b = estimate.timestamps, reference.timestamps
    if a is None or b is None:
        return _by_number(estimate, reference)
    if interpolate:
        return _interpolated(estimate, reference)
    after = np.clip(np.searchsorted(b, a), 1, max(len(b) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(b) - 1)
    nearest = np.where(np.abs(a - b[before]) <= np.abs(a - b[after]), before, after)
    gaps = np.abs(a - b[nearest])
    by_gap = np.lexsort((gaps, nearest))
    first_of_each = by_gap[np.unique(nearest[by_gap], return_index=True)[1]]
    ours = np.sort(first_of_each[gaps[first_of_each] <= max_gap])
    if len(ours) <= FEWEST:
        raise ValueError(_apart(len(ours), a, b, max_gap))
    return PosePairs(estimate.rows(ours), reference.rows(nearest[ours]), ours, gaps[ours])


def find_time_offset(estimate: Trajectory, reference: Trajectory) -> float:
    """Time to add to those of the estimate so that its path fits that of the reference best, s.

    It is searched within a second of no offset at all, and of those at which speeds and turns of the two paths are
    correlated most over the whole of what they may have in common.

    Raises
    ------
    ValueError
        They have no times or too few poses in common, or the path fits at any offset, as a straight one does.
    """
    a, b = estimate.timestamps, reference.timestamps
    if a is None or b is None:
        raise ValueError("time_offset cannot be searched: a file has no times")
    few = estimate.rows(np.unique(np.linspace(0, len(estimate) - 1, _POSES).astype(int)))
    best = _offset_near(0.0, few, reference)
    for start in _correlated_offsets(estimate, reference):
        other = _offset_near(start, few, reference)
        if other is not None and (best is None or other[1] < _CLEARLY * best[1]):
            best = other
    if best is not None:
        return best[0]
    if a[0] > b[-1] or b[0] > a[-1]:
        raise ValueError(_apart(0, a, b, _SEARCHED))
    raise ValueError("time_offset is not determined: the path fits at any offset, give it in seconds")


def _offset_near(start: float, few: Trajectory, reference: Trajectory) -> tuple[float, float] | None:
    """The offset near another one and the error that is left, m; None where none is better than those around it."""
    a, b, p = few.timestamps, reference.timestamps, reference.positions
    assert a is not None
    assert b is not None
    enough = max(FEWEST, int(0.5 * len(a) * min(1.0, np.ptp(b) / np.ptp(a))))  # half of the shorter one in common

    def misfit(offset: float) -> float:
        """The position error of a rigid alignment, over the positions between those of the reference."""
        inside = (a + offset >= b[0]) & (a + offset <= b[-1])
        if np.count_nonzero(inside) <= enough:
            return np.inf
        at = np.column_stack([np.interp(a[inside] + offset, b, axis) for axis in p.T])
        return metrics.ate_rigid(few.positions[inside], at)

    grid = start + np.linspace(-_SEARCHED, _SEARCHED, 81)
    errors = np.array([misfit(offset) for offset in grid])
    finite = np.flatnonzero(np.isfinite(errors))
    if not finite.size:
        return None
    best = int(np.argmin(errors))
    if best in (finite[0], finite[-1]):  # the edge of a search is no minimum
        return None
    if np.median(errors[finite]) < 1.1 * errors[best] + 1e-9 * np.ptp(p):
        return None
    with np.errstate(invalid="ignore"):  # an end of the search may have too few poses in common
        least = scipy.optimize.minimize_scalar(
            misfit, bounds=(grid[best - 1], grid[best + 1]), method="bounded", options={"xatol": 1e-5}
        )
    return float(least.x), float(least.fun)


def _correlated_offsets(estimate: Trajectory, reference: Trajectory) -> list[float]:
    """Offsets, s, at which the speeds, and the turns, of two paths are correlated most."""
    a, b = estimate.timestamps, reference.timestamps
    assert a is not None
    assert b is not None
    if min(len(a), len(b)) < 2 * _FEWEST_SAMPLES:
        return []
    step = max(float(np.median(np.diff(a))), float(np.median(np.diff(b))), max(np.ptp(a), np.ptp(b)) / _SAMPLES)
    offsets = []
    for mine, other in zip(_motion(estimate, step), _motion(reference, step), strict=True):
        at = _lag(mine, other)
        if at is not None:
            offsets.append(float(b[0] - a[0]) + step * at)
    return offsets


def _motion(trajectory: Trajectory, step: float) -> tuple[FloatArray, FloatArray]:
    """Speed (K,) and turn of the direction (K,) of a path, at even times, over a second or a few steps; no world."""
    times = trajectory.timestamps
    assert times is not None
    reach = max(2, round(0.5 / step))
    at = np.arange(times[0], times[-1] + 0.5 * step, step)
    p = np.column_stack([np.interp(at, times, axis) for axis in trajectory.positions.T])
    k = np.arange(len(at))
    moved = p[np.minimum(k + reach, len(at) - 1)] - p[np.maximum(k - reach, 0)]
    speed = np.linalg.norm(moved, axis=1)
    ahead = moved / np.maximum(speed, 1e-12)[:, None]
    turn = np.linalg.norm(ahead[np.minimum(k + reach, len(at) - 1)] - ahead[np.maximum(k - reach, 0)], axis=1)
    return speed, turn


def _lag(a: FloatArray, b: FloatArray) -> int | None:
    """Samples by which series `a` is to be moved for the largest correlation with `b`; None where there is none.

    The coefficient of what is common at each lag; source: Padfield, "Masked object registration in the Fourier domain",
    IEEE T-IP 2012. Half of the shorter one has to be common.
    """
    a, b = a - a.mean(), b - b.mean()
    ones = [np.ones_like(one) for one in (a, b)]

    def common(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(scipy.signal.correlate(y, x, method="fft"), dtype=np.float64)

    count = np.maximum(np.round(common(*ones)), 1.0)
    sum_a, sum_b = common(a, ones[1]), common(ones[0], b)
    var_a = common(a**2, ones[1]) - sum_a**2 / count
    var_b = common(ones[0], b**2) - sum_b**2 / count
    least = 1e-6 * min(float(np.sum(a**2)), float(np.sum(b**2)))
    reliable = (count >= max(_FEWEST_SAMPLES, 0.5 * min(len(a), len(b)))) & (np.minimum(var_a, var_b) > least)
    if not reliable.any():
        return None
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.where(reliable, (common(a, b) - sum_a * sum_b / count) / np.sqrt(var_a * var_b), -np.inf)
    return int(np.argmax(correlation)) - (len(a) - 1)


def shifted(trajectory: Trajectory, offset: float) -> Trajectory:
    """The same trajectory with that many seconds added to its times."""
    if trajectory.timestamps is None:
        raise ValueError("time_offset cannot be applied: the estimate has no times")
    return replace(trajectory, timestamps=trajectory.timestamps + offset)


def share_at_risk(pairs: PosePairs) -> float:
    """Share of poses at which the gap in time could explain `RISKY` of a claimed deviation of the position, or more.

    v dt / sigma, with the speed of the reference; 0 without claims or times.
    """
    claimed, times = pairs.estimate.pose_covariances, pairs.reference.timestamps
    if claimed is None or times is None or len(times) < 2:
        return 0.0
    speed = np.linalg.norm(np.gradient(pairs.reference.positions, times, axis=0), axis=1)
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(np.trace(claimed[:, :3, :3], axis1=1, axis2=2) / 3.0)
    return float(np.mean(speed * pairs.gaps > RISKY * sigma))


def _by_number(estimate: Trajectory, reference: Trajectory) -> PosePairs:
    mine, others = (
        np.arange(len(one)) if one.frame_numbers is None else np.asarray(one.frame_numbers)
        for one in (estimate, reference)
    )
    if estimate.frame_numbers is None and reference.frame_numbers is None and len(estimate) != len(reference):
        raise ValueError(
            f"estimate has {len(estimate)} poses, reference {len(reference)}: without times in both files their "
            "rows must be the same frames, or be numbered (13 columns)"
        )
    _, ours, theirs = np.intersect1d(mine, others, return_indices=True)
    if len(ours) <= FEWEST:
        raise ValueError(f"estimate and reference have {len(ours)} frames in common, more than {FEWEST} are needed")
    return PosePairs(estimate.rows(ours), reference.rows(theirs), ours, np.zeros(len(ours)))


def _interpolated(estimate: Trajectory, reference: Trajectory) -> PosePairs:
    """The reference between its poses, at the times of the estimate."""
    a, b = estimate.timestamps, reference.timestamps
    assert a is not None
    assert b is not None
    after = np.clip(np.searchsorted(b, a), 1, max(len(b) - 1, 1))
    inside = (a >= b[0]) & (a <= b[-1])
    if len(b) > 1:
        inside &= b[after] - b[after - 1] <= _HOLE * np.median(np.diff(b))
    ours = np.flatnonzero(inside)
    if len(ours) <= FEWEST or len(b) < 2:
        raise ValueError(_apart(len(ours), a, b, 0.0))
    at, after = a[ours], after[ours]
    part = ((at - b[after - 1]) / (b[after] - b[after - 1]))[:, None]

    def between(values: FloatArray) -> FloatArray:
        share = part.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((1.0 - share) * values[after - 1] + share * values[after])

    orientations = Slerp(b, Rotation.from_quat(reference.orientations))(at).as_quat()
    doubt = reference.covariances
    states = {
        name: StateBelief(between(belief.values), None if belief.covariances is None else between(belief.covariances))
        for name, belief in reference.states.items()
    }
    truth = Trajectory(
        between(reference.positions),
        orientations,
        at,
        None if doubt is None else between(doubt),
        reference.tangent,
        reference.name,
        reference.gauge,
        reference.body,
        states=states,
    )
    return PosePairs(estimate.rows(ours), truth, ours, np.zeros(len(ours)))


def _apart(common: int, a: FloatArray, b: FloatArray, max_gap: float) -> str:
    """Reason why too few poses belong together, and what to do."""
    message = f"estimate and reference have {common} poses in common, more than {FEWEST} are needed: "
    ours, theirs = float(np.ptp(a)), float(np.ptp(b))
    for unit, name in ((1e9, "nanoseconds"), (1e6, "microseconds"), (1e3, "milliseconds")):
        for longer, shorter, whose in ((ours, theirs, "estimate"), (theirs, ours, "reference")):
            if common < 2 and shorter > 0 and 0.1 < longer / shorter / unit < 10.0:
                return message + f"the times of the {whose} seem to be {name}, write them in seconds"
    if a[0] > b[-1] or b[0] > a[-1]:
        return message + (
            f"the estimate lasts from {a[0]:.9g} to {a[-1]:.9g} s, the reference from {b[0]:.9g} to {b[-1]:.9g} s; if "
            "it is another clock, say by how much with time_offset"
        )
    return (
        message + f"their clocks may differ, or give a max_gap larger than {max_gap:g} s, or interpolate the reference"
    )
