"""Poses of one frame in another (SE(3)), and retractions: how a correction changes the value of a variable.

`retract` applies a correction of a few numbers, and `local` is the inverse. All take one value or many at once. Those
of the orientation are corrections by three numbers in the camera frame. The engine has them compiled, with the
Jacobians that carry P along.

Derivation: docs/derivations/errors.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, overload

import numpy as np
from numpy.typing import ArrayLike

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.machine_code import compiled

_ROUNDING, _ROUGHLY = 1e-6, 2e-3
"""Of the squared norm of a quaternion that keeps its bits, and of one that is normalised."""


def _vector(name: str, value: ArrayLike, size: int) -> FloatArray:
    """`value` as float64 of shape (size,); what is so already stays the same object."""
    if type(value) is np.ndarray and value.dtype.char == "d" and value.shape == (size,):
        return value
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be {size} numbers, got {value!r}") from error
    if array.shape != (size,):
        raise ValueError(f"{name} must have shape ({size},), got {array.shape}")
    return array


def _origin() -> FloatArray:
    return np.zeros(3)


def _unturned() -> FloatArray:
    return np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose T_ab of a frame B in a frame A; unless said otherwise that of the left camera C in the world W, T_wc.

    `T_wc @ T_cb` composes poses, `T_wc @ p_c` takes points (..., 3) into W, `T_wc.inverse()` is T_cw.

    Raises
    ------
    ValueError
        A wrong shape, NaN or infinity, a quaternion that is not a unit one.

    References
    ----------
    Sola, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, section IV and appendix D.
    """

    position: FloatArray = field(default_factory=_origin)
    """(3,): origin of B in A, m."""
    orientation: FloatArray = field(default_factory=_unturned)
    """(4,): unit quaternion xyzw of R_ab."""

    def __post_init__(self) -> None:
        position, orientation = _vector("position", self.position, 3), _vector("orientation", self.orientation, 4)
        if not (math.isfinite(position.dot(position)) or np.isfinite(position).all()):  # the first is the quicker one
            raise ValueError(f"position must be finite, got {position}")
        square = float(orientation.dot(orientation))
        if not abs(square - 1.0) < _ROUGHLY:
            raise ValueError(f"orientation must be a unit quaternion (xyzw), got {orientation}: normalise it")
        if abs(square - 1.0) > _ROUNDING:
            orientation = orientation / np.sqrt(square)
        vars(self).update(position=position, orientation=orientation)

    @classmethod
    def exp(cls, tangent: ArrayLike) -> Pose:
        """The pose whose `log` is `tangent`, (6,): translation part (m), then rotation vector (rad)."""
        tangent = np.asarray(tangent, dtype=np.float64)
        rho, phi = tangent[:3], tangent[3:]
        # The left Jacobian of phi is the right one of -phi.
        return cls(rotations.right_jacobian(-phi) @ rho, rotations.exp_quaternion(phi))

    @cached_property
    def R_wc(self) -> FloatArray:
        """Rotation matrix, takes vectors of B (the camera) into A (the world); (3, 3), read-only."""
        R_wc = rotations.matrix(self.orientation)
        R_wc.flags.writeable = False
        return R_wc

    @overload
    def __matmul__(self, other: Pose) -> Pose: ...

    @overload
    def __matmul__(self, other: FloatArray) -> FloatArray: ...

    def __matmul__(self, other: Pose | FloatArray) -> Pose | FloatArray:
        if isinstance(other, Pose):
            orientation = rotations.multiply(self.orientation, other.orientation)
            return Pose(self.position + self.R_wc @ other.position, orientation)
        points = np.asarray(other, dtype=np.float64)
        if points.shape[-1:] != (3,):
            raise ValueError(f"points must have shape (..., 3), got {points.shape}")
        moved: FloatArray = points @ self.R_wc.T + self.position
        return moved

    def inverse(self) -> Pose:
        """T_ba, the pose of A in B."""
        return Pose(-self.R_wc.T @ self.position, self.orientation * [-1.0, -1.0, -1.0, 1.0])

    def log(self) -> FloatArray:
        """Logarithm of SE(3), (6,): translation part (m), then the rotation vector of length <= pi (rad)."""
        phi = rotations.log(self.R_wc)
        return np.concatenate([np.linalg.solve(rotations.right_jacobian(-phi), self.position), phi])

    def to_camera(self, points_w: FloatArray) -> FloatArray:
        """Points of A (the world) in B (the camera), `inverse() @ points_w`; (..., 3) m -> (..., 3) m."""
        points_c: FloatArray = (points_w - self.position) @ self.R_wc
        return points_c


def relative_jacobian(first: Pose, last: Pose) -> FloatArray:
    """J (6, 12) that takes the errors of two poses to that of `first.inverse() @ last`, to first order.

    All errors are those of `PoseBelief`: of the position in the frame that the pose is in, of the rotation in the frame
    whose pose it is.
    """
    T = first.inverse() @ last
    J = np.zeros((6, 12))
    J[:3, :3], J[:3, 6:9] = -first.R_wc.T, first.R_wc.T
    J[:3, 3:6] = rotations.skew(T.position)
    J[3:, 3:6], J[3:, 9:] = -T.R_wc.T, np.eye(3)
    return J


class Retraction(Protocol):
    """Retraction of a variable of s error numbers and v numbers of its value, for one or many.

    References
    ----------
    Absil, Mahony and Sepulchre, "Optimization Algorithms on Matrix Manifolds", 2008, section 4.1.
    Hertzberg et al., "Integrating generic sensor fusion algorithms with sound state representations through
    encapsulation of manifolds", Information Fusion 14(1), 2013.
    """

    def retract(self, value: FloatArray, delta: FloatArray) -> FloatArray:
        """Corrected value; (..., v), (..., s) -> (..., v)."""

    def local(self, value: FloatArray, other: FloatArray) -> FloatArray:
        """The correction that takes `value` to `other`; (..., v), (..., v) -> (..., s)."""


class Additive:
    """The correction is added."""

    def retract(self, value: FloatArray, delta: FloatArray) -> FloatArray:
        """Vector after a change: x + delta."""
        return value + delta

    def local(self, value: FloatArray, other: FloatArray) -> FloatArray:
        """Difference of two vectors, other - x."""
        return other - value


class AdditiveQuaternion:
    """The paper's: dq is added to the quaternion, which is then normalised.

    An additive correction of a unit quaternion is tangent to it, dq = q x (delta / 2, 0), because the
    normalisation Jacobian leaves no variance along q. So the three numbers delta say all there is to say, and
    the 13-number camera state with a singular P becomes a 12-number one with a regular P and the same estimates:
    normalise(q + dq) is `retract`, the normalisation Jacobian I - q q^T (over the norm) is `additive_transport_of`.
    """

    def retract(self, value: FloatArray, delta: FloatArray) -> FloatArray:
        """q x (delta / 2, 1), normalised."""
        return rotations.multiply(value, np.concatenate([0.5 * delta, np.ones((*delta.shape[:-1], 1))], axis=-1))

    def local(self, value: FloatArray, other: FloatArray) -> FloatArray:
        """Twice the vector part over the scalar part."""
        dq = rotations.between(value, other)
        correction: FloatArray = 2.0 * dq[..., :3] / dq[..., 3:]
        return correction


@compiled
def additive_transport_of(x: float, y: float, z: float) -> rotations.Nine:
    """Jacobian of `AdditiveQuaternion` at a correction, (I - [delta]x / 2) / (1 + |delta|^2 / 4), row by row."""
    a, b, c = 0.5 * x, 0.5 * y, 0.5 * z
    diagonal = 1.0 / (1.0 + a * a + b * b + c * c)
    a, b, c = a * diagonal, b * diagonal, c * diagonal
    return diagonal, c, -b, -c, diagonal, a, b, -a, diagonal


class RotationVector:
    """SO(3) error state: q x q(delta)."""

    def retract(self, value: FloatArray, delta: FloatArray) -> FloatArray:
        """Quaternion after a turn: q x q(delta)."""
        return rotations.multiply(value, rotations.exp_quaternion(delta))

    def local(self, value: FloatArray, other: FloatArray) -> FloatArray:
        """Turn between orientations: Log(R^T R_other)."""
        return rotations.log(rotations.matrix(value).swapaxes(-1, -2) @ rotations.matrix(other))


ADDITIVE: Retraction = Additive()
