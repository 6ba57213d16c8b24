"""Named variables of the state: what a part may ask for besides pose, velocity and map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.contract.validation import covariance_matrix, finite_array, unique_ids
from filters.geometry import derivatives, rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.retractions import ADDITIVE, Retraction, RotationVector

POSE, VELOCITY = "pose", "velocity"
"""The variables that every filter has."""


@dataclass(frozen=True, eq=False)
class Variable:
    """A variable of the state as it is at the start.

    Parameters
    ----------
    name : str
        Of `StereoEKF.belief`; "pose" and "velocity" are taken.
    value : (v,) array_like
        Its numbers.
    covariance : (s, s) array_like
        Of its error, in the coordinates of the retraction.
    retraction : Retraction
        How a correction (s,) changes the value: the default adds it; `RotationVector()` turns a quaternion, xyzw.
    considered : bool
        Schmidt's consider variable: it has a covariance and correlations, but no measurement changes its value or
        its own covariance.
    random_walk : (s,) array_like, optional
        Process noise, a standard deviation per square root of a second. None: the variable is constant.
    in_world : bool
        Whether the value is a vector in W, such as gravity, which turns with the world.

    Raises
    ------
    ValueError
        An argument has the wrong shape, is not finite, or is no covariance.

    References
    ----------
    S. F. Schmidt, "Application of state-space methods to navigation problems", Advances in Control Systems 3, 1966.
    P. Geneva et al., "OpenVINS: A research platform for visual-inertial estimation", ICRA 2020 (its `Type`).
    """

    name: str
    value: FloatArray
    covariance: FloatArray
    retraction: Retraction = ADDITIVE
    considered: bool = False
    random_walk: FloatArray | None = None
    in_world: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name or self.name in (POSE, VELOCITY):
            raise ValueError(f'name must be that of a new variable, not "{POSE}" or "{VELOCITY}", got {self.name!r}')
        what = f"variable {self.name!r}"
        shape: tuple[int | str, ...] = (3,) if self.in_world else ("v",)
        object.__setattr__(self, "value", finite_array(f"value of {what}", self.value, shape))
        size = len(np.atleast_1d(np.asarray(self.covariance, dtype=np.float64)))
        object.__setattr__(self, "covariance", covariance_matrix(f"covariance of {what}", self.covariance, size))
        self._check_retraction(what, size)
        if self.random_walk is not None:
            walk = finite_array(f"random_walk of {what}", self.random_walk, (size,))
            if (walk < 0.0).any():
                raise ValueError(f"random_walk of {what} must be standard deviations >= 0, got {walk.tolist()}")
            object.__setattr__(self, "random_walk", walk)

    def _check_retraction(self, what: str, size: int) -> None:
        wanted = (4, 3) if isinstance(self.retraction, RotationVector) else (len(self.value),) * 2
        if self.retraction is not ADDITIVE and not isinstance(self.retraction, RotationVector):
            raise ValueError(
                f"retraction of {what} must be addition or RotationVector(), of a quaternion, got {self.retraction!r}"
            )
        if (len(self.value), size) != wanted:
            raise ValueError(
                f"{what} must have {wanted[0]} numbers and {wanted[1]} errors, got {len(self.value)}, {size}"
            )

    @property
    def size(self) -> int:
        """Numbers of its error."""
        return len(self.covariance)

    def turned(self, value: FloatArray, R: FloatArray) -> FloatArray:
        """The value in a world rotated about its origin by R (3, 3)."""
        return R @ value if self.in_world else value

    def world_rotation(self, value: FloatArray) -> FloatArray:
        """Effect of a rotation of the world on the error; (s, 3)."""
        if not self.in_world:
            return np.zeros((self.size, 3))
        return derivatives.jacobian(lambda e: self.retraction.local(value, rotations.exp(e) @ value), 3)


@dataclass(frozen=True, eq=False)
class VariableBelief:
    """Belief of a named variable."""

    value: FloatArray
    """(v,): its numbers; of the pose, position (W, m) and orientation (xyzw)."""
    covariance: FloatArray
    """(s, s), of its error."""


@dataclass(frozen=True, eq=False)
class MovedLandmarks:
    """Landmarks that the step of a variable moves: N points of W after it, and their Jacobians."""

    ids: IntArray
    """(N,): which ones."""
    positions: FloatArray
    """(N, 3): m, after the step."""
    by_landmark: FloatArray
    """(N, 3, 3): by their positions before the step."""
    by_variable: FloatArray
    """(N, 3, s): by the error of the variable before the step."""

    def __post_init__(self) -> None:
        ids = unique_ids("landmarks.ids", np.asarray(self.ids))
        object.__setattr__(self, "ids", ids)
        for name, shape in (("positions", (3,)), ("by_landmark", (3, 3)), ("by_variable", (3, "s"))):
            value = finite_array(f"landmarks.{name}", getattr(self, name), (len(ids), *shape))
            object.__setattr__(self, name, value)

    @classmethod
    def none(cls, size: int) -> MovedLandmarks:
        """No landmark, beside a variable of so many error numbers."""
        empty = np.zeros((0, 3, size))
        return cls(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)), empty)
