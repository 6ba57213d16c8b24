"""Frames of many filters in plain arrays, and the places of variables in the arrays of the engine.

Measurements and odometry go in, outcomes come out. The value of a variable has as many numbers as its error, but for
orientations and the like: that of the pose stands in front, with one number more than rows; others of that kind stand
at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from filters.contract.outputs import VELOCITY
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.joint_state import StateLayout
from filters.motions.motion_model import CameraState, StepInput


@dataclass(frozen=True, eq=False)
class Observations:
    """Measurements of B filters, one after the other."""

    seen: BoolArray
    """(B,): whether a filter has an observation: one without measurements is something else than none."""
    offsets: IntArray
    """(B + 1,): the measurements of filter b are offsets[b] to offsets[b + 1] - 1."""
    ids: IntArray
    """(M,): ascending for each filter."""
    uvd: FloatArray
    """(M, 3): measurements, px."""
    R: FloatArray
    """(M, 3, 3): their noise, or one for all, px^2."""
    with_right: BoolArray
    """(B,): whether the right row is measured on its own."""
    v_right: FloatArray | None = None
    """(M,): the right row, px."""


@dataclass(frozen=True, eq=False)
class Odometry:
    """Odometry or inertial samples of a step of B filters."""

    fused: BoolArray
    """(B,): which filters have some."""
    counts: IntArray
    """(B,): rows of each."""
    rows: FloatArray
    """(B, K, w): `BodyVelocity.rows` or `InertialSamples.rows`, and zeros behind them."""

    @classmethod
    def of_velocities(cls, fused: BoolArray, values: FloatArray, covariances: FloatArray) -> Odometry:
        """Linear and angular velocities in the camera frame, (B, 6), and covariances, (B, 6, 6) or one for all."""
        rows = np.concatenate([values[:, None], np.broadcast_to(covariances, (len(values), 6, 6))], axis=1)
        return cls(fused, np.where(fused, 7, 0), rows)

    @classmethod
    def of(cls, given: Sequence[StepInput | None]) -> Odometry:
        """Odometry of each filter; None: it has none."""
        rows = [np.zeros((0, 6)) if entry is None else entry.rows for entry in given]
        counts = np.array([len(one) for one in rows])
        every = np.zeros((len(rows), max(1, *counts.tolist()), max(one.shape[1] for one in rows)))
        for b, one in enumerate(rows):
            every[b, : len(one), : one.shape[1]] = one
        return cls(counts > 0, counts, every)


@dataclass(frozen=True, eq=False)
class FrameOutcome:
    """Report of what became of the measurements."""

    fates: IntArray
    """(M,): `frame.USED`, BEHIND, GATED, FAILED, STARTED or REJECTED."""
    nis: FloatArray
    """(B,): normalised innovation squared."""
    dof: IntArray
    """(B,): its degrees of freedom."""
    dropped: tuple[IntArray, ...]
    """Ids that left the map of each filter."""


class ValuePlaces:
    """Place of each variable in x (values,).

    Attributes
    ----------
    size : int
        Numbers in all.
    """

    def __init__(self, layout: StateLayout) -> None:
        self.size = layout.size + 1
        self._velocity = layout.places[VELOCITY].start + 1
        self._places: dict[str, slice] = {}
        for variable in layout.variables:
            first, count = layout.places[variable.name].start + 1, len(variable.value)
            if count != variable.size:
                first, self.size = self.size, self.size + count
            self._places[variable.name] = slice(first, first + count)

    def of_camera(self, names: tuple[str, ...]) -> tuple[int, ...]:
        """Places of position, orientation, velocities and these variables."""
        v = self._velocity
        return (*range(7), *range(v, v + 6), *self.of_variables(names))

    def of_variables(self, names: tuple[str, ...]) -> tuple[int, ...]:
        """Places of the values of these variables."""
        return tuple(place for name in names for place in range(self._places[name].start, self._places[name].stop))

    def camera(self, x: FloatArray) -> CameraState:
        """The variables that x holds; views of it."""
        v = self._velocity
        values_by_name = {name: x[place] for name, place in self._places.items()}
        return CameraState(x[:3], x[3:7], x[v : v + 3], x[v + 3 : v + 6], values_by_name)

    def of(self, camera: CameraState) -> FloatArray:
        """x of the variables; what is padding is zero."""
        x, v = np.zeros(self.size), self._velocity
        x[:3], x[3:7] = camera.position, camera.orientation
        x[v : v + 3], x[v + 3 : v + 6] = camera.linear_velocity, camera.angular_velocity
        for name, place in self._places.items():
            x[place] = camera.variables[name]
        return x
