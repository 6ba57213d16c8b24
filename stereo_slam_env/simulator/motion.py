"""Kernels of the motion: scripted drive, steered car, head, Eq. 6 in plain numbers, and the smooth ride of a camera.

The car of the steps has a constant velocity within each, and impulses between them. The camera follows it: linear and
angular velocity pass a critically damped low-pass of second order, exactly integrated; the body pitches and rolls on
its springs with the accelerations; the road adds height, pitch and roll that depend on the distance. Velocity and
acceleration of the camera are continuous.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.rotations import Four, Nine, Three
from filters.kernels.compilation import entry, kernel
from stereo_slam_env.simulator.state import RIDE_STEPS, RIDE_WAVES, Fleet, Rules, Sensed

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
    """Turn from A to B: Log(A^T B)."""
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
_REACH = 30.0  # m along the route, within which the next nearest frame is


@entry
def nearest_frames(positions: FloatArray, arc_length: FloatArray, places: FloatArray, around: IntArray) -> IntArray:
    """`nearest_frame` of places (B, 3) in W, each around its own; (B,)."""
    frames_found = np.empty(len(places), dtype=np.int64)
    for b in range(len(places)):
        frames_found[b] = nearest_frame(positions, arc_length, places[b, 0], places[b, 2], around[b])
    return frames_found


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
    """Mean velocity of a step of the kinematic bicycle, whose state is `car` (6,), see `Fleet.car`."""
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
    along, across = (car[0] - before) / dt, distance * turn / (dt * dt)
    car[3], car[4], car[5] = along, across, ((along - car[3]) ** 2 + (across - car[4]) ** 2) / (dt * dt)


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


_BANDWIDTH = 30.0  # of the low-pass, rad/s: the camera follows 67 ms behind the car of the steps
_PULL = 0.5
"""1/s, towards the orientation of the car: rotations that are smoothed one by one do not add up to the same."""
_SUSPENSION, _STIFFNESS, _DAMPING = 0.007, 60.0, 7.0
"""Pitch and roll of the body, rad per m/s^2, and its springs: 1.2 Hz, damped by .45."""
_AMPLITUDES = (0.02, 0.008, 0.003, 2e-3, 2e-3, 2e-3, 2e-3)
"""Of the road's waves: height, m; pitch and roll, rad. After the suspension, as of class B of ISO 8608."""
_WAVES = (0.125, 0.375, 1.1, 0.5, 1.1, 0.5, 1.1)
"""Wave numbers of those waves along the way, rad/m."""
_GRAVITY = 9.81
_V, _A, _W, _ALPHA, _LEAN, _RATE, _WAY, _POSE, _PHASES = 0, 3, 6, 9, 12, 14, 16, 17, 24
"""Columns of `Fleet.ride`: linear velocity and acceleration, W; angular ones; pitch and roll and their rates; distance;
pose without springs and road; phases of the road."""


@kernel
def _road(rules: Rules, ride: FloatArray, first: int, last: int) -> tuple[float, float]:
    """Sum of some of the road's waves, 0 at the start, and its derivative by the distance."""
    value, slope = 0.0, 0.0
    for i in range(first, last):
        angle, phase = _WAVES[i] * ride[_WAY], ride[_PHASES + i]
        value += _AMPLITUDES[i] * (math.sin(angle + phase) - math.sin(phase))
        slope += _AMPLITUDES[i] * _WAVES[i] * math.cos(angle + phase)
    return rules.roughness * value, rules.roughness * slope


@kernel
def _camera(rules: Rules, ride: FloatArray, pose: FloatArray, velocity: FloatArray) -> None:
    """Pose (7,) and velocity (6,) of the camera: linear in W, angular in the camera frame."""
    speed = math.hypot(ride[_V], ride[_V + 2])
    (y, dy), (p, dp), (r, dr) = _road(rules, ride, 0, 3), _road(rules, ride, 3, 5), _road(rules, ride, 5, RIDE_WAVES)
    pitch, roll = 0.5 * (ride[_LEAN] + p), 0.5 * (ride[_LEAN + 1] + r)
    lean = product_of(math.sin(pitch), 0.0, 0.0, math.cos(pitch), 0.0, 0.0, math.sin(roll), math.cos(roll))
    for i in range(3):
        pose[i], velocity[i] = ride[_POSE + i], ride[_V + i]
    pose[1] += y
    velocity[1] += dy * speed
    q = product_of(ride[_POSE + 3], ride[_POSE + 4], ride[_POSE + 5], ride[_POSE + 6], *lean)
    pose[3], pose[4], pose[5], pose[6] = q
    w0, w1, w2 = back(matrix_of(*lean), ride[_W], ride[_W + 1], ride[_W + 2])
    pitching, cos, sin = ride[_RATE] + dp * speed, math.cos(2.0 * roll), math.sin(2.0 * roll)
    velocity[3], velocity[4] = w0 + cos * pitching, w1 - sin * pitching
    velocity[5] = w2 + ride[_RATE + 1] + dr * speed


@kernel
def _follow(ride: FloatArray, first: int, target: Three, h: float) -> Three:
    """Let a velocity and its derivative follow a constant one for h seconds; its integral over them."""
    k = _BANDWIDTH
    fading = math.exp(-k * h)
    sum0, sum1, sum2 = 0.0, 0.0, 0.0
    for i in range(3):
        e, de = ride[first + i] - target[i], ride[first + 3 + i]
        c = de + k * e
        ride[first + i], ride[first + 3 + i] = target[i] + (e + c * h) * fading, (de - k * c * h) * fading
        total = h * target[i] + e * (1.0 - fading) / k + c * (1.0 - fading * (1.0 + k * h)) / (k * k)
        if i == 0:
            sum0 = total
        elif i == 1:
            sum1 = total
        else:
            sum2 = total
    return sum0, sum1, sum2


@kernel
def begin_ride(rules: Rules, fleet: Fleet, b: int, stream: int) -> None:
    """The first state of an episode: the velocity of the car, and a road of its own."""
    ride, velocity, used = fleet.ride[b], fleet.velocity[b], fleet.used[b, stream]
    ride[:] = 0.0
    ride[_POSE + 6] = 1.0
    for i in range(3):
        ride[_V + i], ride[_W + i] = velocity[i], velocity[3 + i]
    for i in range(RIDE_WAVES):  # wrapped, normal numbers of such a width are uniform
        ride[_PHASES + i] = 2.0 * math.pi * fleet.normals[b, stream, used + i]
    fleet.used[b, stream] = used + RIDE_WAVES
    _camera(rules, ride, fleet.pose[b], velocity)


@kernel
def ride_step(rules: Rules, fleet: Fleet, sensed: Sensed, b: int, before: FloatArray, now: FloatArray) -> None:
    """Let the camera follow the car, whose velocity of the step is in `fleet.velocity`, which becomes the camera's.

    `before` and `now` are room for two poses and velocities (13,); `now` is that of the end, with its velocity. Writes
    the exact means of angular rates and specific forces, in the frame of the unit, into `sensed.inertial`.
    """
    ride, pose, velocity = fleet.ride[b], fleet.pose[b], fleet.velocity[b]
    h, C, arm = rules.dt / RIDE_STEPS, rules.imu_turn, rules.imu_place
    linear = (velocity[0], velocity[1], velocity[2])
    tilt0, tilt1, tilt2 = turn_between(rotation_of(ride[_POSE : _POSE + 7]), rotation_of(fleet.body[b]))
    angular = (velocity[3] + _PULL * tilt0, velocity[4] + _PULL * tilt1, velocity[5] + _PULL * tilt2)
    _camera(rules, ride, now[:7], now[7:])
    first, x, y, z = rotation_of(now[:7]), now[0], now[1], now[2]
    for k in range(RIDE_STEPS):
        before[:] = now
        speed = math.hypot(ride[_V], ride[_V + 2])
        level = rotation_of(ride[_POSE : _POSE + 7])
        across, _, along = back(level, ride[_A], ride[_A + 1], ride[_A + 2])
        for i in range(2):
            force = _STIFFNESS * ((_SUSPENSION * along if i == 0 else -_SUSPENSION * across) - ride[_LEAN + i])
            force -= _DAMPING * ride[_RATE + i]
            ride[_LEAN + i] += h * ride[_RATE + i] + 0.5 * h * h * force
            ride[_RATE + i] += h * force
        way, turn = _follow(ride, _V, linear, h), quaternion_of(*_follow(ride, _W, angular, h))
        for i in range(3):
            ride[_POSE + i] += way[i]
        q = product_of(ride[_POSE + 3], ride[_POSE + 4], ride[_POSE + 5], ride[_POSE + 6], *turn)
        ride[_POSE + 3], ride[_POSE + 4], ride[_POSE + 5], ride[_POSE + 6] = q
        ride[_WAY] += 0.5 * h * (speed + math.hypot(ride[_V], ride[_V + 2]))
        _camera(rules, ride, now[:7], now[7:])
        _means(C, arm, h, before, now, sensed.inertial[b, k])
    pose[:] = now[:7]
    turn0, turn1, turn2 = turn_between(first, rotation_of(pose))
    velocity[0], velocity[1], velocity[2] = (pose[0] - x) / rules.dt, (pose[1] - y) / rules.dt, (pose[2] - z) / rules.dt
    velocity[3], velocity[4], velocity[5] = turn0 / rules.dt, turn1 / rules.dt, turn2 / rules.dt


@kernel
def _means(C: Nine, arm: Three, h: float, before: FloatArray, now: FloatArray, means: FloatArray) -> None:
    """Mean angular rate, and mean specific force at the unit in its middle attitude, between two poses; (6,)."""
    A, B = rotation_of(before[:7]), rotation_of(now[:7])
    turn0, turn1, turn2 = turn_between(A, B)
    means[0], means[1], means[2] = back(C, turn0 / h, turn1 / h, turn2 / h)
    gained0, gained1, gained2 = _at_arm(B, now, arm)
    had0, had1, had2 = _at_arm(A, before, arm)
    half = quaternion_of(0.5 * turn0, 0.5 * turn1, 0.5 * turn2)
    middle = matrix_of(*product_of(before[3], before[4], before[5], before[6], *half))
    force = back(middle, (gained0 - had0) / h, (gained1 - had1) / h - _GRAVITY, (gained2 - had2) / h)
    means[3], means[4], means[5] = back(C, *force)


@kernel
def _at_arm(R: Nine, at: FloatArray, arm: Three) -> Three:
    """Velocity in W of a point of the camera frame."""
    w0, w1, w2 = at[10], at[11], at[12]
    x, y, z = times(R, w1 * arm[2] - w2 * arm[1], w2 * arm[0] - w0 * arm[2], w0 * arm[1] - w1 * arm[0])
    return at[7] + x, at[8] + y, at[9] + z
