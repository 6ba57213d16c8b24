"""A stranger's landmark that the group SOT(3) moves: bearing and log-distance in the axes of a clone of the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import LandmarkModel, Polar


@dataclass(frozen=True)
class RotatedAndScaled(LandmarkModel):
    """A unit vector in the axes of the pose that first saw it, and the logarithm of its distance from there, in m."""

    in_anchor = True
    shares_anchors = True
    value_size = Polar.value_size

    # the chart of `Polar`, which does not say in whose axes it is
    can_start = Polar.can_start
    parameters_of, started = Polar.parameters_of, Polar.started
    retract, local, transport = Polar.retract, Polar.local, Polar.transport

    def homogeneous(self, position, anchors, parameters):
        m, rho = parameters[:, :3], np.exp(-parameters[:, 3:])
        return np.hstack([m - rho * position, rho])
