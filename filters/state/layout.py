"""Layout of the error state, measurements that are linear in it, and the transport of its covariance.

The pose comes first, then the variables of the measurement model, so that what a measurement depends on besides its
landmark is one block of leading rows; then velocity and the variables of the motion model; then the map. The transport
is the Jacobian that takes errors at a state to errors at the corrected one.

Derivation: docs/derivations/errors.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np

from filters.contract.inputs import Start
from filters.contract.variables import POSE, VELOCITY, Variable
from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.motion_model import CAMERA_SIZE, POSE_SIZE, VELOCITY_SIZE, CameraState


@dataclass(frozen=True, eq=False)
class StateLayout:
    """Places of the variables."""

    variables: tuple[Variable, ...] = ()
    """Those besides pose and velocity: of the measurement model, then of the motion model."""
    measured: int = POSE_SIZE
    """Leading rows that a measurement depends on."""
    sees_velocity: bool = False
    """Whether the velocity, which stands behind the variables of the measurement model, is among them."""

    @classmethod
    def of(
        cls, measurement: tuple[Variable, ...], motion: tuple[Variable, ...], sees_velocity: bool = False
    ) -> StateLayout:
        """Places of the variables of both models; one that both name is one variable.

        Raises
        ------
        ValueError
            A name stands for two variables.
        """
        names = [variable.name for variable in measurement]
        others = []
        for variable in motion:
            if variable.name not in names:
                others.append(variable)
            elif not any(variable is known for known in measurement):
                raise ValueError(
                    f"variable {variable.name!r} is asked for by measurement and motion with different starts: "
                    "give both the same Variable, or two names"
                )
        for given in (measurement, motion):
            given_names = [variable.name for variable in given]
            if len(set(given_names)) < len(given_names):
                raise ValueError(f"variables must have different names, got {', '.join(given_names)}")
        rows = POSE_SIZE + sum(variable.size for variable in measurement)
        return cls((*measurement, *others), rows + VELOCITY_SIZE * sees_velocity, sees_velocity)

    @cached_property
    def places(self) -> Mapping[str, slice]:
        """Rows of each variable by name."""
        sizes = [(POSE, POSE_SIZE), *((variable.name, variable.size) for variable in self.variables)]
        stops = list(accumulate(size for _, size in sizes))
        first = self.measured - VELOCITY_SIZE * self.sees_velocity
        sizes.insert(stops.index(first) + 1, (VELOCITY, VELOCITY_SIZE))
        places, row = {}, 0
        for name, size in sizes:
            places[name], row = slice(row, row + size), row + size
        return places

    @cached_property
    def errors(self) -> int:
        """Error numbers of all variables."""
        return CAMERA_SIZE + sum(variable.size for variable in self.variables)

    @cached_property
    def size(self) -> int:
        """Rows before those of the map, a multiple of three: the last ones may be zero."""
        return -(-self.errors // 3) * 3

    @cached_property
    def rows(self) -> IntArray:
        """All of them."""
        return np.arange(self.size)

    @cached_property
    def linear_velocity(self) -> slice:
        """Rows of the linear velocity."""
        first = self.places[VELOCITY].start
        return slice(first, first + 3)

    @cached_property
    def angular_velocity(self) -> slice:
        """Rows of the angular velocity."""
        first = self.places[VELOCITY].start + 3
        return slice(first, first + 3)

    @cached_property
    def considered(self) -> IntArray:
        """Rows of considered variables."""
        rows = [np.arange(self.size)[self.places[x.name]] for x in self.variables if x.considered]
        return np.concatenate([np.zeros(0, dtype=np.int64), *rows])

    @cached_property
    def walk_rates(self) -> FloatArray | None:
        """Variance that the random walks add each second, (size,); None: none walks."""
        if all(variable.random_walk is None for variable in self.variables):
            return None
        rates = np.zeros(self.size)
        for variable in self.variables:
            if variable.random_walk is not None:
                rates[self.places[variable.name]] = variable.random_walk**2
        return rates

    def rows_of(self, names: tuple[str, ...]) -> IntArray:
        """Rows of the variables, in the order of their names."""
        return np.concatenate([np.arange(self.size)[self.places[name]] for name in names])

    def start(self, start: Start) -> tuple[CameraState, FloatArray]:
        """Values and covariance at the start."""
        P = np.zeros((self.size, self.size), order="F")
        camera = self.rows_of((POSE, VELOCITY))
        P[np.ix_(camera, camera)] = start.assumed_covariance
        for variable in self.variables:
            place = self.places[variable.name]
            P[place, place] = variable.covariance
        return CameraState.at(start, {variable.name: variable.value for variable in self.variables}), P
