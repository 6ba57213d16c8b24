"""Base class of measurement models: what the sensor measures of a point, and how a frame is used.

A part gives the numbers that the sensor measures of a point in the camera frame, and the inverse: two functions of
tuples of numbers. Points are homogeneous, so that one at infinity or beyond is nothing special. What a filter needs is
made of them, in machine code and for columns of points; Jacobians are those of dual numbers.

Derivation: docs/derivations/measurements.md.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from filters.contract.inputs import StereoObservation
from filters.contract.outputs import VELOCITY, Variable
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from filters.geometry.derivatives import columns_of, jacobian_of

Values = Mapping[str, FloatArray]
"""Values of named variables."""
Rig: Any = namedtuple("Rig", ["fx", "fy", "cx", "cy", "baseline"])
"""Camera as the plain functions take it."""
Numbers = Any
"""Tuple of numbers: floats in machine code, columns or dual numbers."""


@dataclass(frozen=True, eq=False)
class Stage:
    """One update of the frame: all landmarks, k rows each."""

    z: FloatArray
    """(M, k): measurements."""
    T: FloatArray
    """(k, s): z = T times the s numbers of the sensor."""
    R: FloatArray
    """(M, k, k): covariance of z."""


@dataclass(frozen=True, eq=False)
class SensorJacobians:
    """Jacobians of the s numbers of the sensor by homogeneous points, (M, s, 4), and by each variable, (M, s, size)."""

    by_point: FloatArray
    by_variable: Mapping[str, FloatArray]


@dataclass(frozen=True)
class StageRows:
    """Numbers of the sensor that a stage uses: z = T times them."""

    T: tuple[tuple[float, ...], ...]
    """One for each row."""
    right_row: int = -1
    """Row that takes the separately measured v_right; -1: none. A fourth number of the sensor has the variance of v."""
    apart_row: int = -1
    """Row whose error is independent of those of the other rows; -1: none."""
    apart_scale: float = 1.0
    """Factor of the variance of that row."""

    def of_uvd(self) -> FloatArray:
        """T by (u, v, d) alone, v standing for v_right; (k, 3)."""
        T = np.array(self.T)
        T[:, 1] += T[:, 3:].sum(axis=1)
        return T[:, :3]

    def of(self, observation: StereoObservation, R: FloatArray) -> Stage:
        """The stage of M measurements with noise R (M, 3, 3) of (u, v, d)."""
        by_uvd = self.of_uvd()
        z, noise = observation.uvd @ by_uvd.T, by_uvd @ R @ by_uvd.T
        if self.right_row >= 0:
            z[:, self.right_row] = observation.v_right
        if self.apart_row >= 0:
            apart_variance = noise[:, self.apart_row, self.apart_row] * self.apart_scale
            noise[:, self.apart_row] = noise[:, :, self.apart_row] = 0.0
            noise[:, self.apart_row, self.apart_row] = apart_variance
        return Stage(z, np.array(self.T), noise)


class MeasurementModel:
    """A function of points in the camera frame and of the variables that it names, vectorised over points.

    The numbers of the sensor are those of a `StereoObservation`: the three of `uvd`, and `v_right` as a fourth where
    the model has it. Of a rectified pair they are (u, v, d); another sensor may give the columns its own meaning.

    References
    ----------
    Chen, Lin and Shih, "Using range and bearing observation in stereo-based EKF SLAM", Eq. 7 to 10, section 4.
    F. Dellaert, "Factor graphs and GTSAM", 2012 (its `CustomFactor`).
    """

    seen_size: ClassVar[int] = 4
    """Numbers by which it sees a landmark, those of the landmark's `seen_size`: of a point, direction and scale."""
    size: ClassVar[int] = 3
    """Numbers of the sensor, s: 3, or 4 with `v_right`."""
    variables: tuple[Variable, ...] = ()
    """Variables of the state that it needs."""
    sees_velocity: ClassVar[bool] = False
    """Whether it depends on the velocity, as with rows read in turn or an unknown delay: then there is a value
    "velocity", linear (m/s) and angular (rad/s), both in the camera frame, behind those of the variables."""
    in_machine_code: bool = True
    """Whether the plain functions are compiled; else they run in Python, on columns."""

    # --- what a part gives: plain functions of tuples of numbers ---

    def project(self, camera: Any, h: Numbers, values: Any = None) -> Numbers:
        """Numbers of the sensor at a homogeneous point (x, y, z, scale) in the camera frame.

        `camera` has fx, fy, cx, cy and baseline. A sensor with variables is given their values by name, each a tuple;
        that of the velocity is `velocity`.
        """
        raise NotImplementedError(f"{type(self).__name__} must have project and unproject: see MeasurementModel")

    def unproject(self, camera: Any, uvd: Numbers, values: Any = None) -> Numbers:
        """Homogeneous point in the camera frame at a measurement, the three columns of `uvd`."""
        raise NotImplementedError(f"{type(self).__name__} must have project and unproject: see MeasurementModel")

    # --- what it may give instead of the default ---

    def can_see(self, h: Numbers) -> Any:
        """Whether the sensor can see a homogeneous point at all: one ahead."""
        return h[2] > 0.0

    # --- the same for columns: many points at once, as the NumPy of the engine takes them ---

    def predict(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> FloatArray:
        """Numbers of the sensor; points (..., seen_size), the point is direction / scale -> (..., s)."""
        record = self.named(values)
        numbers = columns_of(lambda h: self.project(camera, h, *record), points_c.reshape(-1, points_c.shape[-1]))
        return numbers.reshape(*points_c.shape[:-1], self.size)

    def backproject(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> FloatArray:
        """Homogeneous points (M, seen_size) in the camera frame at the measurements (M, 3)."""
        record = self.named(values)
        return columns_of(lambda z: self.unproject(camera, z, *record), uvd)

    @property
    def value_names(self) -> tuple[str, ...]:
        """Names of the values that the plain functions take, in their order."""
        return (*(variable.name for variable in self.variables), *((VELOCITY,) if self.sees_velocity else ()))

    def named(self, values: Mapping[str, Any]) -> tuple[Any, ...]:
        """Values as the plain functions take them: one record of tuples, or nothing."""
        names = self.value_names
        if not names:
            return ()
        record = namedtuple("Values", [name.replace("-", "_") for name in names])  # type: ignore[misc]
        return (record(*(tuple(values[name]) for name in names)),)

    def rows(self, with_right: bool) -> tuple[StageRows, ...]:
        """Rows of the sensor's numbers that the stages use where `v_right` is not measured, and where it is.

        The default is one stage with all numbers; the error of `v_right` is independent of the others and has the
        variance of v. Where it is missing, the other three are used.
        """
        every = tuple(tuple(row) for row in np.eye(self.size).tolist())
        if self.size == 3 or not with_right:
            return (StageRows(every[:3]),)
        return (StageRows(every, right_row=3, apart_row=3),)

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """Updates to be made one after the other, each linearised at the state the previous one left.

        Parameters
        ----------
        observation : StereoObservation
            M measurements.
        R : (M, 3, 3)
            Covariance of `uvd`.
        """
        return tuple(rows.of(observation, R) for rows in self.rows(observation.v_right is not None))

    def completed(self, observation: StereoObservation, camera: StereoCamera) -> StereoObservation:
        """The observation with all that the model needs of it.

        Raises
        ------
        ValueError
            It has no disparities, as of one camera, and the model needs them.
        """
        if observation.has_disparity:
            return observation
        name = type(self).__name__
        raise ValueError(
            f"observation has no disparity, which measurement={name}() needs: take measurement='left' with inertial "
            "samples, as make_filter('inertial', measurement='left', ...)"
        )

    def in_front(self, points_c: FloatArray) -> BoolArray:
        """Mask of homogeneous points (M, seen_size) that the sensor can see at all."""
        return columns_of(lambda h: (self.can_see(h),), points_c)[:, 0].astype(np.bool_)

    def jacobians(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> SensorJacobians:
        """Jacobians of `predict`, by the numbers of the variables."""
        return self._jacobians(self.project, camera, points_c, values)

    def backprojection_jacobians(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> SensorJacobians:
        """Jacobians of `backproject`, by the measurement (M, 4, 3) as `by_point`, and by the variables' numbers."""
        return self._jacobians(self.unproject, camera, uvd, values)

    def _jacobians(
        self, function: Callable[..., Any], camera: StereoCamera, arguments: FloatArray, values: Values
    ) -> SensorJacobians:
        """Jacobians of `project` or `unproject` for many points or measurements."""
        record = self.named(values)
        by_point = jacobian_of(lambda h: function(camera, h, *record), arguments)[1]
        by_variable = {}
        for name in self.value_names:

            def called(x: Numbers, h: Numbers, name: str = name) -> Numbers:
                return function(camera, h, record[0]._replace(**{name.replace("-", "_"): x}))

            by_variable[name] = jacobian_of(called, values[name][None], arguments)[1]
        return SensorJacobians(by_point, by_variable)
