"""The kernel of a frame: environments move, measure and are judged, one after the other without Python in between."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from filters.validation import FloatArray, IntArray
from stereo_slam_env.vector.motion import (
    MOTION,
    measure_odometry,
    move,
    nearest_frame,
    rotation_of,
    route_velocity,
    times,
)
from stereo_slam_env.vector.sensing import observe
from stereo_slam_env.vector.state import Fleet, Outcome, Rules
from stereo_slam_env.world.collisions import collides
from stereo_slam_env.world.rays import KERNEL, OPTIONS

WAIT, FIRST, STEP = 0, 1, 2
"""What an environment does in a frame: nothing, the first frame of an episode, or a step."""


@njit(**KERNEL)
def _begin(rules: Rules, fleet: Fleet, b: int) -> None:
    """The first pose and velocity of an episode."""
    body, velocity = fleet.body[b], fleet.velocity[b]
    body[:], velocity[:], fleet.angles[b, :] = 0.0, 0.0, 0.0
    body[6] = 1.0
    fleet.pose[b, :] = body
    fleet.step[b], fleet.nearest[b], fleet.farthest[b], fleet.distance[b] = 0, 0, 0.0, 0.0
    fleet.lost[b, :] = False
    if rules.steered:
        fleet.car[b, 0], fleet.car[b, 1], fleet.car[b, 2] = rules.speeds[0], 0.0, 0.0
        velocity[2] = rules.speeds[0]
        return
    used = fleet.used[b, MOTION]
    for i in range(6):
        fleet.sway[b, i] = rules.sway[0, i] * fleet.normals[b, MOTION, used + i]
    fleet.used[b, MOTION] = used + 6
    route_velocity(rules, body, fleet.sway[b], 0, velocity)


@njit(**KERNEL)
def _judge(rules: Rules, fleet: Fleet, out: Outcome, waiting: IntArray, b: int, before: tuple[float, float]) -> None:
    """Terms of the reward of a step that began with pan and tilt `before`."""
    body, terms = fleet.body[b], out.terms[b]
    nearest = nearest_frame(rules, body[0], body[2], fleet.nearest[b])
    fleet.nearest[b] = nearest
    advanced = max(0.0, rules.arc_length[nearest] - fleet.farthest[b])
    fleet.farthest[b] += advanced
    R = rotation_of(body)
    centre, half = rules.body[1], rules.body[0]
    o0, o1, o2 = times(R, centre[0], centre[1], centre[2])
    x, y, z = body[0] + o0, body[1] + o1, body[2] + o2
    # Columns of R_sb: the axes of the body (forward, left, up) are z, -x and -y of the camera; rows are those of S.
    R_sb = (R[8], -R[6], -R[7], -R[2], R[0], R[1], -R[5], R[3], R[4])
    at = (z, -x, rules.camera_height - y)
    solids, bounds, links, nodes = fleet.solids[b], fleet.bounds[b], fleet.links[b], fleet.sizes[b, 1]
    collision = collides(solids, bounds, links, nodes, waiting, R_sb, at, (half[0], half[1], half[2]))
    p = rules.positions[nearest]
    away = math.sqrt((p[0] - body[0]) ** 2 + (p[1] - body[1]) ** 2 + (p[2] - body[2]) ** 2) > rules.arena
    failed = collision or away
    last = nearest == len(rules.arc_length) - 1 if rules.steered else fleet.step[b] >= len(rules.speeds)
    out.collision[b], out.failed[b], out.success[b] = collision, failed, last and not failed
    terms[0], terms[1] = advanced, advanced * (out.seen[b] / rules.most)
    terms[2], terms[3], terms[4] = -1.0 * failed, 1.0 * out.success[b], -rules.dt
    if rules.has_head:
        pan = (fleet.angles[b, 0] - before[0]) / (rules.head[1, 0] * rules.dt)
        tilt = (fleet.angles[b, 1] - before[1]) / (rules.head[1, 1] * rules.dt)
        terms[5] = -0.5 * (pan * pan + tilt * tilt)


@njit(**OPTIONS)
def run_frame(
    rules: Rules,
    fleet: Fleet,
    out: Outcome,
    waiting: IntArray,
    doing: IntArray,
    actions: FloatArray,
    first: int,
    last: int,
) -> None:
    """A frame of the environments from `first` to `last` - 1; `doing` (B,) is WAIT, FIRST or STEP."""
    most = fleet.landmarks.shape[2]
    inside, fresh, keys = np.empty(most, dtype=np.uint8), np.empty(most, dtype=np.int64), np.empty(most)
    for b in range(first, last):
        if doing[b] == WAIT:
            continue
        pose = fleet.pose[b]
        out.terms[b, :], out.collision[b], out.failed[b], out.success[b] = 0.0, False, False, False
        if doing[b] == FIRST:
            _begin(rules, fleet, b)
            out.seen[b] = 0
        q0, q1, q2, q3 = pose[3], pose[4], pose[5], pose[6]
        before = (fleet.angles[b, 0], fleet.angles[b, 1])
        if doing[b] == STEP:
            move(rules, fleet, b, actions[b])
        measure_odometry(rules, fleet, b, q0, q1, q2, q3, out.odometry[b])
        observe(rules, fleet, out, waiting, b, inside, fresh, keys)
        if doing[b] == STEP:
            _judge(rules, fleet, out, waiting, b, before)
