"""Where things stand: off the roads and clear of each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.world.props import Placed
from stereo_slam_env.world.road import RoadNetwork
from stereo_slam_env.world.scene import Primitive

Make = Callable[[Placed], list[Primitive]]
"""Builds a thing at a place."""


class Layout:
    """Puts things where there is room.

    Parameters
    ----------
    network : RoadNetwork
        What to stay off.
    """

    def __init__(self, network: RoadNetwork) -> None:
        self._network = network
        self.primitives: list[Primitive] = []
        self._footprints: list[Footprint] = []
        self._circles = np.zeros((64, 3))
        """Centre and radius of each footprint, with room for more."""

    def claim(
        self,
        xy: FloatArray,
        yaw: float,
        size: tuple[float, float],
        room: float,
        clearance: float,
        make: Make,
    ) -> bool:
        """Build if the footprint is `clearance` m off every centreline and free; return whether it was."""
        wanted = Footprint(xy, yaw, size)
        cover = wanted.grid()
        if not self._network.clear(cover, clearance):
            return False
        for other in self._nearby(wanted, room):
            if other.contains(cover, room) or wanted.contains(other.xy[None], room):
                return False
        self._add(wanted)
        self.primitives += make(Placed(xy, yaw))
        return True

    def _add(self, footprint: Footprint) -> None:
        count = len(self._footprints)
        if count == len(self._circles):
            self._circles = np.concatenate([self._circles, np.zeros_like(self._circles)])
        self._circles[count] = (*footprint.xy, footprint.radius)
        self._footprints.append(footprint)

    def _nearby(self, wanted: Footprint, room: float) -> list[Footprint]:
        """The footprints whose circles come within `room` of the circle of the wanted one."""
        circles = self._circles[: len(self._footprints)]
        away = np.hypot(circles[:, 0] - wanted.xy[0], circles[:, 1] - wanted.xy[1])
        return [self._footprints[i] for i in np.flatnonzero(away < circles[:, 2] + wanted.radius + 2 * room)]


@dataclass(frozen=True, eq=False)
class Footprint:
    """A rectangle on the ground: centre (2,), yaw, size (length, width)."""

    xy: FloatArray
    yaw: float
    size: tuple[float, float]

    @cached_property
    def radius(self) -> float:
        """Of the circle around it, m."""
        return 0.5 * float(np.hypot(*self.size))

    @cached_property
    def _axes(self) -> FloatArray:
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[cos, sin], [-sin, cos]])

    def grid(self) -> FloatArray:
        """Points that cover the rectangle, about 1.5 m apart; (N, 2)."""
        covering: FloatArray = _grid(self.size) @ self._axes + self.xy
        return covering

    def contains(self, points: FloatArray, room: float) -> bool:
        """Whether any point lies in the rectangle grown by `room` m."""
        x, y = self._axes @ (points - self.xy).T
        length, width = self.size
        return bool(((np.abs(x) < 0.5 * length + room) & (np.abs(y) < 0.5 * width + room)).any())


@lru_cache(64)
def _grid(size: tuple[float, float]) -> FloatArray:
    """Points about 1.5 m apart that cover a rectangle around the origin; (N, 2), read-only."""
    x, y = (s * np.linspace(-0.5, 0.5, max(3, int(s / 1.5))) for s in size)
    grid = np.stack([np.repeat(x, len(y)), np.tile(y, len(x))], axis=1)
    grid.flags.writeable = False
    return grid
