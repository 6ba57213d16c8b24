"""Parts of the errors of an odometry: those that last, which two poses have in common, and those of each pose alone.

A file of covariances says of each pose how uncertain it is, not what it shares with the others, so of a motion between
two poses it says nothing. What an odometry claims has three parts, in the coordinates of its world, in which an error
needs no transport: increments, of which the later pose has all that the earlier one has; a part that is drawn once a
drive; and a part that each pose has alone. With the last two the covariance of every motion follows;
`docs/derivations/drift.md` derives it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION

Six = tuple[float, ...]
"""A number for each axis of the body: x, y, z of the position, x, y, z of the rotation."""


@dataclass(frozen=True)
class DriftParts:
    """Two parts of the drift of an odometry, by six numbers each, as a header keeps them."""

    white: Six
    """Variances of what each pose has alone, in its body: m^2, rad^2."""
    lasting: Six
    """Variances of the drift per metre that lasts all the drive, in the body: 1, (rad/m)^2."""


@dataclass(frozen=True, eq=False)
class Drift:
    """What the error of each of K poses has alone, and what of it lasts, in the definition of their covariances."""

    own: FloatArray
    """(K, 6, 6): covariance of what a pose has alone."""
    lasting: FloatArray
    """(K, 6, m): what lasts is this times one standard normal vector (m,), drawn once a drive."""
    parts: DriftParts | None
    """The numbers that they follow from, along the poses as they are; None where those have been moved since."""

    def rows(self, index: BoolArray | IntArray | slice) -> Drift:
        """That of some poses."""
        return Drift(self.own[index], self.lasting[index], self.parts)

    def through(self, J: FloatArray) -> Drift:
        """That of the errors J e, with J (6, 6) or (K, 6, 6)."""
        return Drift(J @ self.own @ J.swapaxes(-1, -2), J @ self.lasting, None)


def adjoints(positions: FloatArray, orientations: FloatArray) -> FloatArray:
    """Adjoints (K, 6, 6) of poses T_wb: from errors Log(T^^-1 T) in the body to errors Log(T T^^-1) in W.

    Source: Sola, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, eq. 175.
    """
    R = rotations.matrix(orientations)
    A = np.zeros((len(R), POSE_SIZE, POSE_SIZE))
    A[:, POSITION, POSITION] = A[:, ROTATION, ROTATION] = R
    A[:, POSITION, ROTATION] = rotations.skew(positions) @ R
    return A


def distances(positions: FloatArray) -> FloatArray:
    """Length of each step (K,), m; 0 of the first."""
    return np.concatenate([[0.0], np.linalg.norm(np.diff(positions, axis=0), axis=1)])


def drift_of(positions: FloatArray, orientations: FloatArray, parts: DriftParts) -> Drift:
    """The drift along poses (K,), for the error Log(T^^-1 T) in the body of motions from the first pose.

    The error of the first pose itself lasts: all motions from there have it.
    """
    A = adjoints(positions - positions[0], orientations)
    into_body = np.linalg.inv(A)
    driven = np.cumsum(distances(positions)[:, None, None] * A, axis=0)
    own = np.tile(np.diag(parts.white), (len(A), 1, 1))
    own[0] = 0.0
    of_start = np.broadcast_to(A[0] * np.sqrt(parts.white), A.shape).copy()
    of_start[0] = 0.0
    lasting = np.concatenate([driven * np.sqrt(parts.lasting), of_start], axis=2)
    return Drift(own, into_body @ lasting, parts)
