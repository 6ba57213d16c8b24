"""Retractions of the orientation: corrections by three numbers in the camera frame.

`retract` applies it, `local` is the inverse, and `transport` is the Jacobian that carries the covariance from the
old orientation to the new one. All take one camera or many at once.

Derivation: docs/derivations/errors.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from filters import rotations
from filters.validation import FloatArray

_EYE = np.eye(3)


class Retraction(Protocol):
    """Retraction of the orientation, for one camera or many.

    References
    ----------
    Absil, Mahony and Sepulchre, "Optimization Algorithms on Matrix Manifolds", 2008, section 4.1.
    Hertzberg et al., "Integrating generic sensor fusion algorithms with sound state representations through
    encapsulation of manifolds", Information Fusion 14(1), 2013.
    """

    def retract(self, orientation: FloatArray, delta: FloatArray) -> FloatArray:
        """Corrected orientation; (..., 4), (..., 3) rad -> (..., 4)."""

    def local(self, orientation: FloatArray, other: FloatArray) -> FloatArray:
        """The correction that takes `orientation` to `other`; (..., 4), (..., 4) -> (..., 3)."""

    def transport(self, delta: FloatArray) -> FloatArray:
        """d local(retract(q, delta), retract(q, delta + e)) / d e at e = 0; (..., 3) -> (..., 3, 3)."""


class AdditiveQuaternion:
    """The paper's: dq is added to the quaternion, which is then normalised.

    An additive correction of a unit quaternion is tangent to it, dq = q x (delta / 2, 0), because the
    normalisation Jacobian leaves no variance along q. So the three numbers delta say all there is to say, and
    the 13-number camera state with a singular P becomes a 12-number one with a regular P and the same estimates:
    normalise(q + dq) is `retract`, the normalisation Jacobian I - q q^T (over the norm) is `transport`.
    """

    def retract(self, orientation: FloatArray, delta: FloatArray) -> FloatArray:
        """q x (delta / 2, 1), normalised."""
        return rotations.multiply(orientation, np.concatenate([0.5 * delta, np.ones((*delta.shape[:-1], 1))], axis=-1))

    def local(self, orientation: FloatArray, other: FloatArray) -> FloatArray:
        """Twice the vector part over the scalar part."""
        dq = rotations.between(orientation, other)
        correction: FloatArray = 2.0 * dq[..., :3] / dq[..., 3:]
        return correction

    def transport(self, delta: FloatArray) -> FloatArray:
        """(I - [delta]x / 2) / (1 + |delta|^2 / 4)."""
        if delta.ndim == 1:
            return np.array(additive_transport_of(*delta.tolist())).reshape(3, 3)
        half = 0.5 * delta
        square = np.einsum("...i,...i->...", half, half)[..., None, None]
        jacobian: FloatArray = (_EYE - rotations.skew(half)) / (1.0 + square)
        return jacobian


def additive_transport_of(x: float, y: float, z: float) -> rotations.Nine:
    """`AdditiveQuaternion.transport`, row by row."""
    a, b, c = 0.5 * x, 0.5 * y, 0.5 * z
    diagonal = 1.0 / (1.0 + a * a + b * b + c * c)
    a, b, c = a * diagonal, b * diagonal, c * diagonal
    return diagonal, c, -b, -c, diagonal, a, b, -a, diagonal


class RotationVector:
    """SO(3) error state: q x q(delta)."""

    def retract(self, orientation: FloatArray, delta: FloatArray) -> FloatArray:
        """q x q(delta)."""
        return rotations.multiply(orientation, rotations.exp_quaternion(delta))

    def local(self, orientation: FloatArray, other: FloatArray) -> FloatArray:
        """Log(R^T R_other)."""
        return rotations.log(rotations.matrix(orientation).swapaxes(-1, -2) @ rotations.matrix(other))

    def transport(self, delta: FloatArray) -> FloatArray:
        """The right Jacobian of SO(3)."""
        return rotations.right_jacobian(delta)


RETRACTIONS: Mapping[str, Retraction] = {"quaternion": AdditiveQuaternion(), "so3": RotationVector()}
