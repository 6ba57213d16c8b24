"""Layout of the error state, measurements that are linear in it, and the transport of its covariance.

The pose comes first, then the variables of the measurement model, so that what a measurement depends on besides its
landmark is one block of leading rows; then velocity and the variables of the motion model; then the map. The transport
is the Jacobian that takes errors at a state to errors at the corrected one.

Derivation: docs/derivations/errors.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np

from filters.contract.inputs import Start
from filters.contract.variables import POSE, VELOCITY, Variable
from filters.geometry import symmetric
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.retractions import Retraction
from filters.motions.motion_model import CAMERA_SIZE, POSE_SIZE, POSITION, ROTATION, VELOCITY_SIZE, CameraState


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

    def moved(self, camera: CameraState, delta: FloatArray, orientation: Retraction) -> CameraState:
        """All variables corrected by the leading numbers of delta (n,)."""
        others = {
            x.name: x.retraction.retract(camera.variables[x.name], delta[self.places[x.name]]) for x in self.variables
        }
        return CameraState(
            camera.position + delta[POSITION],
            orientation.retract(camera.orientation, delta[ROTATION]),
            camera.linear_velocity + delta[self.linear_velocity],
            camera.angular_velocity + delta[self.angular_velocity],
            others,
        )

    def transport(self, delta: FloatArray, orientation: Retraction) -> FloatArray:
        """Jacobian that takes errors of the variables to those at the values corrected by delta; (size, size)."""
        M = np.eye(self.size)
        M[ROTATION, ROTATION] = orientation.transport(delta[ROTATION])
        for variable in self.variables:
            place = self.places[variable.name]
            M[place, place] = variable.retraction.transport(delta[place])
        return M


@dataclass(frozen=True, eq=False)
class LinearisedMeasurements:
    """M measurements of k rows each, linear in the error state."""

    innovation: FloatArray
    """(M, k): measured minus predicted, px."""
    by_leading: FloatArray
    """(M, k, c): H with respect to the first c rows of the state: pose and what else measurements depend on."""
    by_map: FloatArray
    """(M, k, w): H with respect to the landmark's own rows."""
    map_rows: IntArray
    """(M, w): those rows."""
    R: FloatArray
    """(M, k, k): noise covariance."""

    def __len__(self) -> int:
        return len(self.innovation)

    def __getitem__(self, index: slice | IntArray | BoolArray) -> LinearisedMeasurements:
        return LinearisedMeasurements(
            self.innovation[index],
            self.by_leading[index],
            self.by_map[index],
            self.map_rows[index],
            self.R[index],
        )

    def times(self, delta: FloatArray) -> FloatArray:
        """H delta; (n,) -> (M, k)."""
        product: FloatArray = self.by_leading @ delta[: self.by_leading.shape[2]]
        product += np.einsum("mkw,mw->mk", self.by_map, delta[self.map_rows])
        return product

    def innovation_covariances(self, P: FloatArray) -> FloatArray:
        """S = H P H^T + R of each measurement on its own (Eq. 15); (M, k, k)."""
        leading_rows = np.broadcast_to(np.arange(self.by_leading.shape[2]), (len(self), self.by_leading.shape[2]))
        rows = np.concatenate([leading_rows, self.map_rows], axis=1)
        H = np.concatenate([self.by_leading, self.by_map], axis=2)
        S: FloatArray = H @ symmetric.blocks(P, rows) @ H.transpose(0, 2, 1) + self.R
        return S


@dataclass(frozen=True, eq=False)
class Transport:
    """Block lower triangular Jacobian of the error state."""

    leading: FloatArray
    """(c, c), of the named variables."""
    by_rotation: FloatArray | None = None
    """(n - c, 3), of the map rows by the rotation error of the camera. None: zero."""
    rows: IntArray | None = None
    """(m, s): rows of the blocks that have a Jacobian of their own. None: there are none."""
    own: FloatArray | None = None
    """(m, s, s), of those blocks by themselves; that of all other rows is the identity."""

    def pulled_back(self, measurements: LinearisedMeasurements, delta: FloatArray) -> LinearisedMeasurements:
        """The same measurements, linear in the errors of an earlier state that `delta` has moved here.

        The innovation gets back what the correction has already explained: a Gauss-Newton step with the prior held.
        """
        size, width = len(self.leading), measurements.by_leading.shape[2]
        by_leading = measurements.by_leading @ self.leading[:width, :width]
        by_map = measurements.by_map
        if self.by_rotation is not None:
            by_leading[:, :, ROTATION] += by_map @ self.by_rotation[measurements.map_rows - size]
        if self.own is not None and self.rows is not None:
            block, count = self.rows.shape[1], by_map.shape[2]
            place = np.full((len(delta) - size) // block, -1)
            place[(self.rows[:, 0] - size) // block] = np.arange(len(self.rows))
            parts = []
            for start in (*range(0, count - block, 3), count - block):  # of anchors, and its own
                columns = slice(start, start + 3 if start < count - block else count)
                width = columns.stop - start
                which = place[(measurements.map_rows[:, start] - size) // block]
                J = np.where((which < 0)[:, None, None], np.eye(block), self.own[which])[:, :width, :width]
                parts.append(by_map[:, :, columns] @ J)
            by_map = np.concatenate(parts, axis=2)
        earlier = replace(measurements, by_leading=by_leading, by_map=by_map)
        return replace(earlier, innovation=measurements.innovation + earlier.times(delta))
