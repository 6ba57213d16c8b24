"""The rectified pair with the errors of its calibration as a variable of the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.variables import Variable
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from filters.measurements.model import MeasurementModel, SensorJacobians, Values
from filters.validation import FloatArray, positive

_PRIORS = ("offset_sigma", "focal_sigma", "baseline_sigma", *("misalignment_sigma",) * 3)


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
    kernel: ClassVar[str | None] = "calibrated-pair"

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
