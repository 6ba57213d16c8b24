"""A stranger's landmark that is no point: an upright line, such as a pole, and what a stereo pair measures of it.

A line is seen by two vectors (Plücker): the normal N of its plane through the camera, and its direction V, at the scale
of the inverse distance. Both turn with the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from filters import ColumnLandmark, MeasurementModel

ROWS = 100.0
"""By how many rows a slope is measured, px."""


@dataclass(frozen=True)
class Lines(ColumnLandmark):
    """A frame (m, V x m, V) as a quaternion, m to the point nearest to the anchor; and the inverse distance rho.

    Errors: rotation about V, rho, rotation about m, and about V x m: the lean towards the camera, which (u, slope, d)
    do not tell. It has a prior.

    Parameters
    ----------
    sigma : float
        Standard deviation of the lean, rad.
    """

    sigma: float = 0.2
    anchored = True
    shares_anchors = True
    size = 4
    value_size = 5
    seen_size = 6
    seen_vectors = 2

    def __post_init__(self):
        if not (isinstance(self.sigma, int | float) and 0.0 <= self.sigma < np.inf):
            raise ValueError(f"sigma must be a number of rad >= 0, got {self.sigma!r}")

    @property
    def prior(self):
        """Of the lean."""
        return np.array([[float(self.sigma) ** 2]])

    def can_start(self, h_w, scale):
        """Where the direction is known: in front, at a finite distance."""
        return np.linalg.norm(h_w[:, 3:], axis=1) > 1e-9

    def parameters_of(self, position, h_w, scale):
        """The frame of N and V; the part of N along V is left out."""
        V = h_w[:, 3:] / np.linalg.norm(h_w[:, 3:], axis=1, keepdims=True)
        N = h_w[:, :3] - np.sum(h_w[:, :3] * V, axis=1, keepdims=True) * V
        distance = np.linalg.norm(N, axis=1, keepdims=True)
        across = -N / distance
        frames = np.stack([np.cross(across, V), across, V], axis=2)
        rho = np.linalg.norm(h_w[:, 3:], axis=1, keepdims=True) / distance
        return np.hstack([Rotation.from_matrix(frames).as_quat().reshape(-1, 4), rho])

    def homogeneous(self, position, anchors, parameters):
        """(rho (anchor - r) x V + m x V, rho V)."""
        frames, rho = Rotation.from_quat(parameters[:, :4]).as_matrix(), parameters[:, 4:]
        V = frames[:, :, 2]
        return np.hstack([rho * np.cross(anchors - position, V) - frames[:, :, 1], rho * V])

    def rotated(self, anchors, parameters, R):
        """The frame turns."""
        frames = Rotation.from_matrix(R) * Rotation.from_quat(parameters[:, :4])
        return np.hstack([frames.as_quat(), parameters[:, 4:]])

    def retract(self, parameters, delta):
        """The frame by a rotation vector, rho by addition."""
        turn = Rotation.from_rotvec(delta[..., [2, 3, 0]])
        frames = (Rotation.from_quat(parameters[:, :4]) * turn).as_quat()
        return np.hstack([frames, parameters[:, 4:] + delta[..., 1:2]])

    def local(self, parameters, other):
        """The way back."""
        turn = (Rotation.from_quat(parameters[:, :4]).inv() * Rotation.from_quat(other[:, :4])).as_rotvec()
        return np.column_stack([turn[:, 2], other[:, 4] - parameters[:, 4], turn[:, :2]])

    def point(self, seen):
        """The point nearest to where the line is seen from: V x N / |V|^2."""
        return np.column_stack([np.cross(seen[:, 3:], seen[:, :3]), np.sum(seen[:, 3:] ** 2, axis=1)])


@dataclass(frozen=True)
class LinePair(MeasurementModel):
    """Where a line crosses the row of the principal point, u; its slope there; u - u_right; and the right slope.

    Slopes are in px by `ROWS` rows, from the principal point. The right slope is measured where there is a `v_right`.
    """

    seen_size = 6
    seen_vectors = 2
    size = 4

    def predict(self, camera, points_c, values):
        """From the normals of the planes through both cameras."""
        N, V = points_c[..., :3], points_c[..., 3:]
        right = N - camera.baseline * np.cross([1.0, 0.0, 0.0], V)
        u, slope = -camera.fx * N[..., 2] / N[..., 0], -ROWS * N[..., 1] / N[..., 0]
        u_right, slope_right = -camera.fx * right[..., 2] / right[..., 0], -ROWS * right[..., 1] / right[..., 0]
        return np.stack([u + camera.cx, slope + camera.cy, u - u_right, slope_right + camera.cy], axis=-1)

    def backproject(self, camera, uvd, values):
        """The line that does not lean towards the camera."""
        x, slope = (uvd[:, 0] - camera.cx) / camera.fx, (uvd[:, 1] - camera.cy) / ROWS
        scale, one, none = uvd[:, 2] / camera.disparity_constant, np.ones(len(uvd)), np.zeros(len(uvd))
        V = np.column_stack([slope, one, none])
        return np.hstack([np.cross(np.column_stack([x, none, one]), V), scale[:, None] * V])

    def in_front(self, points_c):
        """The nearest point is ahead, and the line upright."""
        ahead = np.cross(points_c[:, 3:], points_c[:, :3])[:, 2] > 0.0
        return ahead & (np.abs(points_c[:, 0]) > 0.1 * np.linalg.norm(points_c[:, :3], axis=1))
