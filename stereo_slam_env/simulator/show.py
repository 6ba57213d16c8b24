"""Observations of the rows in single precision, and the truth, in arrays of their own."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from filters.geometry.arrays import FloatArray, IntArray
from filters.kernels.compilation import entry
from stereo_slam_env.simulator.motion import LOOK_AHEAD, route_ahead, route_of
from stereo_slam_env.simulator.state import ARENA, Fleet, Rules, Sensed

MAX_VELOCITY: FloatArray = np.repeat([50.0, 10.0], 3)
"""Bounds of the odometry in the observation, m/s and rad/s."""
MAX_VELOCITY.flags.writeable = False
Singles = NDArray[np.float32]


class Shown(NamedTuple):
    """A frame of B rows, with new arrays."""

    uvd: Singles
    """(B, N, 3), 0 in padding."""
    mask: NDArray[np.int8]
    ids: IntArray
    odometry: Singles
    progress: Singles
    car: Singles
    route: Singles
    head: Singles
    position: FloatArray
    orientation: FloatArray
    linear_velocity: FloatArray
    angular_velocity: FloatArray
    v_right: FloatArray
    time: FloatArray


def show(rules: Rules, fleet: Fleet, sensed: Sensed) -> Shown:
    """What all rows show now."""
    count, most, single = len(fleet.step), rules.most, np.float32
    shown = Shown(
        uvd=np.empty((count, most, 3), dtype=single),
        mask=np.empty((count, most), dtype=np.int8),
        ids=np.empty((count, most), dtype=np.int64),
        odometry=np.empty((count, 6), dtype=single),
        progress=np.empty((count, 1), dtype=single),
        car=np.empty((count, 2), dtype=single),
        route=np.empty((count, len(LOOK_AHEAD), 2), dtype=single),
        head=np.empty((count, 2), dtype=single),
        position=np.empty((count, 3)),
        orientation=np.empty((count, 4)),
        linear_velocity=np.empty((count, 3)),
        angular_velocity=np.empty((count, 3)),
        v_right=np.empty((count, most)),
        time=np.empty(count),
    )
    _show(rules, fleet, sensed, shown)
    return shown


@entry
def _show(rules: Rules, fleet: Fleet, sensed: Sensed, shown: Shown) -> None:
    most = rules.most
    for b in range(len(fleet.step)):
        count, pose, velocity = sensed.number[b], fleet.pose[b], fleet.velocity[b]
        for k in range(most):
            there = k < count
            shown.mask[b, k] = 1 if there else 0
            shown.ids[b, k] = sensed.ids[b, k] if there else -1
            shown.v_right[b, k] = sensed.v_right[b, k] if there else 0.0
            for a in range(3):
                shown.uvd[b, k, a] = sensed.uvd[b, k, a] if there else 0.0
        for i in range(6):
            limit = MAX_VELOCITY[i]
            shown.odometry[b, i] = min(max(sensed.odometry[b, i], -limit), limit)
        positions, arc_length = route_of(fleet, b)
        shown.progress[b, 0] = fleet.farthest[b] / arc_length[-1]
        for i in range(2):
            shown.car[b, i], shown.head[b, i] = fleet.car[b, i], fleet.angles[b, i]
        if rules.steered:
            route_ahead(positions, arc_length, fleet.nearest[b], fleet.body[b], ARENA, shown.route[b])
        for i in range(3):
            shown.position[b, i], shown.linear_velocity[b, i] = pose[i], velocity[i]
            shown.angular_velocity[b, i] = velocity[3 + i]
        for i in range(4):
            shown.orientation[b, i] = pose[3 + i]
        shown.time[b] = fleet.step[b] * rules.dt
