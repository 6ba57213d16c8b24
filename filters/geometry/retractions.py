"""Retractions: how a correction of a few numbers changes the value of a variable.

`retract` applies it, and `local` is the inverse. All take one value or many at once. Those of the orientation are
corrections by three numbers in the camera frame. The engine has them compiled, with the Jacobians that carry P along.

Derivation: docs/derivations/errors.md.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.machine_code import compiled


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
        """x + delta."""
        return value + delta

    def local(self, value: FloatArray, other: FloatArray) -> FloatArray:
        """The difference."""
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
        """q x q(delta)."""
        return rotations.multiply(value, rotations.exp_quaternion(delta))

    def local(self, value: FloatArray, other: FloatArray) -> FloatArray:
        """Log(R^T R_other)."""
        return rotations.log(rotations.matrix(value).swapaxes(-1, -2) @ rotations.matrix(other))


ADDITIVE: Retraction = Additive()
