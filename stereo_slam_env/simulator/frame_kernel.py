"""The kernel of a frame: rows move, measure and are judged, one after the other without Python in between."""

from __future__ import annotations

import math

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray
from filters.kernels.compilation import entry, kernel
from stereo_slam_env.simulator.contacts import collides
from stereo_slam_env.simulator.motion import (
    MOTION,
    ODOMETRY,
    begin_ride,
    measure_odometry,
    move,
    nearest_frame,
    ride_step,
    rotation_of,
    route_of,
    route_velocity,
    times,
)
from stereo_slam_env.simulator.scene_arrays import bodies_of, move_bodies, move_landmarks, touches_body
from stereo_slam_env.simulator.sensing import hide_far_sides, mark_in_view, observe
from stereo_slam_env.simulator.state import ARENA, Fleet, Rules, Sensed

WAIT, FIRST, STEP = 0, 1, 2
"""What a row does in a frame: nothing, the first frame of an episode, or a step."""
MOVE, SENSE, JUDGE = 1, 2, 4
"""Parts of a frame, which may be asked for one by one: what is between them is then somebody else's."""
_JERK = 10.0
"""A jerk that costs its weight a second, m/s^3: that of an emergency braking."""


@kernel
def _begin(rules: Rules, fleet: Fleet, b: int) -> None:
    """The first pose and velocity of an episode."""
    body, velocity = fleet.body[b], fleet.velocity[b]
    body[:], velocity[:], fleet.angles[b, :], fleet.turned[b, :] = 0.0, 0.0, 0.0, 0.0
    body[6] = 1.0
    fleet.pose[b, :] = body
    fleet.step[b], fleet.nearest[b], fleet.farthest[b], fleet.distance[b] = 0, 0, 0.0, 0.0
    fleet.lost[b, :], fleet.measured_at[b, :] = False, -1
    if rules.steered:
        fleet.car[b, :] = 0.0
        fleet.car[b, 0] = fleet.speeds[b, 0]
        velocity[2] = fleet.speeds[b, 0]
    else:
        used = fleet.used[b, MOTION]
        for i in range(6):
            fleet.sway[b, i] = rules.sway[0, i] * fleet.normals[b, MOTION, used + i]
        fleet.used[b, MOTION] = used + 6
        route_velocity(rules, fleet, b, 0)
    if rules.smooth:
        begin_ride(rules, fleet, b, ODOMETRY)  # the car stays that of the steps


@kernel
def _touches(rules: Rules, fleet: Fleet, waiting: IntArray, b: int) -> bool:
    """Whether the body of the car touches something; the ground is nothing."""
    if not rules.exact:
        return bool(fleet.touching[b])
    body = fleet.body[b]
    R = rotation_of(body)
    centre, half = rules.body[1], (rules.body[0, 0], rules.body[0, 1], rules.body[0, 2])
    o0, o1, o2 = times(R, centre[0], centre[1], centre[2])
    x, y, z = body[0] + o0, body[1] + o1, body[2] + o2
    # Columns of R_sb: the axes of the body (forward, left, up) are z, -x and -y of the camera; rows are those of S.
    R_sb = (R[8], -R[6], -R[7], -R[2], R[0], R[1], -R[5], R[3], R[4])
    at = (z, -x, rules.camera_height - y)
    solids, bounds, links, nodes = fleet.solids[b], fleet.bounds[b], fleet.links[b], fleet.sizes[b, 1]
    return collides(solids, bounds, links, nodes, waiting, R_sb, at, half) or touches_body(
        bodies_of(fleet, b), R_sb, at, half
    )


@kernel
def _judge(rules: Rules, fleet: Fleet, sensed: Sensed, waiting: IntArray, b: int) -> None:
    """Terms of the reward of a step, and whether it was the last one."""
    body, terms = fleet.body[b], sensed.terms
    positions, arc_length = route_of(fleet, b)
    nearest, end = nearest_frame(positions, arc_length, body[0], body[2], fleet.nearest[b]), len(arc_length) - 1
    fleet.nearest[b] = nearest
    advanced = max(0.0, arc_length[nearest] - fleet.farthest[b])
    fleet.farthest[b] += advanced
    collision = _touches(rules, fleet, waiting, b)
    x, y, z = body[0] - positions[nearest, 0], body[1] - positions[nearest, 1], body[2] - positions[nearest, 2]
    failed = collision or math.sqrt(x * x + y * y + z * z) > ARENA
    paid = advanced
    if rules.steered:
        R = fleet.attitudes[b, nearest]
        beside = abs(R[0] * x + R[3] * y + R[6] * z)
        sensed.beside[b] = beside
        is_late = fleet.step[b] * rules.dt * rules.slowest > arc_length[end]
        failed = failed or beside > rules.lane or is_late
        paid *= max(1.0 - (beside / rules.lane) ** 2, 0.0)
    last = nearest == end if rules.steered else fleet.step[b] >= end
    sensed.collision[b], sensed.failed[b], sensed.success[b] = collision, failed, last and not failed
    terms[0, b], terms[1, b] = paid, paid * ((sensed.number[b] - sensed.moving[b]) / rules.most)
    terms[2, b], terms[3, b], terms[4, b] = -1.0 * failed, 1.0 * sensed.success[b], -rules.dt
    if rules.steered:
        terms[5, b] = -rules.dt * fleet.car[b, 5] / _JERK**2
    if rules.has_head:
        pan = fleet.turned[b, 0] / (rules.head[1, 0] * rules.dt)
        tilt = fleet.turned[b, 1] / (rules.head[1, 1] * rules.dt)
        terms[6, b] = -0.5 * (pan * pan + tilt * tilt)
    total = 0.0
    for k in range(len(terms)):
        terms[k, b] *= rules.weights[k]
        total += terms[k, b]
    sensed.reward[b] = total


@entry
def run_frame(
    rules: Rules,
    fleet: Fleet,
    sensed: Sensed,
    waiting: IntArray,
    doing: IntArray,
    actions: FloatArray,
    parts: int,
    first: int,
    last: int,
) -> None:
    """Parts of a frame of the rows from `first` to `last` - 1; `doing` (B,) is WAIT, FIRST or STEP."""
    most = fleet.landmarks.shape[2]
    fresh, keys, before, now = np.empty(most, dtype=np.int64), np.empty(most), np.zeros(13), np.zeros(13)
    for b in range(first, last):
        if doing[b] == WAIT:
            continue
        pose = fleet.pose[b]
        if parts & MOVE:
            sensed.terms[:, b], sensed.reward[b] = 0.0, 0.0
            sensed.collision[b], sensed.failed[b], sensed.success[b], sensed.beside[b] = False, False, False, 0.0
            if doing[b] == FIRST:
                _begin(rules, fleet, b)
                sensed.number[b], sensed.moving[b] = 0, 0
            q0, q1, q2, q3 = pose[3], pose[4], pose[5], pose[6]
            if doing[b] == STEP:
                move(rules, fleet, b, actions[b])
                if rules.smooth:
                    ride_step(rules, fleet, sensed, b, before, now)
            measure_odometry(rules, fleet, b, q0, q1, q2, q3, sensed.odometry[b])
            if rules.smooth and doing[b] == STEP:  # odometry is of the step, the truth of its end
                fleet.velocity[b, :] = now[7:]
            move_bodies(fleet, b)
            if fleet.sizes[b, 4] > 0:
                move_landmarks(fleet, b, rules.camera_height)
            mark_in_view(rules, fleet.landmarks[b], fleet.sizes[b, 0] + fleet.sizes[b, 4], pose, fleet.inside[b])
            if fleet.sizes[b, 4] > 0:
                hide_far_sides(rules, fleet, b)
        if parts & SENSE:
            observe(rules, fleet, sensed, waiting, b, fresh, keys)
        if parts & JUDGE and doing[b] == STEP:
            _judge(rules, fleet, sensed, waiting, b)
