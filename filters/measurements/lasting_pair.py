"""The rectified pair of landmarks whose measurements err by numbers of their own: (u, v, d) plus these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from filters.geometry.machine_code import compiled
from filters.measurements.model import MeasurementKernels, SensorJacobians, Values
from filters.measurements.rectified_pair import KERNELS, RectifiedPair

_exact, _exact_back = compiled(KERNELS.predict), compiled(KERNELS.backproject)


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
    _exact(settings, camera, points[:, :4], values, numbers, J[:, :, :4], J_values, in_front)
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
    _exact_back(settings, camera, uvd, values, points[:, :4], J[:, :4], J_values)


@dataclass(frozen=True)
class PairWithLastingErrors(RectifiedPair):
    """One joint update with (u, v, d) of Eq. 10, plus the errors of the landmark that last (`LastingErrors`), px."""

    seen_size: ClassVar[int] = 7
    kernels: ClassVar[MeasurementKernels | None] = MeasurementKernels(_predict, _backproject)

    def predict(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> FloatArray:
        """(u, v, d) with the errors."""
        uvd: FloatArray = super().predict(camera, points_c[..., :4], values) + points_c[..., 4:]
        return uvd

    def jacobians(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> SensorJacobians:
        """Of Eq. 10, and the identity."""
        exact = super().jacobians(camera, points_c[..., :4], values).by_point
        own = np.broadcast_to(np.eye(3), (*exact.shape[:-1], 3))
        return SensorJacobians(np.concatenate([exact, own], axis=-1), {})

    def backproject(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> FloatArray:
        """The point as if there were no errors."""
        return np.hstack([super().backproject(camera, uvd, values), np.zeros((len(uvd), 3))])

    def backprojection_jacobians(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> SensorJacobians:
        """The errors are no matter of one measurement."""
        exact = super().backprojection_jacobians(camera, uvd, values).by_point
        return SensorJacobians(np.concatenate([exact, np.zeros((len(uvd), 3, 3))], axis=1), {})
