"""Kernels of moving bodies: where they are, what they hide, and whether the car touches them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.rotations import Nine, Three
from filters.kernels.compilation import kernel
from stereo_slam_env.simulator.contacts import touches
from stereo_slam_env.simulator.rays import COLUMNS, KIND, TRIANGLE, hits, solid_rows, way_to
from stereo_slam_env.simulator.state import Fleet
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.world.scene import BOX, CYLINDER, MovingBody


class Traffic(NamedTuple):
    """Moving bodies as arrays, see `Fleet`."""

    tracks: FloatArray
    shares: IntArray
    balls: FloatArray
    parts: FloatArray


def traffic_arrays(bodies: Sequence[MovingBody]) -> Traffic:
    """Bodies frame by frame, until all of them are at rest."""
    frames = [int(np.ceil(body.times[-1] / FRAME_PERIOD)) + 1 for body in bodies]
    tracks, shares = np.zeros((len(bodies), max(frames, default=0), 5)), np.zeros((len(bodies), 3), dtype=np.int64)
    balls = np.zeros((len(bodies), 7))
    parts: list[FloatArray] = []
    for m, body in enumerate(bodies):
        times = np.arange(frames[m]) * FRAME_PERIOD
        for axis in range(3):
            tracks[m, : frames[m], axis] = np.interp(times, body.times, body.positions[:, axis])
        yaws = np.interp(times, body.times, body.yaws)
        tracks[m, : frames[m], 3], tracks[m, : frames[m], 4] = np.cos(yaws), np.sin(yaws)
        rows = solid_rows(part for part in body.parts if part.solid)
        first = sum(len(part) for part in parts)
        parts.append(rows)
        shares[m] = first, first + len(rows), frames[m]
        balls[m, :4] = _ball_around(rows)
    return Traffic(tracks, shares, balls, np.concatenate(parts) if parts else np.zeros((0, COLUMNS)))


def _ball_around(rows: FloatArray) -> FloatArray:
    """Centre and radius of a ball that holds solids."""
    if not len(rows):
        return np.zeros(4)
    reaches = np.empty(len(rows))
    for i, row in enumerate(rows):
        if row[KIND] == BOX:
            reaches[i] = np.linalg.norm(row[3:6])
        elif row[KIND] == CYLINDER:
            reaches[i] = np.hypot(row[6], row[7])
        elif row[KIND] == TRIANGLE:
            reaches[i] = max(np.linalg.norm(row[3:6]), np.linalg.norm(row[6:9]))
        else:
            reaches[i] = row[6]
    middle = 0.5 * ((rows[:, :3] - reaches[:, None]).min(axis=0) + (rows[:, :3] + reaches[:, None]).max(axis=0))
    radius = (np.linalg.norm(rows[:, :3] - middle, axis=1) + reaches).max()
    return np.append(middle, radius + 1e-3)


@kernel
def move_bodies(fleet: Fleet, b: int) -> None:
    """Put the moving bodies of a row where they are in this frame."""
    for m in range(fleet.sizes[b, 2]):
        first, last, frames = fleet.shares[b, m]
        at = fleet.tracks[b, m, min(fleet.step[b], frames - 1)]
        cos, sin, ball = at[3], at[4], fleet.balls[b, m]
        ball[4] = at[0] + cos * ball[0] - sin * ball[1]
        ball[5] = at[1] + sin * ball[0] + cos * ball[1]
        ball[6] = at[2] + ball[2]
        for p in range(first, last):
            part, now = fleet.parts[b, p], fleet.parts_now[b, p]
            now[:] = part
            _turn(part, now, 0, cos, sin)
            now[0], now[1], now[2] = at[0] + now[0], at[1] + now[1], at[2] + now[2]
            if part[KIND] == BOX:
                now[6], now[7] = cos * part[6] - sin * part[7], sin * part[6] + cos * part[7]
            elif part[KIND] == CYLINDER:
                _turn(part, now, 3, cos, sin)
            elif part[KIND] == TRIANGLE:
                _turn(part, now, 3, cos, sin)
                _turn(part, now, 6, cos, sin)


@kernel
def _turn(part: FloatArray, now: FloatArray, first: int, cos: float, sin: float) -> None:
    """Turn the vector that begins in a column about z."""
    x, y = part[first], part[first + 1]
    now[first], now[first + 1] = cos * x - sin * y, sin * x + cos * y


@kernel
def _passes(ball: FloatArray, at: Three, way: Three) -> bool:
    """Whether a ray comes into the ball around a body."""
    x, y, z = ball[4] - at[0], ball[5] - at[1], ball[6] - at[2]
    square = way[0] * way[0] + way[1] * way[1] + way[2] * way[2]
    share = min(max((x * way[0] + y * way[1] + z * way[2]) / square, 0.0), 1.0) if square > 0.0 else 0.0
    x, y, z = x - share * way[0], y - share * way[1], z - share * way[2]
    return x * x + y * y + z * z <= ball[3] * ball[3]


class Bodies(NamedTuple):
    """The moving bodies of a row as they are in this frame, see `Fleet`."""

    number: int
    balls: FloatArray
    shares: IntArray
    parts: FloatArray


@kernel
def bodies_of(fleet: Fleet, b: int) -> Bodies:
    """The moving bodies of a row."""
    return Bodies(fleet.sizes[b, 2], fleet.balls[b], fleet.shares[b], fleet.parts_now[b])


@kernel
def is_behind_body(bodies: Bodies, left: Three, right: Three, to: Three) -> bool:
    """Whether a moving body is between one of two cameras and a point on a surface."""
    for camera in (left, right):
        way = way_to(camera, to)
        for m in range(bodies.number):
            if _passes(bodies.balls[m], camera, way):
                for p in range(bodies.shares[m, 0], bodies.shares[m, 1]):
                    if hits(bodies.parts[p], camera, way):
                        return True
    return False


@kernel
def touches_body(bodies: Bodies, R: Nine, at: Three, half: Three) -> bool:
    """Whether a box at a pose touches a moving body."""
    reach = math.sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2])
    for m in range(bodies.number):
        ball = bodies.balls[m]
        x, y, z = ball[4] - at[0], ball[5] - at[1], ball[6] - at[2]
        if x * x + y * y + z * z <= (ball[3] + reach) ** 2:
            for p in range(bodies.shares[m, 0], bodies.shares[m, 1]):
                if touches(bodies.parts[p], R, at, half):
                    return True
    return False
