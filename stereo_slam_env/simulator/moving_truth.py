"""Truth about moving bodies of many rows: where they are, how they move, and which measurements are of them."""

from __future__ import annotations

import math

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray
from filters.kernels.compilation import entry
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT
from stereo_slam_env.simulator.scene_arrays import is_present
from stereo_slam_env.simulator.state import Fleet, Sensed
from stereo_slam_env.world.routes import FRAME_PERIOD


def bodies_now(fleet: Fleet, most: int, rows: slice = slice(None)) -> FloatArray:
    """Kind, pose and velocity of the first `most` moving bodies of some rows, (B, most, 14).

    These are the code of the kind, position (3) and orientation (4, xyzw) in W, and linear and angular velocity in W
    over the last step, as in `BodyTruth`; 0 where there is none, or where it has come or gone in this step.
    """
    numbers = np.arange(len(fleet.step))[rows]
    bodies = np.zeros((len(numbers), most, 14))
    _put_bodies(fleet, numbers, bodies)
    return bodies


@entry
def _put_bodies(fleet: Fleet, rows: IntArray, bodies: FloatArray) -> None:
    for k in range(len(rows)):
        b = rows[k]
        before, step = max(fleet.step[b] - 1, 0), fleet.step[b]
        for m in range(min(fleet.sizes[b, 2], bodies.shape[1])):
            body, last = bodies[k, m], fleet.shares[b, m, 2] - 1
            if not is_present(fleet, b, m) or fleet.shares[b, m, 6] == 0:
                continue
            now, track = fleet.tracks[b, m, min(step, last)], fleet.tracks[b, m]
            start, end = track[min(before, last)], track[min(before + 1, last)]
            turned = math.atan2(start[3] * end[4] - start[4] * end[3], start[3] * end[3] + start[4] * end[4])
            half = 0.5 * math.atan2(now[4], now[3])
            cos, sin = 0.5 * math.cos(half), 0.5 * math.sin(half)
            body[0] = fleet.shares[b, m, 6]
            body[1], body[2], body[3] = -now[1], CAMERA_HEIGHT - now[2], now[0]
            body[4], body[5], body[6], body[7] = cos - sin, -cos - sin, cos + sin, cos - sin
            for axis, sign, of_scene in ((8, -1.0, 1), (9, -1.0, 2), (10, 1.0, 0)):
                body[axis] = sign * (end[of_scene] - start[of_scene]) / FRAME_PERIOD
            body[12] = -turned / FRAME_PERIOD


def bodies_of_measurements(fleet: Fleet, sensed: Sensed, rows: slice = slice(None)) -> IntArray:
    """Number of the moving body that each measurement is of, -1 of those that stand and of padding; (B, N)."""
    place = sensed.ids[rows] - fleet.sizes[rows, :1]
    labels = np.full(place.shape, -1)
    b, k = np.nonzero(place >= 0)
    labels[b, k] = fleet.surface[rows][b, place[b, k], 6]
    return labels
