"""A stranger's landmark that the group SOT(3) moves: bearing and log-distance in the axes of a clone of the camera."""

from __future__ import annotations

from dataclasses import dataclass

from filters import Polar


@dataclass(frozen=True)
class RotatedAndScaled(Polar):
    """A unit vector in the axes of the pose that first saw it, and the logarithm of its distance from there, in m."""

    in_anchor = True
    anchored = False
