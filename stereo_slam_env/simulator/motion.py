"""Kernels of the motion: the scripted drive, the car that is steered, the head, and Eq. 6, in plain numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.rotations import Four, Nine, Three
from filters.kernels.compilation import entry, kernel
from stereo_slam_env.simulator.state import Fleet, Rules

MOTION, ODOMETRY, NOISE, CHOICE = 0, 1, 2, 3
"""Random streams."""


def _compiled(function: Any) -> Any:
    """A function of `rotations`, compiled as the kernels here are."""
    return kernel(function.py_func)


matrix_of, quaternion_of = _compiled(rotations.matrix_of), _compiled(rotations.quaternion_of)
product_of, vector_of = _compiled(rotations.product_of), _compiled(rotations.vector_of)
from_matrix_of = _compiled(rotations.from_matrix_of)


@kernel
def times(a: Nine, x: float, y: float, z: float) -> Three:
    """Product of a 3x3 matrix with a vector."""
    return a[0] * x + a[1] * y + a[2] * z, a[3] * x + a[4] * y + a[5] * z, a[6] * x + a[7] * y + a[8] * z


@kernel
def back(a: Nine, x: float, y: float, z: float) -> Three:
    """Product of the transpose of a 3x3 matrix with a vector."""
    return a[0] * x + a[3] * y + a[6] * z, a[1] * x + a[4] * y + a[7] * z, a[2] * x + a[5] * y + a[8] * z


@kernel
def rotation_of(pose: FloatArray) -> Nine:
    """R_wc of a pose (7,), row by row."""
    return matrix_of(pose[3], pose[4], pose[5], pose[6])


@kernel
def turn_between(a: Nine, b: Nine) -> Three:
    """Log(A^T B)."""
    c0, c3, c6 = back(a, b[0], b[3], b[6])
    c1, c4, c7 = back(a, b[1], b[4], b[7])
    c2, c5, c8 = back(a, b[2], b[5], b[8])
    q = from_matrix_of(c0, c1, c2, c3, c4, c5, c6, c7, c8)
    return vector_of(q[0], q[1], q[2], q[3])


@kernel
def route_of(fleet: Fleet, b: int) -> tuple[FloatArray, FloatArray]:
    """Positions (K, 3) and arc length (K,) of the route of a row."""
    frames = fleet.sizes[b, 3]
    return fleet.positions[b, :frames], fleet.arc_length[b, :frames]


LOOK_AHEAD = (2.0, 5.0, 10.0, 20.0, 30.0)
"""Distances along the route of the points of the route in the observation, m."""
_REACH = 30.0
"""How far along the route the next nearest frame may be, m."""


@entry
def nearest_frames(positions: FloatArray, arc_length: FloatArray, places: FloatArray, around: IntArray) -> IntArray:
    """`nearest_frame` of places (B, 3) in W, each around its own; (B,)."""
    found = np.empty(len(places), dtype=np.int64)
    for b in range(len(places)):
        found[b] = nearest_frame(positions, arc_length, places[b, 0], places[b, 2], around[b])
    return found


@entry
def routes_ahead(
    positions: FloatArray, arc_length: FloatArray, nearest: IntArray, poses: FloatArray, farthest: float
) -> NDArray[np.float32]:
    """Points of the route `LOOK_AHEAD` of cameras at poses (B, 7): right and forward, m, float32; (B, 5, 2)."""
    ahead = np.empty((len(poses), len(LOOK_AHEAD), 2), dtype=np.float32)
    for b in range(len(poses)):
        route_ahead(positions, arc_length, nearest[b], poses[b], farthest, ahead[b])
    return ahead


@kernel
def route_ahead(
    positions: FloatArray,
    arc_length: FloatArray,
    nearest: int,
    pose: FloatArray,
    farthest: float,
    ahead: NDArray[np.float32],
) -> None:
    """Points of the route in front of one camera, linear between frames, within `farthest` m to either side."""
    R, k, last = rotation_of(pose), nearest, len(arc_length) - 1
    for i in range(len(LOOK_AHEAD)):
        place = arc_length[nearest] + LOOK_AHEAD[i]
        while k < last and arc_length[k + 1] <= place:
            k += 1
        share = 0.0 if k == last else (place - arc_length[k]) / (arc_length[k + 1] - arc_length[k])
        to = positions[min(k + 1, last)]
        x = positions[k, 0] + share * (to[0] - positions[k, 0]) - pose[0]
        y = positions[k, 1] + share * (to[1] - positions[k, 1]) - pose[1]
        z = positions[k, 2] + share * (to[2] - positions[k, 2]) - pose[2]
        right, _, forward = back(R, x, y, z)
        ahead[i, 0] = min(max(right, -farthest), farthest)
        ahead[i, 1] = min(max(forward, -farthest), farthest)


@kernel
def nearest_frame(positions: FloatArray, arc_length: FloatArray, x: float, z: float, around: int) -> int:
    """Frame of a route that is nearest on the ground, of those less than 30 m along the route from `around`.

    Where a route crosses or retraces itself, this is the pass.
    """
    middle, best, least = arc_length[around], around, math.inf
    first = around
    while first > 0 and arc_length[first - 1] >= middle - _REACH:
        first -= 1
    k = first
    while k < len(arc_length) and arc_length[k] <= middle + _REACH:
        away = (positions[k, 0] - x) ** 2 + (positions[k, 2] - z) ** 2
        if away < least:
            best, least = k, away
        k += 1
    return best


@kernel
def route_velocity(rules: Rules, fleet: Fleet, b: int, step: int) -> None:
    """Velocity of a scripted drive: linear in W, angular in the camera frame; see `Sway`."""
    pose, sway, velocity = fleet.body[b], fleet.sway[b], fleet.velocity[b]
    T, R = fleet.travel[b, step], rotation_of(pose)
    travel = (T[0], T[1], T[2], T[3], T[4], T[5], T[6], T[7], T[8])
    N = fleet.attitudes[b, step]
    nominal = (N[0], N[1], N[2], N[3], N[4], N[5], N[6], N[7], N[8])
    at = fleet.positions[b, step]
    off0, off1, off2 = back(travel, pose[0] - at[0], pose[1] - at[1], pose[2] - at[2])
    tilt0, tilt1, tilt2 = turn_between(nominal, R)
    turn0, turn1, turn2 = back(R, 0.0, fleet.yaw_rates[b, step], 0.0)
    pull = rules.pull
    velocity[0], velocity[1], velocity[2] = times(
        travel, sway[0] - pull * off0, sway[1] - pull * off1, fleet.speeds[b, step] + sway[2] - pull * off2
    )
    velocity[3] = turn0 + sway[3] - pull * tilt0
    velocity[4] = turn1 + sway[4] - pull * tilt1
    velocity[5] = turn2 + sway[5] - pull * tilt2


@kernel
def agent_velocity(rules: Rules, car: FloatArray, acceleration: float, steering: float, velocity: FloatArray) -> None:
    """Mean velocity of a step of the kinematic bicycle; `car` (3,) is speed, steering angle and heading."""
    wheelbase, forward, max_speed, max_acceleration, max_steering, max_rate, grip = rules.car
    dt, before = rules.dt, car[0]
    car[0] = min(max(before + acceleration * max_acceleration * dt, 0.0), max_speed)
    most = max_rate * dt
    car[1] += min(max(steering * max_steering - car[1], -most), most)
    distance = 0.5 * (before + car[0]) * dt
    turn = distance * math.tan(car[1]) / wheelbase
    if abs(turn) * distance > grip * dt * dt:  # it slides
        turn = math.copysign(grip * dt * dt / distance, turn)
    half = 0.5 * turn
    chord = distance * (math.sin(half) / half if half != 0.0 else 1.0)
    old, middle, new = car[2], car[2] + half, car[2] + turn
    velocity[0] = (chord * math.sin(middle) + forward * (math.sin(new) - math.sin(old))) / dt
    velocity[1] = 0.0
    velocity[2] = (chord * math.cos(middle) + forward * (math.cos(new) - math.cos(old))) / dt
    velocity[3], velocity[4], velocity[5] = 0.0, turn / dt, 0.0
    car[2] = new


@kernel
def advance_pose(pose: FloatArray, velocity: FloatArray, dt: float) -> None:
    """Eq. 6: r' = r + v dt, q' = q x q(omega dt)."""
    for i in range(3):
        pose[i] += velocity[i] * dt
    t = quaternion_of(velocity[3] * dt, velocity[4] * dt, velocity[5] * dt)
    pose[3], pose[4], pose[5], pose[6] = product_of(pose[3], pose[4], pose[5], pose[6], t[0], t[1], t[2], t[3])


@kernel
def head_turn(pan: float, tilt: float) -> Four:
    """Quaternion of R_y(pan) R_x(tilt)."""
    sin_pan, cos_pan = math.sin(0.5 * pan), math.cos(0.5 * pan)
    sin_tilt, cos_tilt = math.sin(0.5 * tilt), math.cos(0.5 * tilt)
    return cos_pan * sin_tilt, sin_pan * cos_tilt, -sin_pan * sin_tilt, cos_pan * cos_tilt


@kernel
def move(rules: Rules, fleet: Fleet, b: int, action: FloatArray) -> None:
    """Move the car and turn the head for a step."""
    body, pose, velocity, angles = fleet.body[b], fleet.pose[b], fleet.velocity[b], fleet.angles[b]
    if rules.steered:
        agent_velocity(rules, fleet.car[b], action[0], action[1], velocity)
    else:
        sway, used = fleet.sway[b], fleet.used[b, MOTION]
        for i in range(6):
            sway[i] = rules.sway[1, i] * sway[i] + rules.sway[2, i] * fleet.normals[b, MOTION, used + i]
        fleet.used[b, MOTION] = used + 6
        route_velocity(rules, fleet, b, fleet.step[b])
    x, y, z = body[0], body[1], body[2]
    advance_pose(body, velocity, rules.dt)
    fleet.distance[b] += math.sqrt((body[0] - x) ** 2 + (body[1] - y) ** 2 + (body[2] - z) ** 2)
    fleet.step[b] += 1
    if not rules.has_head:
        pose[:] = body
        return
    first = len(action) - 2
    for i in range(2):
        most = rules.head[1, i] * rules.dt
        before_turn = angles[i]
        angles[i] += min(max(action[first + i] * rules.head[0, i] - before_turn, -most), most)
        fleet.turned[b, i] = angles[i] - before_turn
    before, x, y, z = rotation_of(pose), pose[0], pose[1], pose[2]
    look_from(rules, body, angles, pose)
    velocity[0], velocity[1], velocity[2] = (pose[0] - x) / rules.dt, (pose[1] - y) / rules.dt, (pose[2] - z) / rules.dt
    turn0, turn1, turn2 = turn_between(before, rotation_of(pose))
    velocity[3], velocity[4], velocity[5] = turn0 / rules.dt, turn1 / rules.dt, turn2 / rules.dt


@kernel
def look_from(rules: Rules, body: FloatArray, angles: FloatArray, pose: FloatArray) -> None:
    """`Head.camera_pose`: the pose of the left camera of a turned head."""
    q, half = head_turn(angles[0], angles[1]), 0.5 * rules.camera[5]
    T = matrix_of(q[0], q[1], q[2], q[3])
    o0, o1, o2 = times(rotation_of(body), half - T[0] * half, -T[3] * half, -T[6] * half)
    pose[0], pose[1], pose[2] = body[0] + o0, body[1] + o1, body[2] + o2
    pose[3], pose[4], pose[5], pose[6] = product_of(body[3], body[4], body[5], body[6], q[0], q[1], q[2], q[3])


@kernel
def measure_odometry(
    rules: Rules, fleet: Fleet, b: int, q0: float, q1: float, q2: float, q3: float, measured: FloatArray
) -> None:
    """Mean velocity of the camera over the step that began with its orientation q, with noise.

    The linear part is in the camera frame half-way through the turn, as filters expect it.
    """
    velocity, used, half = fleet.velocity[b], fleet.used[b, ODOMETRY], 0.5 * rules.dt
    t = quaternion_of(half * velocity[3], half * velocity[4], half * velocity[5])
    A, T = matrix_of(q0, q1, q2, q3), matrix_of(t[0], t[1], t[2], t[3])
    x, y, z = back(A, velocity[0], velocity[1], velocity[2])
    x, y, z = back(T, x, y, z)
    true = (x, y, z, velocity[3], velocity[4], velocity[5])
    for i in range(6):
        measured[i] = true[i] + rules.odometry_sigmas[i] * fleet.normals[b, ODOMETRY, used + i]
    fleet.used[b, ODOMETRY] = used + 6
