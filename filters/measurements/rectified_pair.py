"""The rectified pair: (u, v, d) of Eq. 7-10, and four ways to use a frame of it.

The noise of all is derived from the R of (u, v, d): left T_l R T_l^T, right T_r R T_r^T with u_right = u - d. Where the
right row is not measured on its own it is the left one, and carries no information: it is not counted twice, unless a
`copied_row_variance` asks for it, as a filter does that takes v_right = v for a measurement (the paper's rival).

The calibrated pair has the errors of its calibration as a variable; with lasting errors a landmark has some of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from filters.contract.inputs import StereoObservation
from filters.contract.outputs import Variable
from filters.contract.validation import positive
from filters.geometry.camera import StereoCamera
from filters.geometry.machine_code import compiled
from filters.geometry.vectors import turned_by
from filters.measurements.measurement_model import MeasurementModel, Numbers, StageRows

_U, _V, _U_RIGHT = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, -1.0)


class RectifiedPair(MeasurementModel):
    """Base of the models of a rectified pair: they differ in the stages of an update."""

    def project(self, camera: Any, h: Numbers, values: Any = None) -> Numbers:
        """(u, v, d) of Eq. 10."""
        return (
            camera.fx * h[0] / h[2] + camera.cx,
            camera.fy * h[1] / h[2] + camera.cy,
            camera.fx * camera.baseline * h[3] / h[2],
        )

    def unproject(self, camera: Any, uvd: Numbers, values: Any = None) -> Numbers:
        """The ray at z = 1, and d / (f b) as its scale (Eq. 21)."""
        x, y = (uvd[0] - camera.cx) / camera.fx, (uvd[1] - camera.cy) / camera.fy
        return x, y, 1.0, uvd[2] / (camera.fx * camera.baseline)


@dataclass(frozen=True)
class RangeBearing(RectifiedPair):
    """The paper's: one joint update with (u, v, d). A separately measured right row is not used."""


@dataclass(frozen=True)
class _BothCameras(RectifiedPair):
    """Measurement models that use the right camera's row.

    Parameters
    ----------
    copied_row_variance : float or None
        Where v_right is not measured on its own, take the left v for it with this many times its variance: 1 counts
        one measurement twice, infinity not at all. None: leave the row out.
    """

    copied_row_variance: float | None = None

    def __post_init__(self) -> None:
        if self.copied_row_variance is not None:
            positive("copied_row_variance", self.copied_row_variance)


@dataclass(frozen=True)
class LeftThenRight(_BothCameras):
    """Two updates in sequence, left then right, the second linearised at the result of the first."""

    def rows(self, with_right: bool) -> tuple[StageRows, ...]:
        """Left, and right; u_right alone where v_right is not measured and not to be copied."""
        copied = self.copied_row_variance
        if with_right:
            return StageRows((_U, _V)), StageRows((_U_RIGHT, _V), right_row=1)
        if copied is None:
            return StageRows((_U, _V)), StageRows((_U_RIGHT,))
        return StageRows((_U, _V)), StageRows((_U_RIGHT, _V), apart_row=1, apart_scale=copied)


@dataclass(frozen=True)
class Stacked(_BothCameras):
    """One update with the pixels of both cameras, with the correlation of u and u_right that R implies.

    The error of v_right is taken as independent of the other three.
    """

    def rows(self, with_right: bool) -> tuple[StageRows, ...]:
        """One stage."""
        both, copied = (_U, _V, _U_RIGHT, _V), self.copied_row_variance
        if with_right:
            return (StageRows(both, right_row=3, apart_row=3),)
        return (StageRows(both[:3]) if copied is None else StageRows(both, apart_row=3, apart_scale=copied),)


@dataclass(frozen=True)
class LeftOnly(RectifiedPair):
    """Monocular updates: the left pixel. The disparity serves for initialisation only.

    Parameters
    ----------
    inverse_depth, sigma_inverse_depth : float
        Of a new landmark whose disparity was not measured, and its standard deviation, 1/m.
    """

    inverse_depth: float = 0.1
    sigma_inverse_depth: float = 0.1

    def __post_init__(self) -> None:
        for name in ("inverse_depth", "sigma_inverse_depth"):
            positive(name, getattr(self, name))

    def completed(self, observation: StereoObservation, camera: StereoCamera) -> StereoObservation:
        """The observation with disparities of the prior where none was measured: landmarks start from them alone."""
        if observation.has_disparity or observation.R is None:
            return observation
        uvd, R, missing = observation.uvd.copy(), observation.R.copy(), ~observation.with_disparity
        uvd[missing, 2] = camera.disparity_constant * self.inverse_depth
        R[missing, 2, 2] = (camera.disparity_constant * self.sigma_inverse_depth) ** 2
        return replace(observation, uvd=uvd, R=R)

    def rows(self, with_right: bool) -> tuple[StageRows, ...]:
        """One stage."""
        return (StageRows((_U, _V)),)


_PRIORS = (
    *("offset_sigma", "focal_sigma", "baseline_sigma"),
    *("misalignment_sigma",) * 3,
    *("yaw_sigma", "roll_sigma"),
)


class _Exact(NamedTuple):
    calibration: tuple[float] = (0.0,)


_EXACT = _Exact()
"""Values where the calibration has no errors; the number is not read."""


@compiled
def _error(present: Numbers, numbers: Numbers, k: int) -> Any:
    """Error k of the calibration, of those that are present in the variable; zero where it is not."""
    if not present[k]:
        return 0.0 * numbers[0]
    place = 0
    for i in range(k):
        place += int(present[i])
    return numbers[place]


@compiled
def _errors(present: Numbers, x: Numbers) -> Numbers:
    """o, s_f, s_b, X (3), t and q."""
    turn = _error(present, x, 3), _error(present, x, 4), _error(present, x, 5)
    scales = _error(present, x, 1), _error(present, x, 2)
    return _error(present, x, 0), scales[0], scales[1], turn, _error(present, x, 6), _error(present, x, 7)


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
    present: tuple[bool, ...] = field(init=False, repr=False, compare=False, default=())
    """Which of o, s_f, s_b, X (3), t and q are in the variable."""

    def __post_init__(self) -> None:
        sigmas = [getattr(self, name) for name in _PRIORS]
        object.__setattr__(self, "present", tuple(sigma is not None for sigma in sigmas))
        named_sigmas = zip(_PRIORS, sigmas, strict=True)
        variances = np.array(
            [positive(name, sigma, allow_zero=True) for name, sigma in named_sigmas if sigma is not None]
        )
        if len(variances):
            errors = Variable("calibration", 0.0 * variances, np.diag(variances**2), considered=self.considered)
            object.__setattr__(self, "variables", (errors,))

    def project(self, camera: Any, h: Numbers, values: Any = _EXACT) -> Numbers:
        """(u, v, d) with the errors."""
        o, focal, scale, turn, t, q = _errors(self.present, values.calibration)
        p = turned_by(turn, (h[0], h[1], h[2]))
        x, y = p[0] / p[2], p[1] / p[2]
        straight = x - (1.0 + scale) * camera.baseline * h[3] / p[2] - q * y  # in the right camera, before its turn
        seen, focal = (straight - t) / (1.0 + t * straight), 1.0 + focal
        return (
            focal * camera.fx * x + camera.cx,
            focal * camera.fy * y + camera.cy,
            focal * camera.fx * (x - seen) + o,
        )

    def unproject(self, camera: Any, uvd: Numbers, values: Any = _EXACT) -> Numbers:
        """Homogeneous point of a measurement: the exact inverse."""
        o, focal, scale, turn, t, q = _errors(self.present, values.calibration)
        fx, fy = (1.0 + focal) * camera.fx, (1.0 + focal) * camera.fy
        x, y = (uvd[0] - camera.cx) / fx, (uvd[1] - camera.cy) / fy
        seen = x - (uvd[2] - o) / fx
        straight = (seen + t) / (1.0 - t * seen)
        ray = turned_by((-turn[0], -turn[1], -turn[2]), (x, y, 1.0))
        return ray[0], ray[1], ray[2], (x - straight - q * y) / ((1.0 + scale) * camera.baseline)


_project, _unproject = compiled(CalibratedPair.project), compiled(CalibratedPair.unproject)


@dataclass(frozen=True)
class PairWithLastingErrors(CalibratedPair):
    """One joint update with (u, v, d) of a `CalibratedPair`, plus the errors of the landmark that last, px.

    Landmarks are `LastingErrors`; parameters are those of `CalibratedPair`, and without them the rig is exact (Eq. 10).
    """

    seen_size: ClassVar[int] = 7

    def project(self, camera: Any, h: Numbers, values: Any = _EXACT) -> Numbers:
        """(u, v, d) with the errors."""
        u, v, d = _project(self, camera, h, values)
        return u + h[4], v + h[5], d + h[6]

    def unproject(self, camera: Any, uvd: Numbers, values: Any = _EXACT) -> Numbers:
        """The point as if there were no errors of its own."""
        x, y, z, scale = _unproject(self, camera, uvd, values)
        return x, y, z, scale, 0.0, 0.0, 0.0
