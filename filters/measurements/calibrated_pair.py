"""The rectified pair with the errors of its calibration as a variable of the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.variables import Variable
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from filters.geometry.machine_code import compiled
from filters.geometry.rotations import matrix_of, quaternion_of, right_jacobian_of
from filters.geometry.three_by_three import times, transposed
from filters.measurements.model import MeasurementKernels, MeasurementModel, SensorJacobians, Values
from filters.validation import BoolArray, FloatArray, positive

_PRIORS = ("offset_sigma", "focal_sigma", "baseline_sigma", *("misalignment_sigma",) * 3)


@compiled
def _put_errors(numbers: FloatArray, J: FloatArray, six: FloatArray) -> None:
    """Of a Jacobian by all six errors (s, 6), the columns of those that are in the variable."""
    for j in range(len(numbers)):
        for k in range(len(J)):
            J[k, j] = six[k, int(numbers[j])]


@compiled
def _take_errors(numbers: FloatArray, values: FloatArray, errors: FloatArray) -> None:
    """All six errors; those that are not in the variable are zero."""
    for j in range(len(numbers)):
        errors[int(numbers[j])] = values[j]


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
    errors, six = np.zeros(6), np.zeros((3, 6))
    _take_errors(settings, values, errors)
    o, focal, baseline, x0, x1, x2 = errors[0], 1.0 + errors[1], 1.0 + errors[2], errors[3], errors[4], errors[5]
    q0, q1, q2, q3 = quaternion_of(x0, x1, x2)
    E, by_turn = matrix_of(q0, q1, q2, q3), right_jacobian_of(x0, x1, x2)  # of its transpose, the left one
    fx, fy, fb = focal * camera[0], focal * camera[1], focal * baseline * camera[0] * camera[4]
    for i in range(len(points)):
        e0, e1, e2 = times(E, points[i, 0], points[i, 1], points[i, 2])
        inverse, scale = 1.0 / e2, points[i, 3]
        spread = fx * e0 * inverse, fy * e1 * inverse, fb * scale * inverse
        in_front[i] = points[i, 2] > 0.0
        numbers[i, 0], numbers[i, 1], numbers[i, 2] = spread[0] + camera[2], spread[1] + camera[3], spread[2] + o
        J[i, 2, 3] = fb * inverse
        for k in range(3):
            f0, f1, f2 = fx * inverse if k == 0 else 0.0, fy * inverse if k == 1 else 0.0, -spread[k] * inverse
            J[i, k, 0], J[i, k, 1], J[i, k, 2] = times(transposed(E), f0, f1, f2)
            # row times the left Jacobian = right Jacobian times column
            six[k, 3], six[k, 4], six[k, 5] = times(by_turn, e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0)
            six[k, 1] = spread[k] / focal
        six[2, 0], six[2, 2] = 1.0, spread[2] / baseline
        _put_errors(settings, J_values[i], six)


def _backproject(
    settings: FloatArray,
    camera: FloatArray,
    uvd: FloatArray,
    values: FloatArray,
    points: FloatArray,
    J: FloatArray,
    J_values: FloatArray,
) -> None:
    errors, six = np.zeros(6), np.zeros((4, 6))
    _take_errors(settings, values, errors)
    o, focal, baseline, x0, x1, x2 = errors[0], 1.0 + errors[1], 1.0 + errors[2], errors[3], errors[4], errors[5]
    q0, q1, q2, q3 = quaternion_of(x0, x1, x2)
    back, left = transposed(matrix_of(q0, q1, q2, q3)), transposed(right_jacobian_of(x0, x1, x2))
    fx, fy, fb = focal * camera[0], focal * camera[1], focal * baseline * camera[0] * camera[4]
    for i in range(len(uvd)):
        e0, e1, scale = (uvd[i, 0] - camera[2]) / fx, (uvd[i, 1] - camera[3]) / fy, (uvd[i, 2] - o) / fb
        points[i, 0], points[i, 1], points[i, 2] = times(back, e0, e1, 1.0)
        points[i, 3], J[i, 3, 2] = scale, 1.0 / fb
        J[i, 0, 0], J[i, 1, 0], J[i, 2, 0] = times(back, 1.0 / fx, 0.0, 0.0)
        J[i, 0, 1], J[i, 1, 1], J[i, 2, 1] = times(back, 0.0, 1.0 / fy, 0.0)
        six[0, 1], six[1, 1], six[2, 1] = times(back, -e0 / focal, -e1 / focal, 0.0)
        six[3, 0], six[3, 1], six[3, 2] = -1.0 / fb, -scale / focal, -scale / baseline
        for k in range(3):  # E_back [e]x J_l
            a0, a1, a2 = left[k], left[3 + k], left[6 + k]
            six[0, 3 + k], six[1, 3 + k], six[2, 3 + k] = times(back, e1 * a2 - a1, a0 - e0 * a2, e0 * a1 - e1 * a0)
        _put_errors(settings, J_values[i], six)


@dataclass(frozen=True)
class CalibratedPair(MeasurementModel):
    """u = cx + (1 + s_f) (u0 - cx), v alike, d = (1 + s_f) (1 + s_b) d0 + o; (u0, v0, d0) is Eq. 10 of Exp(X) h_c.

    The variable "calibration" has those of o, s_f, s_b and X (3) that have a prior, in this order, zero at the start.

    Parameters
    ----------
    offset_sigma, focal_sigma, baseline_sigma, misalignment_sigma : float, optional
        Priors of o, px; of s_f and s_b, the shares by which focal lengths and baseline are larger than stated; and of
        each angle of X, by which the camera is turned against the body whose pose is estimated. None: no such error.
    considered : bool
        Whether the errors are only considered (Schmidt), not estimated.
    """

    offset_sigma: float | None = None
    focal_sigma: float | None = None
    baseline_sigma: float | None = None
    misalignment_sigma: float | None = None
    considered: bool = False
    kernels: ClassVar[MeasurementKernels | None] = MeasurementKernels(_predict, _backproject, settings=("numbers",))

    def __post_init__(self) -> None:
        sigmas = np.array([positive(_PRIORS[k], getattr(self, _PRIORS[k]), allow_zero=True) for k in self.numbers])
        if self.numbers:
            errors = Variable("calibration", 0.0 * sigmas, np.diag(sigmas**2), considered=self.considered)
            object.__setattr__(self, "variables", (errors,))

    def predict(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> FloatArray:
        """(u, v, d) with the errors."""
        centre, gains, offset, X = self._errors(camera, values)
        u0v0d0 = camera.project_scaled(points_c[..., :3] @ rotations.exp(X).T, points_c[..., 3])
        return centre + gains * (u0v0d0 - centre) + offset

    def backproject(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> FloatArray:
        """The exact inverse."""
        centre, gains, offset, X = self._errors(camera, values)
        u0v0d0 = centre + (uvd - offset - centre) / gains
        return np.column_stack([camera.ray(u0v0d0) @ rotations.exp(X), u0v0d0[:, 2] / camera.disparity_constant])

    def jacobians(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> SensorJacobians:
        """By the chain rule through Eq. 10."""
        centre, gains, offset, X = self._errors(camera, values)
        R, spread = rotations.exp(X), self.predict(camera, points_c, values) - offset - centre
        h, by_error = points_c[:, :3] @ R.T, np.zeros((len(points_c), 3, 6))
        J = gains[:, None] * camera.project_scaled_jacobian(h, points_c[:, 3])
        by_error[:, 2, 0], by_error[:, :, 1] = 1.0, spread / gains[0]
        by_error[:, 2, 2] = spread[:, 2] * gains[0] / gains[2]
        by_error[:, :, 3:] = -J[:, :, :3] @ rotations.skew(h) @ rotations.right_jacobian(-X)
        return SensorJacobians(np.concatenate([J[:, :, :3] @ R, J[:, :, 3:]], axis=2), self._by_variable(by_error))

    def backprojection_jacobians(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> SensorJacobians:
        """By the chain rule through (u0, v0, d0) and the ray."""
        centre, gains, offset, X = self._errors(camera, values)
        R, spread, by_error = rotations.exp(X), (uvd - offset - centre) / gains, np.zeros((len(uvd), 4, 6))
        J = np.zeros((4, 3))
        J[:3, :2] = R.T[:, :2] / [camera.fx, camera.fy]
        J[3, 2] = 1.0 / camera.disparity_constant
        by_error[:, :, 0], by_error[:, :, 1] = -J[:, 2] / gains[2], -spread @ J.T / gains[0]
        by_error[:, :, 2] = -spread[:, 2:] * J[:, 2] * gains[0] / gains[2]
        by_error[:, :3, 3:] = R.T @ rotations.skew(camera.ray(centre + spread)) @ rotations.right_jacobian(-X)
        return SensorJacobians(np.broadcast_to(J / gains, (len(uvd), 4, 3)), self._by_variable(by_error))

    @property
    def numbers(self) -> tuple[int, ...]:
        """Which of the six numbers o, s_f, s_b and X are in the variable."""
        return tuple(k for k, prior in enumerate(_PRIORS) if getattr(self, prior) is not None)

    def _by_variable(self, by_error: FloatArray) -> dict[str, FloatArray]:
        return {x.name: by_error[:, :, self.numbers] for x in self.variables}

    def _errors(self, camera: StereoCamera, values: Values) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Centre, gains and offset of (u, v, d) = centre + gains * ((u0, v0, d0) - centre) + offset, and X."""
        numbers = np.zeros(len(_PRIORS))
        if self.variables:
            numbers[[*self.numbers]] = values["calibration"]
        o, focal, baseline = numbers[:3]
        gains = (1.0 + focal) * np.array([1.0, 1.0, 1.0 + baseline])
        return np.array([camera.cx, camera.cy, 0.0]), gains, np.array([0.0, 0.0, o]), numbers[3:]
