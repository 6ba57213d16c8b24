"""The rectified pair with the errors of its calibration as a variable of the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.validation import positive
from filters.contract.variables import Variable
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from filters.geometry.machine_code import compiled
from filters.geometry.rotations import matrix_of, quaternion_of, right_jacobian_of
from filters.geometry.three_by_three import times, transposed
from filters.measurements.measurement_model import MeasurementKernels, MeasurementModel, SensorJacobians, Values

_PRIORS = (
    *("offset_sigma", "focal_sigma", "baseline_sigma"),
    *("misalignment_sigma",) * 3,
    *("yaw_sigma", "roll_sigma"),
)
ERRORS = len(_PRIORS)
"""How many errors there are."""


@compiled
def _put_errors(numbers: FloatArray, J: FloatArray, whole: FloatArray) -> None:
    """Of a Jacobian by all errors (s, 8), the columns of those that are in the variable."""
    for j in range(len(numbers)):
        for k in range(len(J)):
            J[k, j] = whole[k, int(numbers[j])]


@compiled
def _take_errors(numbers: FloatArray, values: FloatArray, errors: FloatArray) -> None:
    """All errors; those that are not in the variable are zero."""
    for j in range(len(numbers)):
        errors[int(numbers[j])] = values[j]


@compiled
def predict_with(
    settings: FloatArray,
    camera: FloatArray,
    points: FloatArray,
    values: FloatArray,
    numbers: FloatArray,
    J: FloatArray,
    J_values: FloatArray,
    in_front: BoolArray,
    errors: FloatArray,
    by_error: FloatArray,
) -> None:
    """Kernel `predict`; it needs zeros (8,) and (3, 8)."""
    _take_errors(settings, values, errors)
    o, focal, baseline, x0, x1, x2 = errors[0], 1.0 + errors[1], 1.0 + errors[2], errors[3], errors[4], errors[5]
    yaw, roll = errors[6], errors[7]
    q0, q1, q2, q3 = quaternion_of(x0, x1, x2)
    E, by_turn = matrix_of(q0, q1, q2, q3), right_jacobian_of(x0, x1, x2)  # of its transpose, the left one
    fx, fy, b = focal * camera[0], focal * camera[1], baseline * camera[4]
    for i in range(len(points)):
        e0, e1, e2 = times(E, points[i, 0], points[i, 1], points[i, 2])
        inverse, scale = 1.0 / e2, points[i, 3]
        x, y, shift = e0 * inverse, e1 * inverse, b * scale * inverse
        straight = x - shift - roll * y  # in the right camera, before its turn
        tilt = 1.0 / (1.0 + yaw * straight)
        stretch = (1.0 + yaw * yaw) * tilt * tilt
        in_front[i] = points[i, 2] > 0.0
        numbers[i, 0], numbers[i, 1] = fx * x + camera[2], fy * y + camera[3]
        numbers[i, 2] = fx * (x - (straight - yaw) * tilt) + o
        J[i, 2, 3] = fx * stretch * b * inverse
        for k in range(3):
            f0, f1 = fx * inverse if k == 0 else 0.0, fy * inverse if k == 1 else 0.0
            f2 = -(fx * x if k == 0 else fy * y) * inverse
            if k == 2:
                f0, f1 = fx * inverse * (1.0 - stretch), fx * inverse * stretch * roll
                f2 = -fx * inverse * (x - stretch * straight)
            J[i, k, 0], J[i, k, 1], J[i, k, 2] = times(transposed(E), f0, f1, f2)
            # row times the left Jacobian = right Jacobian times column
            turned = e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0
            by_error[k, 3], by_error[k, 4], by_error[k, 5] = times(by_turn, turned[0], turned[1], turned[2])
        by_error[0, 1], by_error[1, 1] = camera[0] * x, camera[1] * y
        by_error[2, 0], by_error[2, 1] = 1.0, (numbers[i, 2] - o) / focal
        by_error[2, 2] = fx * stretch * camera[4] * scale * inverse
        by_error[2, 6], by_error[2, 7] = fx * (1.0 + straight * straight) * tilt * tilt, fx * stretch * y
        _put_errors(settings, J_values[i], by_error)


@compiled
def backproject_with(
    settings: FloatArray,
    camera: FloatArray,
    uvd: FloatArray,
    values: FloatArray,
    points: FloatArray,
    J: FloatArray,
    J_values: FloatArray,
    errors: FloatArray,
    by_error: FloatArray,
) -> None:
    """Kernel `backproject`; it needs zeros (8,) and (4, 8)."""
    _take_errors(settings, values, errors)
    o, focal, baseline, x0, x1, x2 = errors[0], 1.0 + errors[1], 1.0 + errors[2], errors[3], errors[4], errors[5]
    yaw, roll = errors[6], errors[7]
    q0, q1, q2, q3 = quaternion_of(x0, x1, x2)
    back, left = transposed(matrix_of(q0, q1, q2, q3)), transposed(right_jacobian_of(x0, x1, x2))
    fx, fy, b = focal * camera[0], focal * camera[1], baseline * camera[4]
    for i in range(len(uvd)):
        x, y, seen = (
            (uvd[i, 0] - camera[2]) / fx,
            (uvd[i, 1] - camera[3]) / fy,
            (uvd[i, 0] - camera[2] - uvd[i, 2] + o) / fx,
        )
        tilt = 1.0 / (1.0 - yaw * seen)
        straight, stretch = (seen + yaw) * tilt, (1.0 + yaw * yaw) * tilt * tilt
        scale = (x - straight - roll * y) / b
        points[i, 0], points[i, 1], points[i, 2] = times(back, x, y, 1.0)
        points[i, 3] = scale
        J[i, 0, 0], J[i, 1, 0], J[i, 2, 0] = times(back, 1.0 / fx, 0.0, 0.0)
        J[i, 0, 1], J[i, 1, 1], J[i, 2, 1] = times(back, 0.0, 1.0 / fy, 0.0)
        J[i, 3, 0], J[i, 3, 1], J[i, 3, 2] = (1.0 - stretch) / (fx * b), -roll / (fy * b), stretch / (fx * b)
        by_error[0, 1], by_error[1, 1], by_error[2, 1] = times(back, -x / focal, -y / focal, 0.0)
        by_error[3, 0], by_error[3, 1] = -stretch / (fx * b), (stretch * seen + roll * y - x) / (focal * b)
        by_error[3, 2] = -scale / baseline
        by_error[3, 6], by_error[3, 7] = -(1.0 + seen * seen) * tilt * tilt / b, -y / b
        for k in range(3):  # E_back [e]x J_l
            a0, a1, a2 = left[k], left[3 + k], left[6 + k]
            by_error[0, 3 + k], by_error[1, 3 + k], by_error[2, 3 + k] = times(
                back, y * a2 - a1, a0 - x * a2, x * a1 - y * a0
            )
        _put_errors(settings, J_values[i], by_error)


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
    predict_with(settings, camera, points, values, numbers, J, J_values, in_front, errors, by_error)


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
    backproject_with(settings, camera, uvd, values, points, J, J_values, errors, by_error)


@dataclass(frozen=True)
class CalibratedPair(MeasurementModel):
    """The rectified pair with errors of focal length, baseline, offset, and of how both cameras are turned.

    With (x, y, w) = (h_x, h_y, scale) / h_z of Exp(X) h_c: u = cx + (1 + s_f) fx x, v alike. The right camera, which is
    rolled by q and turned by the angle of tangent t about its vertical axis, sees x_R = (c - t) / (1 + t c) of
    c = x - (1 + s_b) b w - q y, and d = (1 + s_f) fx (x - x_R) + o. To first order d grows by fx (t (1 + x_R^2) + q y).

    The variable "calibration" has those of o, s_f, s_b, X (3), t and q that have a prior, in this order, zero at the
    start.

    Parameters
    ----------
    offset_sigma, focal_sigma, baseline_sigma, misalignment_sigma : float, optional
        Priors of o, px; of s_f and s_b, the shares by which focal lengths and baseline are larger than stated; and of
        each angle of X, by which the camera is turned against the body whose pose is estimated. None: no such error.
    yaw_sigma, roll_sigma : float, optional
        Priors of t and q, rad: what the rectification has left of the rotation of the right camera.
    considered : bool
        Whether the errors are only considered (Schmidt), not estimated.
    """

    offset_sigma: float | None = None
    focal_sigma: float | None = None
    baseline_sigma: float | None = None
    misalignment_sigma: float | None = None
    yaw_sigma: float | None = None
    roll_sigma: float | None = None
    considered: bool = False
    kernels: ClassVar[MeasurementKernels | None] = MeasurementKernels(_predict, _backproject, settings=("numbers",))

    def __post_init__(self) -> None:
        sigmas = np.array([positive(_PRIORS[k], getattr(self, _PRIORS[k]), allow_zero=True) for k in self.numbers])
        if self.numbers:
            errors = Variable("calibration", 0.0 * sigmas, np.diag(sigmas**2), considered=self.considered)
            object.__setattr__(self, "variables", (errors,))

    def predict(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> FloatArray:
        """(u, v, d) with the errors."""
        e = self._errors(values)
        h = points_c[..., :3] @ rotations.exp(e[3:6]).T
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y, w = h[..., 0] / h[..., 2], h[..., 1] / h[..., 2], points_c[..., 3] / h[..., 2]
        straight = x - (1.0 + e[2]) * camera.baseline * w - e[7] * y
        seen = (straight - e[6]) / (1.0 + e[6] * straight)
        numbers = np.stack([camera.fx * x, camera.fy * y, camera.fx * (x - seen)], axis=-1)
        seen_with: FloatArray = (1.0 + e[1]) * numbers + [camera.cx, camera.cy, e[0]]
        return seen_with

    def backproject(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> FloatArray:
        """The exact inverse."""
        e, rays, _, straight = self._seen_back(camera, uvd, values)
        w = (rays[:, 0] - straight - e[7] * rays[:, 1]) / ((1.0 + e[2]) * camera.baseline)
        return np.column_stack([rays @ rotations.exp(e[3:6]), w])

    def jacobians(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> SensorJacobians:
        """By the chain rule through h, (x, y, w) and x_R."""
        e = self._errors(values)
        R, b, f = rotations.exp(e[3:6]), (1.0 + e[2]) * camera.baseline, (1.0 + e[1]) * camera.fx
        h = points_c[:, :3] @ R.T
        x, y, w = h[:, 0] / h[:, 2], h[:, 1] / h[:, 2], points_c[:, 3] / h[:, 2]
        straight = x - b * w - e[7] * y
        stretch = (1.0 + e[6] ** 2) / (1.0 + e[6] * straight) ** 2
        by_xyw, J, by_error = (np.zeros((len(h), 3, k)) for k in (3, 4, ERRORS))
        by_xyw[:, 0, 0], by_xyw[:, 1, 1] = f, (1.0 + e[1]) * camera.fy
        by_xyw[:, 2] = f * np.column_stack([1.0 - stretch, stretch * e[7], stretch * b])
        J[:, :, [0, 1, 3]] = by_xyw / h[:, 2, None, None]
        J[:, :, 2] = -np.einsum("mij,mj->mi", by_xyw, np.column_stack([x, y, w])) / h[:, 2, None]
        by_error[:, 2, 0] = 1.0
        seen = (straight - e[6]) / (1.0 + e[6] * straight)
        by_error[:, :, 1] = np.column_stack([camera.fx * x, camera.fy * y, camera.fx * (x - seen)])
        by_error[:, 2, 2] = f * stretch * camera.baseline * w
        by_error[:, :, 3:6] = -J[:, :, :3] @ rotations.skew(h) @ rotations.right_jacobian(-e[3:6])
        by_error[:, 2, 6] = f * (1.0 + straight**2) / (1.0 + e[6] * straight) ** 2
        by_error[:, 2, 7] = f * stretch * y
        return SensorJacobians(np.concatenate([J[:, :, :3] @ R, J[:, :, 3:]], axis=2), self._by_variable(by_error))

    def backprojection_jacobians(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> SensorJacobians:
        """By the chain rule through x_R, w and the ray."""
        e, rays, seen, straight = self._seen_back(camera, uvd, values)
        R, (x, y) = rotations.exp(e[3:6]), rays[:, :2].T
        f = (1.0 + e[1]) * np.array([camera.fx, camera.fy])
        b, tilt = (1.0 + e[2]) * camera.baseline, 1.0 / (1.0 - e[6] * seen)
        stretch = (1.0 + e[6] ** 2) * tilt**2
        J, by_error = np.zeros((len(uvd), 4, 3)), np.zeros((len(uvd), 4, ERRORS))
        J[:, :3, :2] = R.T[:, :2] / f
        J[:, 3, 0], J[:, 3, 1], J[:, 3, 2] = (1.0 - stretch) / (f[0] * b), -e[7] / (f[1] * b), stretch / (f[0] * b)
        by_error[:, 3, 0] = -stretch / (f[0] * b)
        by_error[:, :3, 1] = -rays[:, :2] @ R[:2] / (1.0 + e[1])
        by_error[:, 3, 1] = (stretch * seen + e[7] * y - x) / ((1.0 + e[1]) * b)
        by_error[:, 3, 2] = -(x - straight - e[7] * y) / (b * (1.0 + e[2]))
        by_error[:, :3, 3:6] = R.T @ rotations.skew(rays) @ rotations.right_jacobian(-e[3:6])
        by_error[:, 3, 6], by_error[:, 3, 7] = -(1.0 + seen**2) * tilt**2 / b, -y / b
        return SensorJacobians(J, self._by_variable(by_error))

    @property
    def numbers(self) -> tuple[int, ...]:
        """Which of the numbers o, s_f, s_b, X (3), t and q are in the variable."""
        return tuple(k for k, prior in enumerate(_PRIORS) if getattr(self, prior) is not None)

    def _by_variable(self, by_error: FloatArray) -> dict[str, FloatArray]:
        return {x.name: by_error[:, :, self.numbers] for x in self.variables}

    def _errors(self, values: Values) -> FloatArray:
        """All of o, s_f, s_b, X (3), t and q; those that are not in the variable are zero."""
        errors = np.zeros(ERRORS)
        if self.variables:
            errors[[*self.numbers]] = values["calibration"]
        return errors

    def _seen_back(
        self, camera: StereoCamera, uvd: FloatArray, values: Values
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """The errors, left rays (M, 3), x in the right camera (M,), and x before its turn (M,)."""
        e = self._errors(values)
        x, y = (uvd[:, :2] - [camera.cx, camera.cy]).T / ((1.0 + e[1]) * np.array([[camera.fx], [camera.fy]]))
        seen = x - (uvd[:, 2] - e[0]) / ((1.0 + e[1]) * camera.fx)
        return e, np.column_stack([x, y, np.ones(len(uvd))]), seen, (seen + e[6]) / (1.0 - e[6] * seen)
