"""Trajectories: poses over time with the covariance that is claimed for them, whoever estimated them.

A covariance means nothing without the definition of the error it is of. There are four here, see `Tangent`; they agree
to first order, but a NEES is to be computed in the one that the covariance is kept in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from filters import Pose
from filters.contract.validation import finite_array
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
from stereo_slam_env.recording.recording import Drift
from stereo_slam_env.recording.state_beliefs import StateBelief, require_states

Tangent = Literal["position-rotation", "position-quaternion", "right", "left"]
"""Definition of a pose error, position part first; hats are estimates.

"position-rotation": [p - p^ in W ; Log(R^^T R) in the body], as in `PoseBelief`. "position-quaternion": the same with
twice the vector part over the scalar part of the quaternion in place of Log. "right": Log of SE(3) of T^^-1 T. "left":
that of T T^^-1. Source of the latter two: Sola, Deray and Atchuthan, 2018.
"""

Gauge = Literal["fixed", "se3", "gravity_yaw", "sim3"]
"""What an estimate leaves open: nothing, because its start pose was given; the pose of its world; position and heading,
as a system that measures gravity does; the pose and the scale of its world."""
_FARTHEST = 1e12
"""Beyond this, m, a position is a mistake."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """K poses of a body in W, in the order of time.

    Raises
    ------
    ValueError
        Wrong shapes, NaN or infinity in poses, quaternions that are no rotations, times or frame numbers that do not
        ascend, no pose.
    """

    positions: FloatArray
    """(K, 3), m, in W."""
    orientations: FloatArray
    """(K, 4): unit quaternions xyzw of R_wb."""
    timestamps: FloatArray | None = None
    """(K,), s, ascending. None: rows are numbered, not timed."""
    covariances: FloatArray | None = None
    """(K, 6, 6): claimed for the error that `tangent` says, position part first. None: nothing is claimed."""
    tangent: Tangent = "position-rotation"
    """Definition of that error."""
    name: str = "estimate"
    """Whose trajectory it is, for tables."""
    gauge: Gauge | None = "fixed"
    """What its world leaves open, "fixed": nothing, it is that of the reference. None: not said."""
    body: str | None = None
    """Frame whose poses these are, such as "left_camera"; None: not said."""
    frame_numbers: IntArray | None = None
    """(K,), ascending: which frames of the drive the rows are, where some are missing. None: not numbered."""
    notes: tuple[str, ...] = ()
    """What was left out or taken for granted where it was read, each in a sentence."""
    tracks: FloatArray | None = None
    """(K,), > 0: how many tracked points each pose was estimated from, for `claim`. None: not said."""
    plane: FloatArray | None = None
    """(3, 3): axes x, y, up of the plane, in W, where the covariances are of motion in a plane: of x, y and the angle
    about up. The others are then filled in, and are no claim. None: of all six numbers."""
    drift: Drift | None = None
    """What the claimed errors of two poses have in common, if they are those of an odometry. None: not said."""
    is_oriented: bool = True
    """Whether the orientations are data. False: only the positions are, and the orientations fill their place."""
    states: Mapping[str, StateBelief] = field(default_factory=dict)
    """What an inertial odometry estimates beside the pose, by the names of `state_beliefs.UNITS_OF`."""

    def __post_init__(self) -> None:
        positions = finite_array("positions", self.positions, ("K", 3))
        count = len(positions)
        orientations = finite_array("orientations", self.orientations, (count, 4))
        if not count:
            raise ValueError("positions must hold at least one pose, got none")
        if (far := np.flatnonzero(np.abs(positions).max(axis=1) > _FARTHEST)).size:
            worst = np.abs(positions[far[0]]).max()
            raise ValueError(f"positions must be in m, below {_FARTHEST:g}: row {far[0]} has {worst:.3g}")
        with np.errstate(over="ignore"):  # no unit length either
            lengths = np.linalg.norm(orientations, axis=1)
        if (bad := np.flatnonzero(np.abs(lengths - 1.0) > 0.01)).size:
            raise ValueError(
                f"orientations must be unit quaternions xyzw, row {bad[0]} has length {lengths[bad[0]]:.3g}: correct it"
            )
        if self.tangent not in get_args(Tangent):
            raise ValueError(f"tangent must be one of {', '.join(get_args(Tangent))}, got {self.tangent!r}")
        if self.gauge is not None and self.gauge not in get_args(Gauge):
            raise ValueError(f"gauge must be one of {', '.join(get_args(Gauge))}, got {self.gauge!r}")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "orientations", orientations / lengths[:, None])
        if self.timestamps is not None:
            times = finite_array("timestamps", self.timestamps, (count,))
            steps = np.diff(times)
            if (late := np.flatnonzero(steps <= 0)).size:
                row = int(late[0])
                if steps[row] == 0:
                    what = f"row {row + 1} has the time of row {row}, {times[row]:.9g} s: leave one of them out"
                else:
                    what = f"row {row + 1} is earlier than row {row}: sort the rows by time"
                raise ValueError(f"timestamps must ascend, {what}")
            object.__setattr__(self, "timestamps", times)
        if self.frame_numbers is not None:
            numbers = np.asarray(self.frame_numbers)
            if numbers.shape != (count,) or (np.diff(numbers) <= 0).any():
                raise ValueError(f"frame_numbers must be {count} ascending numbers: sort the rows, each frame once")
        if self.tracks is not None:
            tracks = finite_array("tracks", self.tracks, (count,))
            if (few := np.flatnonzero(tracks <= 0.0)).size:
                raise ValueError(f"tracks must be > 0, row {few[0]} has {tracks[few[0]]:g}: leave that pose out")
            object.__setattr__(self, "tracks", tracks)
        if self.covariances is not None:
            covariances = np.asarray(self.covariances, dtype=np.float64)
            if covariances.shape != (count, 6, 6):
                raise ValueError(f"covariances must have the shape ({count}, 6, 6), got {covariances.shape}")
            object.__setattr__(self, "covariances", covariances)
        require_states(self.states, count)

    def __len__(self) -> int:
        return len(self.positions)

    def pose(self, row: int) -> Pose:
        """The pose of a row."""
        return Pose(self.positions[row], self.orientations[row])

    def rows(self, index: BoolArray | IntArray | slice) -> Trajectory:
        """The trajectory of some rows, by number or mask."""
        names = ("positions", "orientations", "timestamps", "covariances", "frame_numbers", "tracks")
        parts = {name: part[index] for name in names if (part := getattr(self, name)) is not None}
        drift = None if self.drift is None else self.drift.rows(index)
        return replace(self, **parts, drift=drift, states={name: s.rows(index) for name, s in self.states.items()})

    def errors(self, positions: FloatArray, orientations: FloatArray) -> FloatArray:
        """Errors (K, 6) against true poses, in the definition of `tangent`."""
        return pose_errors(self.tangent, self.positions, self.orientations, positions, orientations)

    @property
    def pose_covariances(self) -> FloatArray | None:
        """The covariances (K, 6, 6) for the error of `PoseBelief`; None where nothing is claimed."""
        if self.covariances is None:
            return None
        J = tangent_jacobian(self.tangent, self.positions, self.orientations)
        return transformed(np.linalg.inv(J).astype(np.float64), self.covariances)

    def moved(self, T: Pose, scale: float = 1.0) -> Trajectory:
        """The same trajectory in another world: T times each pose, scaled before; covariances with them."""
        positions = T @ (scale * self.positions)
        orientations = rotations.multiply(np.broadcast_to(T.orientation, self.orientations.shape), self.orientations)
        turn = np.eye(POSE_SIZE)
        turn[POSITION, POSITION] = scale * T.R_wc
        plane = None if self.plane is None else self.plane @ T.R_wc.T
        states = {name: s.turned(scale * T.R_wc) if name == "velocity" else s for name, s in self.states.items()}
        return replace(self._carried(positions, orientations, turn), plane=plane, states=states)

    def of_body(self, T_bc: Pose) -> Trajectory:
        """The trajectory of another frame C of the same rigid body: each pose times T_bc, covariances with them.

        An error of rotation moves the new origin by its lever arm: the adjoint of SE(3), in the coordinates of
        `PoseBelief`. Biases are turned to its axes; the velocity, which a lever arm changes by the angular rate, is
        dropped where there is one.
        """
        R_wb = rotations.matrix(self.orientations)
        positions = self.positions + R_wb @ T_bc.position
        orientations = rotations.multiply(self.orientations, np.broadcast_to(T_bc.orientation, self.orientations.shape))
        J = np.tile(np.eye(POSE_SIZE), (len(self), 1, 1))
        J[:, POSITION, ROTATION] = -R_wb @ rotations.skew(T_bc.position)
        J[:, ROTATION, ROTATION] = T_bc.R_wc.T
        states = {name: s if name == "velocity" else s.turned(T_bc.R_wc.T) for name, s in self.states.items()}
        notes = self.notes
        if "velocity" in states and np.any(T_bc.position):
            del states["velocity"]
            notes = (*notes, "its velocity is that of another point of the body, and is not judged")
        return replace(self._carried(positions, orientations, J), states=states, notes=notes)

    def _carried(self, positions: FloatArray, orientations: FloatArray, J: FloatArray) -> Trajectory:
        """At other poses, with J (6, 6) or (K, 6, 6) from the errors of `PoseBelief` here to those there."""
        if self.covariances is None:
            return replace(self, positions=positions, orientations=orientations)
        before = tangent_jacobian(self.tangent, self.positions, self.orientations)
        J = tangent_jacobian(self.tangent, positions, orientations) @ J @ np.linalg.inv(before)
        return replace(
            self,
            positions=positions,
            orientations=orientations,
            covariances=transformed(J, self.covariances),
            drift=None if self.drift is None else self.drift.through(J),
        )


def pose_errors(
    tangent: Tangent,
    positions: FloatArray,
    orientations: FloatArray,
    true_positions: FloatArray,
    true_orientations: FloatArray,
) -> FloatArray:
    """Errors (K, 6) of estimated poses against true ones, in the definition of `tangent`."""
    R, R_true = rotations.matrix(orientations), rotations.matrix(true_orientations)
    if tangent == "left":
        theta = rotations.log(R_true @ R.swapaxes(-1, -2))
        shift = true_positions - rotations.turned(rotations.exp(theta), positions)
        return np.concatenate([_solved(rotations.right_jacobian(-theta), shift), theta], axis=-1)
    shift = true_positions - positions
    if tangent == "position-quaternion":
        dq = rotations.between(orientations, true_orientations)
        return np.concatenate([shift, 2.0 * dq[..., :3] / dq[..., 3:]], axis=-1)
    phi = rotations.log(R.swapaxes(-1, -2) @ R_true)
    if tangent == "right":
        shift = _solved(rotations.right_jacobian(-phi), rotations.turned(R.swapaxes(-1, -2), shift))
    return np.concatenate([shift, phi], axis=-1)


def tangent_jacobian(tangent: Tangent, positions: FloatArray, orientations: FloatArray) -> FloatArray:
    """J (K, 6, 6) that takes small errors as of `PoseBelief` to those of `tangent`, at the estimate."""
    R = rotations.matrix(orientations)
    J = np.tile(np.eye(POSE_SIZE), (len(R), 1, 1))
    if tangent == "right":
        J[:, POSITION, POSITION] = R.swapaxes(-1, -2)
    elif tangent == "left":
        J[:, POSITION, ROTATION] = rotations.skew(positions) @ R
        J[:, ROTATION, ROTATION] = R
    return J


def transformed(J: FloatArray, covariances: FloatArray) -> FloatArray:
    """J C J^T, symmetric to the last bit."""
    moved: FloatArray = J @ covariances @ J.swapaxes(-1, -2)
    return np.asarray(0.5 * (moved + moved.swapaxes(-1, -2)), dtype=np.float64)


def _solved(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(matrices, vectors[..., None])[..., 0], dtype=np.float64)
