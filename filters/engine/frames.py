"""Frames of many filters in plain arrays: measurements and odometry going in, outcomes coming out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from filters.contract.odometry import BodyVelocity
from filters.motions.model import StepInput
from filters.validation import BoolArray, FloatArray, IntArray, unchecked


@dataclass(frozen=True, eq=False)
class Observations:
    """Measurements of B filters, one after the other.

    Attributes
    ----------
    seen : (B,) bool
        Whether a filter has an observation: one without measurements is something else than none.
    offsets : (B + 1,) int64
        The measurements of filter b are offsets[b] to offsets[b + 1] - 1.
    ids : (M,) int64
        Ascending for each filter.
    uvd : (M, 3)
        Measurements, px.
    R : (M, 3, 3) or (3, 3)
        Their noise, or one for all, px^2.
    with_right : (B,) bool
        Whether the right row is measured on its own.
    v_right : (M,), optional
        The right row, px.
    """

    seen: BoolArray
    offsets: IntArray
    ids: IntArray
    uvd: FloatArray
    R: FloatArray
    with_right: BoolArray
    v_right: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Odometry:
    """Odometry of B filters.

    Attributes
    ----------
    fused : (B,) bool
        Whose there is.
    values : (B, 6)
        Linear and angular velocity, camera frame; of inertial samples none.
    covariances : (B, 6, 6) or (6, 6)
        Of those.
    given : sequence of BodyVelocity, InertialSamples or None, optional
        As it was given, for motions that know more of it.
    """

    fused: BoolArray
    values: FloatArray
    covariances: FloatArray
    given: Sequence[StepInput | None] | None = None

    @classmethod
    def of(cls, given: Sequence[StepInput | None]) -> Odometry:
        """Odometry of each filter; None: it has none."""
        values, covariances = np.zeros((len(given), 6)), np.zeros((len(given), 6, 6))
        for b, entry in enumerate(given):
            if isinstance(entry, BodyVelocity):
                values[b, :3], values[b, 3:], covariances[b] = entry.linear, entry.angular, entry.covariance
        return cls(np.array([entry is not None for entry in given]), values, covariances, given)

    def of_filter(self, b: int) -> StepInput | None:
        """That of filter b."""
        if self.given is not None:
            return self.given[b]
        if not self.fused[b]:
            return None
        covariance = np.broadcast_to(self.covariances, (len(self.fused), 6, 6))[b].copy()
        linear, angular = self.values[b, :3].copy(), self.values[b, 3:].copy()
        return unchecked(BodyVelocity, linear=linear, angular=angular, covariance=covariance)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of the measurements.

    Attributes
    ----------
    fates : (M,) uint8
        `frame.USED`, BEHIND, GATED, FAILED, STARTED or REJECTED.
    nis, dof : (B,)
        Normalised innovation squared and its degrees of freedom.
    dropped : tuple of (K,) int64
        Ids that left the map of each filter.
    """

    fates: IntArray
    nis: FloatArray
    dof: IntArray
    dropped: tuple[IntArray, ...]
