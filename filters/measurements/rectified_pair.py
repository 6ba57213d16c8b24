"""The rectified pair: (u, v, d) of Eq. 7-10, and four ways to use a frame of it.

The noise of all is derived from the R of (u, v, d): left T_l R T_l^T, right T_r R T_r^T with u_right = u - d. Where the
right row is not measured on its own it is the left one, and carries no information: it is not counted twice, unless a
`copied_row_variance` asks for it, as a filter does that takes v_right = v for a measurement (the paper's rival).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from filters.contract.inputs import StereoObservation
from filters.contract.validation import positive
from filters.geometry.camera import StereoCamera
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
