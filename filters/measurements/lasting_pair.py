"""The calibrated pair of landmarks whose measurements err by numbers of their own: (u, v, d) plus these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from filters.measurements.calibrated_pair import ERRORS, CalibratedPair, backproject_with, predict_with
from filters.measurements.measurement_model import MeasurementKernels, SensorJacobians, Values


def _predict(
    settings: FloatArray,
    camera: FloatArray,
    points: FloatArray,
    values: FloatArray,
    numbers: FloatArray,
    J: FloatArray,
    J_values: FloatArray,
    in_front: BoolArray,
) -> None:
    errors, by_error = np.zeros(ERRORS), np.zeros((3, ERRORS))
    predict_with(settings, camera, points[:, :4], values, numbers, J[:, :, :4], J_values, in_front, errors, by_error)
    for i in range(len(points)):
        for a in range(3):
            numbers[i, a] += points[i, 4 + a]
            J[i, a, 4 + a] = 1.0


def _backproject(
    settings: FloatArray,
    camera: FloatArray,
    uvd: FloatArray,
    values: FloatArray,
    points: FloatArray,
    J: FloatArray,
    J_values: FloatArray,
) -> None:
    errors, by_error = np.zeros(ERRORS), np.zeros((4, ERRORS))
    backproject_with(settings, camera, uvd, values, points[:, :4], J[:, :4], J_values[:, :4], errors, by_error)


@dataclass(frozen=True)
class PairWithLastingErrors(CalibratedPair):
    """One joint update with (u, v, d) of a `CalibratedPair`, plus the errors of the landmark that last, px.

    Landmarks are `LastingErrors`; parameters are those of `CalibratedPair`, and without them the rig is exact (Eq. 10).
    """

    seen_size: ClassVar[int] = 7
    kernels: ClassVar[MeasurementKernels | None] = MeasurementKernels(_predict, _backproject, settings=("numbers",))

    def predict(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> FloatArray:
        """(u, v, d) with the errors."""
        uvd: FloatArray = super().predict(camera, points_c[..., :4], values) + points_c[..., 4:]
        return uvd

    def jacobians(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> SensorJacobians:
        """Of the calibrated pair, and the identity."""
        rig = super().jacobians(camera, points_c[..., :4], values)
        own = np.broadcast_to(np.eye(3), (*rig.by_point.shape[:-1], 3))
        return SensorJacobians(np.concatenate([rig.by_point, own], axis=-1), rig.by_variable)

    def backproject(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> FloatArray:
        """The point as if there were no errors of its own."""
        return np.hstack([super().backproject(camera, uvd, values), np.zeros((len(uvd), 3))])

    def backprojection_jacobians(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> SensorJacobians:
        """The errors of its own are no matter of one measurement."""
        rig = super().backprojection_jacobians(camera, uvd, values)
        return SensorJacobians(_with_none(rig.by_point), {name: _with_none(J) for name, J in rig.by_variable.items()})


def _with_none(J: FloatArray) -> FloatArray:
    """A Jacobian (M, 4, k) of the point, and zeros (M, 3, k) of the errors."""
    return np.concatenate([J, np.zeros((len(J), 3, J.shape[2]))], axis=1)
