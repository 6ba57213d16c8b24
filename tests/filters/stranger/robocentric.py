"""A stranger's landmark that the motion moves: bearing and inverse distance in the frame of the camera of now.

So robocentric filters have it. No measurement depends on the pose, which is known by what each step does to camera and
landmarks together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import LandmarkModel, Spherical

SPHERE = Spherical()


@dataclass(frozen=True)
class InCamera(LandmarkModel):
    """A unit vector from the camera in its axes, and the inverse distance: four numbers, the error of the sphere."""

    in_camera = True
    value_size = 4

    def parameters_of(self, position, h_w, scale):
        """The unit vector of the direction, and scale / length."""
        return SPHERE.parameters_of(position, h_w, scale)

    def homogeneous(self, position, anchors, parameters):
        """(m - rho position, rho)."""
        return SPHERE.homogeneous(position, np.zeros(3), parameters)

    def in_frame(self, parameters, R, shift):
        """(R m + rho shift, rho), the first of length one."""
        ahead = parameters[:, :3] @ R.T + parameters[:, 3:] * shift
        return np.hstack([ahead, parameters[:, 3:]]) / np.linalg.norm(ahead, axis=1, keepdims=True)

    def retract(self, parameters, delta):
        """As on the sphere."""
        return SPHERE.retract(parameters, delta)

    def local(self, parameters, other):
        """As on the sphere."""
        return SPHERE.local(parameters, other)

    def transport(self, parameters, delta):
        """As on the sphere."""
        return SPHERE.transport(parameters, delta)
