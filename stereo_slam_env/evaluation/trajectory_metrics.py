"""Trajectory errors: pure functions of positions and orientations.

Rows are paired: row k of both trajectories belongs to the same instant. Rows with NaN must be removed first.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from filters.contract.validation import finite_array
from filters.geometry.arrays import FloatArray, IntArray

KITTI_LENGTHS = tuple(100.0 * i for i in range(1, 9))  # m, of the KITTI odometry benchmark
SHORT_LENGTHS = (5.0, 10.0, 25.0, 50.0)  # m, for drives on which those say little or nothing
SHORT_PATH = 200.0  # m
SEGMENT_STEP = 10  # rows from the start of one segment to the next


@dataclass(frozen=True, eq=False)
class SegmentErrors:
    """Relative error of S segments."""

    lengths: FloatArray  # (S,): nominal length, m
    # (S,): of the motion over the segment, per length.
    translation_percent: FloatArray
    rotation_deg_per_100m: FloatArray

    def __len__(self) -> int:
        return len(self.lengths)

    @classmethod
    def together(cls, parts: Iterable[SegmentErrors]) -> SegmentErrors:
        """The segments of several runs."""
        columns = zip(*((p.lengths, p.translation_percent, p.rotation_deg_per_100m) for p in parts), strict=True)
        return cls(*(np.concatenate(column) for column in columns))


def ate_rigid(estimate: FloatArray, reference: FloatArray) -> float:
    """Root mean square distance after the best rigid motion without scale, m.

    Defined for positions on a line too: the motion is then not unique, but its residual is.
    """
    estimate, reference = _paired(estimate, reference)
    R, t = rigid_motion(estimate, reference)
    return root_mean_square(estimate @ R.T + t - reference)


def rigid_motion(estimate: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and translation (3,) that bring positions (K, 3) closest to others, by least squares.

    Source: Umeyama, PAMI 1991, with the scale held at 1.
    """
    mean_estimate, mean_reference = estimate.mean(axis=0), reference.mean(axis=0)
    U, _, Vt = np.linalg.svd((reference - mean_reference).T @ (estimate - mean_estimate))
    R = (U * np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])) @ Vt
    return R, mean_reference - R @ mean_estimate


def similarity(estimate: FloatArray, reference: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Scale, rotation (3, 3) and translation (3,) that bring positions (K, 3) closest to others; source as above."""
    R, _ = rigid_motion(estimate, reference)
    a, b = estimate - estimate.mean(axis=0), reference - reference.mean(axis=0)
    size = float(np.sum(a * a))
    scale = float(np.sum((a @ R.T) * b)) / size if size > 0.0 else 1.0
    return scale, R, reference.mean(axis=0) - scale * R @ estimate.mean(axis=0)


def ate_scaled(estimate: FloatArray, reference: FloatArray) -> float:
    """Root mean square distance after the best rigid motion and scale, m."""
    estimate, reference = _paired(estimate, reference)
    scale, R, t = similarity(estimate, reference)
    return root_mean_square(scale * estimate @ R.T + t - reference)


def ate_unaligned(estimate: FloatArray, reference: FloatArray) -> float:
    """Root mean square distance as it is: both trajectories start at the same known pose, m."""
    estimate, reference = _paired(estimate, reference)
    return root_mean_square(estimate - reference)


def path_length(positions: FloatArray) -> float:
    """Length of the way along (K, 3) positions, m."""
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


def end_drift_percent(estimate: FloatArray, reference: FloatArray) -> float:
    """Distance between the last positions, without alignment, in percent of the reference's path length.

    Raises
    ------
    ValueError
        The reference does not move.
    """
    estimate, reference = _paired(estimate, reference)
    length = path_length(reference)
    if length == 0.0:
        raise ValueError("reference does not move: drift in percent of the path is not defined")
    return float(100.0 * np.linalg.norm(estimate[-1] - reference[-1]) / length)


def rotation_errors(estimate: FloatArray, reference: FloatArray) -> FloatArray:
    """Angle between the orientations of each row; (K, 4), (K, 4) xyzw -> (K,) rad."""
    return np.asarray((Rotation.from_quat(estimate).inv() * Rotation.from_quat(reference)).magnitude())


def segment_lengths(path_m: float) -> tuple[float, ...]:
    """Lengths of the segments of a path: KITTI's as far as they fit, or shorter ones up to half of a short path, m."""
    if path_m >= SHORT_PATH:
        return tuple(length for length in KITTI_LENGTHS if length < path_m)
    return tuple(length for length in SHORT_LENGTHS if length <= 0.5 * path_m)


def segment_pairs(
    positions: FloatArray, lengths: Sequence[float], step: int = SEGMENT_STEP
) -> tuple[FloatArray, IntArray, IntArray]:
    """First and last rows of segments: from every `step`-th row to the first one beyond the length.

    Source: KITTI odometry development kit (Geiger et al., CVPR 2012). `positions` (K, 3) and `lengths` in m; returns
    lengths, first and last (S,), by length.
    """
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    starts = np.arange(0, len(positions), step)
    length, first = (grid.ravel() for grid in np.meshgrid(np.asarray(lengths, dtype=float), starts, indexing="ij"))
    last = np.searchsorted(distance, distance[first] + length, side="right")
    inside = last < len(positions)
    return length[inside], first[inside], last[inside]


def relative_errors(
    positions: FloatArray,
    orientations: FloatArray,
    true_positions: FloatArray,
    true_orientations: FloatArray,
    first: IntArray,
    last: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """Error of the motion from row `first` to row `last`, as seen from the pose at `first`: (S,) m and rad.

    Positions (K, 3) in m, orientations (K, 4) xyzw.
    """
    moved, turned = _motion(positions, orientations, first, last)
    truly_moved, truly_turned = _motion(true_positions, true_orientations, first, last)
    return np.linalg.norm(moved - truly_moved, axis=1), np.asarray((turned.inv() * truly_turned).magnitude())


def segment_errors(
    positions: FloatArray,
    orientations: FloatArray,
    true_positions: FloatArray,
    true_orientations: FloatArray,
    lengths: Sequence[float] | None = None,
) -> SegmentErrors:
    """Relative errors by segment length, as KITTI measures them; t_rel and r_rel are their means.

    Poses as of `relative_errors`; `lengths` in m, None: `segment_lengths` of the reference.
    """
    if lengths is None:
        lengths = segment_lengths(path_length(true_positions))
    length, first, last = segment_pairs(true_positions, lengths)
    if len(length) == 0:
        return SegmentErrors(length, length, length)
    translation, rotation = relative_errors(positions, orientations, true_positions, true_orientations, first, last)
    return SegmentErrors(length, 100.0 * translation / length, 100.0 * np.rad2deg(rotation) / length)


def root_mean_square(errors: FloatArray) -> float:
    """Root of the mean squared length of (K, n) vectors or (K,) numbers."""
    squared = np.square(errors)
    return float(np.sqrt(np.mean(squared.sum(axis=1) if squared.ndim == 2 else squared)))


def mean(values: FloatArray) -> float:
    """Mean; NaN of none."""
    return float(values.mean()) if len(values) else float("nan")


def _motion(
    positions: FloatArray, orientations: FloatArray, first: IntArray, last: IntArray
) -> tuple[FloatArray, Rotation]:
    """Displacement in the frame at `first`, and rotation from there to `last`."""
    start = Rotation.from_quat(orientations[first]).inv()
    return start.apply(positions[last] - positions[first]), start * Rotation.from_quat(orientations[last])


def _paired(estimate: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    estimate = finite_array("estimate", estimate, ("K", 3))
    reference = finite_array("reference", reference, ("K", 3))
    if len(estimate) != len(reference):
        raise ValueError(f"estimate and reference must be paired: {len(estimate)} and {len(reference)} positions")
    if len(estimate) < 3:
        raise ValueError(f"estimate and reference must have at least 3 positions, got {len(estimate)}")
    return estimate, reference
