"""Base class of measurement models: what the sensor measures of a point, and how a frame is used.

A part gives the numbers that the sensor measures of points in the camera frame, and the inverse. The points are
homogeneous, so that one at infinity or beyond is nothing special. Jacobians are numerical by default.

Derivation: docs/derivations/measurements.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.observation import StereoObservation
from filters.contract.variables import Variable
from filters.geometry import differences
from filters.geometry.camera import StereoCamera
from filters.validation import BoolArray, FloatArray

Values = Mapping[str, FloatArray]
"""Values of named variables."""


@dataclass(frozen=True, eq=False)
class Stage:
    """One update of the frame: all landmarks, k rows each.

    Attributes
    ----------
    z : (M, k)
        Measurements.
    T : (k, s)
        z = T times the s numbers of the sensor.
    R : (M, k, k)
        Covariance of z.
    """

    z: FloatArray
    T: FloatArray
    R: FloatArray


@dataclass(frozen=True, eq=False)
class SensorJacobians:
    """Jacobians of the s numbers of the sensor by homogeneous points, (M, s, 4), and by each variable, (M, s, size)."""

    by_point: FloatArray
    by_variable: Mapping[str, FloatArray]


class MeasurementModel:
    """A function of points in the camera frame and of the variables that it names, vectorised over points.

    The numbers of the sensor are those of a `StereoObservation`: the three of `uvd`, and `v_right` as a fourth where
    the model has it. Of a rectified pair they are (u, v, d); another sensor may give the columns its own meaning.

    Attributes
    ----------
    size : int
        Numbers of the sensor, s: 3, or 4 with `v_right`.
    variables : tuple of Variable
        Variables of the state that it needs.
    kernel : str or None
        Compiled counterpart. It holds for the class that states it, not for its subclasses.

    References
    ----------
    Chen, Lin and Shih, "Using range and bearing observation in stereo-based EKF SLAM", Eq. 7 to 10, section 4.
    F. Dellaert, "Factor graphs and GTSAM", 2012 (its `CustomFactor`).
    """

    size: ClassVar[int] = 3
    variables: tuple[Variable, ...] = ()
    kernel: ClassVar[str | None] = None

    # --- what a part gives ---

    def predict(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> FloatArray:
        """Numbers of the sensor; points (..., 4), direction and scale, the point is direction / scale -> (..., s)."""
        raise NotImplementedError(f"{type(self).__name__} must have predict: see MeasurementModel")

    def backproject(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> FloatArray:
        """Homogeneous points (M, 4) in the camera frame at the measurements (M, 3)."""
        raise NotImplementedError(f"{type(self).__name__} must have backproject: see MeasurementModel")

    # --- what it may give instead of the default ---

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """Updates to be made one after the other, each linearised at the state the previous one left.

        The default is one, with all numbers; the error of `v_right` is independent of the others and has the variance
        of v. Where it is missing, the other three are used.

        Parameters
        ----------
        observation : StereoObservation
            M measurements.
        R : (M, 3, 3)
            Covariance of `uvd`.
        """
        if self.size == 3 or observation.v_right is None:
            return (Stage(observation.uvd, np.eye(3, self.size), R),)
        joint = np.zeros((len(R), 4, 4))
        joint[:, :3, :3], joint[:, 3, 3] = R, R[:, 1, 1]
        return (Stage(np.column_stack([observation.uvd, observation.v_right]), np.eye(4), joint),)

    def in_front(self, points_c: FloatArray) -> BoolArray:
        """Which homogeneous points (M, 4) the sensor can see at all: those with a direction ahead."""
        forward: BoolArray = points_c[:, 2] > 0.0
        return forward

    def jacobians(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> SensorJacobians:
        """Jacobians of `predict`."""
        by_point = differences.jacobian(lambda e: self.predict(camera, points_c + e, values), 4)
        return SensorJacobians(by_point, self._by_variables(lambda x: self.predict(camera, points_c, x), values))

    def backprojection_jacobians(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> SensorJacobians:
        """Jacobians of `backproject`, (M, 4, 3) by the measurement as `by_point`, and by each variable."""
        by_measurement = differences.jacobian(lambda e: self.backproject(camera, uvd + e, values), 3)
        return SensorJacobians(by_measurement, self._by_variables(lambda x: self.backproject(camera, uvd, x), values))

    def _by_variables(self, function: Callable[[Values], FloatArray], values: Values) -> dict[str, FloatArray]:
        """Jacobians of a function of the values by each variable of the model."""
        return {variable.name: _jacobian_by(variable, function, values) for variable in self.variables}


def _jacobian_by(variable: Variable, function: Callable[[Values], FloatArray], values: Values) -> FloatArray:
    def moved(delta: FloatArray) -> FloatArray:
        value = variable.retraction.retract(values[variable.name], delta)
        return function({**values, variable.name: value})

    return differences.jacobian(moved, variable.size)
