"""A stranger's landmark in the frame of the camera that first saw it: azimuth, elevation and inverse distance there.

That pose, with its orientation, is the anchor. Where it is wrong all its landmarks are off together, and no axis of the
world is special: a ray straight up in the world is like any other.
"""

from __future__ import annotations

from dataclasses import dataclass

from filters import InverseDepth


@dataclass(frozen=True)
class InFirstCamera(InverseDepth):
    """(theta, phi, rho), rad, rad, 1/m, in the axes of the anchor."""

    in_anchor = True
    shares_anchors = True
    anchored = submaps = False
