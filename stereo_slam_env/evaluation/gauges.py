"""Alignment of an estimate's world with that of its reference, and what it does to a covariance.

In the coordinates of `left_coordinates` an error of the pose of the world is the same number for every pose. So an
alignment that moves the world by gamma leaves the error xi'_k = xi_k - A_k gamma, and gamma is itself a sum of errors,
gamma = sum_j W_j xi_j. The covariance of xi'_k is that of the claim carried through the gauge that was fixed (Zhang,
Gallego and Scaramuzza, "On the comparison of gauge freedom handling in optimization-based visual-inertial state
estimation", RA-L 2018); `docs/derivations/gauge.md` derives it. A file does not say how the errors of two poses are
correlated, see `Correlation`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from filters import Pose
from filters.checks.consistency import are_definite
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.recording.trajectory import Trajectory, tangent_jacobian, transformed

AlignmentKind = Literal["none", "start", "gravity-yaw", "rigid", "sim3"]
"""As it is; first pose on first pose; position and heading; position and rotation; these and the scale."""

Correlation = Literal["increments", "independent"]
"""Of the errors of two poses. "increments": what a claim grows by is independent of what was before, as in odometry, so
the covariance of two errors is that of the earlier pose. "independent": they have nothing in common."""

UP = {"x": 0, "y": 1, "z": 2}
"""Axes of the reference's world that gravity may be along."""

_LINE = 1e-3
"""A path whose width is a smaller share of its length is a line."""
_ZERO = 1e-4
"""A variance that is a smaller share of the usual one is known."""
_SMALL = 0.01
"""A variance that is a smaller share of the usual one is so small that little hangs on it."""
_SHRINKS = 0.1
"""A claim that loses a larger share of a variance anywhere, or gains less in its second half, does not grow by
increments."""


@dataclass(frozen=True)
class Alignment:
    """Motion of an estimate's world into that of its reference, and which poses determined it."""

    kind: AlignmentKind
    """What was free to move."""
    T: Pose
    """The motion, after the scale."""
    scale: float
    """By which positions were multiplied; 1 but for "sim3"."""
    rows: BoolArray
    """(K,): the poses that determined it; none for "none"."""
    up: int
    """Axis of gravity."""

    def apply(self, estimate: Trajectory) -> Trajectory:
        """The estimate in the world of the reference, covariances with it."""
        return estimate if self.kind == "none" else estimate.moved(self.T, self.scale)


def find_alignment(
    kind: AlignmentKind, estimate: Trajectory, reference: Trajectory, rows: BoolArray, up: int
) -> Alignment:
    """The alignment of paired trajectories by `rows`: of positions, or of the whole pose where it is one pose.

    Raises
    ------
    ValueError
        The poses do not determine it.
    """
    if kind == "none":
        return Alignment(kind, Pose(), 1.0, np.zeros(len(estimate), dtype=bool), up)
    if kind == "start":
        rows = np.arange(len(estimate)) == 0
    first = int(np.argmax(rows))
    ours, theirs = estimate.positions[rows], reference.positions[rows]
    R, scale = np.eye(3), 1.0
    if rows.sum() == 1:
        if kind == "sim3":
            raise ValueError("one pose does not determine the scale of 'sim3': align by more seconds")
        Q = estimate.pose(first).R_wc @ reference.pose(first).R_wc.T
        R = Q.T
        if kind == "gravity-yaw":
            axis = np.eye(3)[up]
            spin = np.array([Q[2, 1] - Q[1, 2], Q[0, 2] - Q[2, 0], Q[1, 0] - Q[0, 1]])
            R = rotations.exp(np.arctan2(-axis @ spin, np.trace(Q) - axis @ Q @ axis) * axis)
    elif kind == "gravity-yaw":
        axis, a, b = np.eye(3)[up], ours - ours.mean(axis=0), theirs - theirs.mean(axis=0)
        flat = [part - np.outer(part @ axis, axis) for part in (a, b)]
        if min(np.linalg.norm(part) for part in flat) <= 1e-9 + _LINE * max(np.linalg.norm(a), np.linalg.norm(b)):
            raise ValueError(
                "the poses do not move across gravity, which does not determine a heading: give up=, or 'start'"
            )
        R = rotations.exp(np.arctan2(np.cross(a, b).sum(axis=0) @ axis, np.sum(flat[0] * flat[1])) * axis)
    else:
        for name, positions in (("estimate", ours), ("reference", theirs)):
            length, width, _ = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
            if width <= _LINE * length or length == 0.0:
                raise ValueError(
                    f"the {name} moves along a line or not at all, which does not determine a {kind} alignment: align "
                    "by 'start', or 'none'"
                )
        scale, R, _ = metrics.similarity(ours, theirs)
        if kind == "rigid":
            scale = 1.0
        elif scale <= 0.0:
            raise ValueError("no positive scale brings the estimate to the reference: they are of different drives")
    return Alignment(
        kind, Pose(theirs.mean(axis=0) - scale * R @ ours.mean(axis=0), rotations.from_matrix(R)), scale, rows, up
    )


def carried(covariances: FloatArray, aligned: Trajectory, alignment: Alignment, correlation: Correlation) -> FloatArray:
    """Covariances (K, 6, 6) of the errors of an aligned estimate, in its own definition, through the fixed gauge.

    `covariances` are those of its errors before, in the same definition and world.
    """
    if not alignment.rows.any():
        return covariances
    centre = aligned.positions[alignment.rows].mean(axis=0)
    J = left_coordinates(aligned, centre)
    P = transformed(J, covariances)
    A, W = _moved_and_weights(aligned.positions - centre, alignment)
    # What error k has in common with gamma (K, 6, g).
    if correlation == "increments":
        before = np.cumsum(P @ W.swapaxes(1, 2), axis=0)
        after = W.sum(axis=0) - np.cumsum(W, axis=0)
        common = before + P @ after.swapaxes(1, 2)
    else:
        common = P @ W.swapaxes(1, 2)
    of_gamma = (W @ common).sum(axis=0)
    cross = common @ A.swapaxes(1, 2)
    back: FloatArray = np.linalg.inv(J).astype(np.float64)
    return transformed(back, P - cross - cross.swapaxes(1, 2) + A @ of_gamma @ A.swapaxes(1, 2))


def left_coordinates(trajectory: Trajectory, centre: FloatArray) -> FloatArray:
    """J (K, 6, 6) from a trajectory's own errors to those of its world.

    These are the rotation about the axes of W, and the displacement that is left at `centre`.
    """
    J = tangent_jacobian(trajectory.tangent, trajectory.positions, trajectory.orientations)
    return tangent_jacobian("left", trajectory.positions - centre, trajectory.orientations) @ np.linalg.inv(J)


def own_gauge(trajectory: Trajectory) -> AlignmentKind:
    """The alignment of the gauge that a trajectory, or what it claims, was made in."""
    if trajectory.gauge in (None, "se3") and is_zero_at_start(trajectory):
        return "start"
    kinds: dict[str | None, AlignmentKind] = {"se3": "rigid", "gravity_yaw": "gravity-yaw", "sim3": "sim3"}
    return kinds.get(trajectory.gauge, "none")


def is_zero_at_start(trajectory: Trajectory) -> bool:
    """Whether what is claimed of the first pose is nothing against what is claimed of the others."""
    if (claimed := trajectory.covariances) is None or len(claimed) < 2:
        return False
    variances = np.diagonal(claimed, axis1=1, axis2=2)
    return bool((variances[0] <= _ZERO * np.median(variances[1:], axis=0)).all())


def is_fixed_at_start(trajectory: Trajectory) -> bool:
    """Whether the position of the first pose is claimed to be known, against those of the others.

    An inertial odometry, which measures gravity, may choose position and heading of its start: the first tells of both,
    while deviations along the axes of a tilted body do not say how well a heading is known.
    """
    if (claimed := trajectory.pose_covariances) is None or len(claimed) < 2 or not trajectory.is_oriented:
        return False
    variances = np.diagonal(claimed, axis1=1, axis2=2)[:, POSITION]
    return bool((variances[0] <= _SMALL * np.median(variances[1:], axis=0)).all())


def correlation_of(trajectory: Trajectory) -> Correlation:
    """Whether what is claimed grows to the end, as by increments; by tenths of the run, in the errors of its world."""
    if trajectory.covariances is None:
        return "independent"
    rows = np.unique(np.linspace(0, len(trajectory) - 1, 11).astype(int))
    some = trajectory.rows(rows)
    P = transformed(left_coordinates(some, some.positions.mean(axis=0)), trajectory.covariances[rows])
    with np.errstate(all="ignore"):
        size = np.sqrt(np.diagonal(P[-1]))
        P = P / size[:, None] / size
    if not np.isfinite(P).all():
        return "independent"
    grown = np.linalg.eigvalsh(np.diff(P, axis=0) + _SHRINKS * P[:-1])[:, 0] >= -1e-9
    still_grows = np.trace(P[-1]) >= (1.0 + _SHRINKS) * np.trace(P[len(P) // 2])
    return "increments" if grown.all() and still_grows else "independent"


def _moved_and_weights(points: FloatArray, alignment: Alignment) -> tuple[FloatArray, FloatArray]:
    """Jacobians of poses by the free numbers of an alignment, A (K, 6, g), and of these by errors, W (K, g, 6).

    `points` (K, 3) are the positions from the centre.
    """
    count = len(points)
    free = np.zeros((count, POSE_SIZE, 7))
    free[:, :, :POSE_SIZE] = np.eye(POSE_SIZE)
    free[:, POSITION, 6] = points
    turns = [3, 4, 5] if alignment.kind != "gravity-yaw" else [3 + alignment.up]
    A = free[:, :, [0, 1, 2, *turns, *([6] if alignment.kind == "sim3" else [])]]
    # What is seen of an error of the world: displacements, and of a single pose its rotation, too.
    seen = np.concatenate([np.tile(np.eye(3), (count, 1, 1)), -rotations.skew(points)], axis=2)
    if alignment.rows.sum() == 1:
        turned = np.zeros((count, 3, POSE_SIZE))
        turned[:, :, ROTATION] = np.eye(3)
        seen = np.concatenate([seen, turned], axis=1)
    seen = seen * alignment.rows[:, None, None]
    B = seen @ A
    normal = (B.swapaxes(1, 2) @ B).sum(axis=0)
    scale = np.sqrt(np.diagonal(normal))
    W = np.linalg.solve(normal / scale[:, None] / scale, (B.swapaxes(1, 2) @ seen) / scale[:, None]) / scale[:, None]
    return A, W


_LEFT = 1e-9
"""A direction in which a carried covariance keeps a smaller share of what was claimed is fixed by the alignment."""


@dataclass(frozen=True, eq=False)
class AlignedPair:
    """Paired trajectories in the world of the reference, and the covariances of the errors there."""

    estimate: Trajectory
    """(K poses)."""
    reference: Trajectory
    """(K poses), with the orientations of the estimate where one of the two has none to be compared."""
    alignment: Alignment
    """How they came there."""
    correlation: Correlation
    """How errors of two poses were taken to be correlated where the claim was carried through the alignment."""
    as_claimed: FloatArray | None
    """(K, 6, 6), of estimate and reference together, in the definition of the estimate; None: it claims nothing."""
    covariances: FloatArray | None
    """(K, 6, 6): the same, carried through the alignment."""
    scored: BoolArray
    """(K,): all but the poses that both have in common by the alignment, or from the start."""

    @property
    def errors(self) -> FloatArray:
        """Errors (K, 6) of the estimate, in its own definition."""
        return self.estimate.errors(self.reference.positions, self.reference.orientations)

    def rows(self, rows: BoolArray | slice) -> AlignedPair:
        """The same of some poses."""
        return replace(
            self,
            estimate=self.estimate.rows(rows),
            reference=self.reference.rows(rows),
            as_claimed=None if self.as_claimed is None else self.as_claimed[rows],
            covariances=None if self.covariances is None else self.covariances[rows],
            scored=self.scored[rows],
        )


def aligned_pair(estimate: Trajectory, reference: Trajectory, alignment: Alignment) -> AlignedPair:
    """Bring paired trajectories into one world, and what they claim with them."""
    correlation, aligned = correlation_of(estimate), alignment.apply(estimate)
    if not aligned.is_oriented:
        reference = replace(reference, orientations=aligned.orientations)
    as_claimed = covariances = aligned.covariances
    if as_claimed is not None:
        covariances = carried(as_claimed, aligned, alignment, correlation)
        if (doubt := reference.pose_covariances) is not None:
            doubt = transformed(tangent_jacobian(aligned.tangent, aligned.positions, aligned.orientations), doubt)
            as_claimed = as_claimed + doubt
            covariances = covariances + carried(doubt, aligned, alignment, correlation_of(reference))
    scored = np.ones(len(aligned), dtype=bool)
    if alignment.rows.sum() == 1:
        scored &= ~alignment.rows
    scored[0] &= alignment.kind != "none" and not is_zero_at_start(aligned)
    if as_claimed is not None and covariances is not None and covariances is not as_claimed:
        usable = are_definite(as_claimed)
        L = np.linalg.inv(np.linalg.cholesky(as_claimed[usable]))
        scored[usable] &= np.linalg.eigvalsh(transformed(L, covariances[usable]))[:, 0] > _LEFT
    return AlignedPair(aligned, reference, alignment, correlation, as_claimed, covariances, scored)
