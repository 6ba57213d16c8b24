"""A stranger's landmark of four error numbers: inverse depth, and a bias of the disparity that is the landmark's own.

Stereo matching errs by the same amount on the same patch for many frames. No single measurement tells the bias from the
depth; it starts at zero with a prior, and shows when the camera has moved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from filters import InverseDepth, LandmarkKernels, LandmarkModel, MeasurementKernels, RangeBearing, SensorJacobians

POINT, PAIR = InverseDepth(), RangeBearing()
_inner_point, _inner_start = njit(POINT.kernels.point), njit(POINT.kernels.start)
_inner_turn, _inner_rotation = njit(POINT.kernels.turn), njit(POINT.kernels.rotation)
_inner_predict, _inner_backproject = njit(PAIR.kernels.predict), njit(PAIR.kernels.backproject)


def _point(settings, values, points, J):
    _inner_point(settings, values[:, :3], points[:, :4], J[:, :4, :3])
    points[:, 4] = values[:, 3]
    J[:, 4, 3] = 1.0


def _start(settings, points, values, J, possible):
    _inner_start(settings, points[:, :4], values[:, :3], J[:, :3, :4], possible)
    values[:, 3] = points[:, 4]
    J[:, 3, 4] = 1.0


def _turn(settings, values, theta, correction, moved, J, J_theta):
    _inner_turn(settings, values[:, :3], theta, correction[:, :3], moved[:, :3], J[:, :3, :3], J_theta[:, :3])
    moved[:, 3] = values[:, 3] + correction[:, 3]
    J[:, 3, 3] = 1.0


def _rotation(settings, values, effect):
    _inner_rotation(settings, values[:, :3], effect[:, :3])


@dataclass(frozen=True)
class Biased(LandmarkModel):
    """(theta, phi, rho) from a shared anchor, and the bias, px.

    Parameters
    ----------
    sigma : float
        Standard deviation of the biases, px.
    """

    sigma: float = 2.0
    anchored = True
    shares_anchors = True
    size = value_size = 4
    seen_size = 5
    follows = (2, 3)
    submaps = True
    kernels = LandmarkKernels(_point, _start, _turn, _rotation)

    def __post_init__(self):
        if not (isinstance(self.sigma, int | float) and 0.0 <= self.sigma < np.inf):
            raise ValueError(f"sigma must be a number of px >= 0, got {self.sigma!r}")

    @property
    def prior(self):
        """Of the bias."""
        return np.array([[float(self.sigma) ** 2]])

    def can_start(self, h_w, scale):
        """As inverse depth."""
        return POINT.can_start(h_w, scale[:, 0])

    def parameters_of(self, position, h_w, scale):
        """As inverse depth, and the bias."""
        return np.column_stack([POINT.parameters_of(position, h_w, scale[:, 0]), scale[:, 1]])

    def homogeneous(self, position, anchors, parameters):
        """Direction, scale, bias."""
        return np.column_stack([POINT.homogeneous(position, anchors, parameters[:, :3]), parameters[:, 3]])

    def rotated(self, anchors, parameters, R):
        """The ray turns."""
        return np.column_stack([POINT.rotated(anchors, parameters[:, :3], R), parameters[:, 3]])

    def turned(self, anchors, parameters, turn, spread, correction):
        """As inverse depth; the bias is added."""
        ray = POINT.turned(anchors, parameters[:, :3], turn, spread, correction[:, :3])
        return np.column_stack([ray, parameters[:, 3] + correction[:, 3]])


def _predict(settings, camera, points, values, numbers, J, J_values, in_front):
    _inner_predict(settings, camera, points[:, :4], values, numbers, J[:, :, :4], J_values, in_front)
    numbers[:, 2] += points[:, 4]
    J[:, 2, 4] = 1.0


def _backproject(settings, camera, uvd, values, points, J, J_values):
    _inner_backproject(settings, camera, uvd, values, points[:, :4], J[:, :4], J_values)


@dataclass(frozen=True)
class BiasedPair(RangeBearing):
    """(u, v, d) of a rectified pair, the bias added to d."""

    seen_size = 5
    kernels = MeasurementKernels(_predict, _backproject)

    def predict(self, camera, points_c, values):
        """(u, v, d + bias)."""
        uvd = PAIR.predict(camera, points_c[..., :4], values)
        uvd[..., 2] += points_c[..., 4]
        return uvd

    def jacobians(self, camera, points_c, values):
        """Those of the pair, and one."""
        J = np.zeros((len(points_c), 3, 5))
        J[:, :, :4] = PAIR.jacobians(camera, points_c[:, :4], values).by_point
        J[:, 2, 4] = 1.0
        return SensorJacobians(J, {})

    def backproject(self, camera, uvd, values):
        """The point without a bias."""
        return np.column_stack([PAIR.backproject(camera, uvd, values), np.zeros(len(uvd))])

    def backprojection_jacobians(self, camera, uvd, values):
        """A bias of zero is no matter of the measurement."""
        J = PAIR.backprojection_jacobians(camera, uvd, values).by_point
        return SensorJacobians(np.concatenate([J, np.zeros((len(uvd), 1, 3))], axis=1), {})
