"""A stranger's landmark in the frame of the camera that first saw it: azimuth, elevation and inverse distance there.

That pose, with its orientation, is the anchor. Where it is wrong all its landmarks are off together, and no axis of the
world is special: a ray straight up in the world is like any other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import LandmarkModel


@dataclass(frozen=True)
class InFirstCamera(LandmarkModel):
    """(theta, phi, rho), rad, rad, 1/m, in the axes of the anchor."""

    in_anchor = True
    shares_anchors = True

    def parameters_of(self, position, h_w, scale):
        """Of a direction and a scale there."""
        x, y, z = h_w.T
        return np.column_stack([np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z)), scale / np.linalg.norm(h_w, axis=1)])

    def homogeneous(self, position, anchors, parameters):
        """(m - rho position, rho)."""
        theta, phi, rho = parameters.T
        m = np.column_stack([np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)])
        return np.column_stack([m - rho[:, None] * position, rho])
