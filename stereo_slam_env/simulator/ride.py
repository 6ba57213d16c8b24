"""Smooth ride of a camera on a car, with suspension and an uneven road, and what an IMU on it measures.

The car of the steps has a constant velocity within each, and impulses between them. The camera follows it: linear and
angular velocity pass a critically damped low-pass of second order, exactly integrated; the body pitches and rolls on
its springs with the accelerations; the road adds height, pitch and roll that depend on the distance. Velocity and
acceleration of the camera are continuous.
"""

from __future__ import annotations

import math

from filters.geometry.arrays import FloatArray
from filters.geometry.rotations import Nine, Three
from filters.kernels.compilation import kernel
from stereo_slam_env.simulator.motion import (
    back,
    matrix_of,
    product_of,
    quaternion_of,
    rotation_of,
    times,
    turn_between,
)
from stereo_slam_env.simulator.state import RIDE_STEPS, RIDE_WAVES, Fleet, Rules, Sensed

_BANDWIDTH = 30.0
"""Of the low-pass, rad/s: the camera follows 67 ms behind the car of the steps."""
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
