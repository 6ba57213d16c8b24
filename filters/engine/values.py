"""Places of the values of the named variables in the arrays of the engine.

The value of a variable has as many numbers as its error, but for orientations and the like: that of the pose stands in
front, with one number more than rows; others of that kind stand at the end.
"""

from __future__ import annotations

import numpy as np

from filters.contract.variables import VELOCITY
from filters.geometry.arrays import FloatArray
from filters.motions.model import CameraState
from filters.state.layout import StateLayout


class ValuePlaces:
    """Where in x (values,) each variable is.

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
        others = {name: x[place] for name, place in self._places.items()}
        return CameraState(x[:3], x[3:7], x[v : v + 3], x[v + 3 : v + 6], others)

    def of(self, camera: CameraState) -> FloatArray:
        """x of the variables; what is padding is zero."""
        x, v = np.zeros(self.size), self._velocity
        x[:3], x[3:7] = camera.position, camera.orientation
        x[v : v + 3], x[v + 3 : v + 6] = camera.linear_velocity, camera.angular_velocity
        for name, place in self._places.items():
            x[place] = camera.variables[name]
        return x
