"""Layout of things off the roads and clear of each other, and landmarks on their surfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.world.props import Placed
from stereo_slam_env.world.road import RoadNetwork
from stereo_slam_env.world.scene import Primitive, table_of

Make = Callable[[Placed], list[Primitive]]
"""Builds a thing at a place."""


class Layout:
    """Puts things where there is room beside the roads of a network."""

    def __init__(self, network: RoadNetwork) -> None:
        from stereo_slam_env.world import compiled

        self._claim = compiled.claim
        self._network = network
        self.primitives: list[Primitive] = []
        self._footprints = np.zeros((64, compiled.RADIUS + 1))
        """A rectangle on the ground of each thing, with room for more."""
        self._count = 0

    def claim(
        self, xy: FloatArray, yaw: float, size: tuple[float, float], room: float, clearance: float, make: Make
    ) -> bool:
        """Build if the footprint is `clearance` m off every centreline and free; return whether it was."""
        if self._count == len(self._footprints):
            self._footprints = np.concatenate([self._footprints, np.zeros_like(self._footprints)])
        place = (float(xy[0]), float(xy[1]), float(yaw))
        roads = self._network
        free: bool = self._claim(
            roads.points, roads.circles, self._footprints, self._count,
            place, (float(size[0]), float(size[1])), float(room), float(clearance),
        )  # fmt: skip
        if free:
            self._count += 1
            self.primitives += make(Placed(xy, yaw))
        return free


def facing_points(
    shapes: Sequence[Primitive],
    count: int,
    highest: float,
    network: RoadNetwork,
    rng: np.random.Generator,
) -> FloatArray:
    """`count` points (fewer on few shapes) below `highest` m that face the nearest road of a network."""
    from stereo_slam_env.world import compiled

    if not len(shapes):
        return np.zeros((0, 3))
    table = table_of(shapes)
    weights = compiled.sampling_weights(table)
    counts = np.ceil(6 * count * weights / weights.sum()).astype(np.int64)
    candidates = compiled.sample_facing(table, counts, network.points, network.circles, *network.cells, highest, rng)
    chosen: FloatArray = candidates[rng.permutation(len(candidates))[:count]]
    return chosen
