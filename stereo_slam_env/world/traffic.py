"""Cars and pedestrians that move while the ego car drives by, timed so that it sees them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.world import props
from stereo_slam_env.world.meshes import body_meshes
from stereo_slam_env.world.road import LANE_OFFSET, road_along, stations_of
from stereo_slam_env.world.routes import FRAME_PERIOD, Route, pulse
from stereo_slam_env.world.scene import Box, Cylinder, Material, MovingBody, Primitive, TriangleMesh

_TALL = 1.8
"""Height of a person, m: what is above is not in the way."""


class GroundOutlines:
    """Outlines on the ground of solids lower than a person, as rectangles."""

    def __init__(self, solids: Iterable[Primitive]) -> None:
        rectangles = []
        for solid in solids:
            if isinstance(solid, Box):
                if solid.center[2] - 0.5 * solid.size[2] < _TALL:
                    rectangles.append((*solid.center[:2], solid.yaw, *solid.size[:2]))
            elif isinstance(solid, Cylinder):
                start, end = np.array(solid.start), np.array(solid.end)
                if min(start[2], end[2]) < _TALL:
                    reach = float(np.linalg.norm(end[:2] - start[:2]))
                    yaw = float(np.arctan2(end[1] - start[1], end[0] - start[0]))
                    middle = 0.5 * (start + end)
                    rectangles.append((*middle[:2], yaw, reach + 2 * solid.radius, 2 * solid.radius))
            elif isinstance(solid, TriangleMesh):
                low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
                if low[2] < _TALL:
                    rectangles.append((*(0.5 * (low + high))[:2], 0.0, *(high - low)[:2]))
            else:
                above = max(solid.center[2] - _TALL, 0.0)
                if above < solid.radius:
                    side = 2 * float(np.sqrt(solid.radius**2 - above**2))
                    rectangles.append((*solid.center[:2], 0.0, side, side))
        self._rectangles = np.array(rectangles, dtype=np.float64).reshape(-1, 5)
        self._reach = 0.5 * np.linalg.norm(self._rectangles[:, 3:], axis=1)

    def block(self, points: FloatArray, room: float) -> bool:
        """Whether any of `points` (N, 2) is inside an outline or less than `room` m from one."""
        middle = points.mean(axis=0)
        reach = np.linalg.norm(points - middle, axis=1).max() + room
        near = self._rectangles[np.linalg.norm(self._rectangles[:, :2] - middle, axis=1) < self._reach + reach]
        cos, sin = np.cos(near[:, 2]), np.sin(near[:, 2])
        x, y = np.moveaxis(points[:, None] - near[:, :2], -1, 0)
        local = np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)
        return bool((np.abs(local) < 0.5 * near[:, 3:] + room).all(axis=-1).any())


_LOG = logging.getLogger(__name__)
_AFTER = 20.0
"""Bodies go on for so long after the nominal drive, s."""
_ATTEMPTS = 80
"""How often a way is drawn for a body before it is left out."""
_EGO_CIRCLES, _EGO_RADIUS = np.array([-1.85, -0.25, 1.35]), 1.15
"""Circles around the ego car: centres along its body from the camera, m."""
_SWAY = 0.5
"""Room around the ego car beyond that: a scripted drive sways, m."""
_ROOM = 0.25
_LEADING, _STOPPING, _CROSSING = 0.4, 0.3, 0.35
"""Shares of cars that drive ahead in the lane of the ego car, of oncoming ones that stop for a while, and of
pedestrians that cross the road."""
_AHEAD, _BEHIND = 150.0, 40.0
"""How far along the road from the ego car bodies are there at all, m."""
_IN_VIEW, _LEAST_SEEN = (80.0, float(np.cos(np.radians(40.0)))), 2.0
"""A body is in view up to so far ahead and so far aside (cosine), and must be for so long, m and s."""
_OUT_OF_SIGHT = -200.0
"""Height at which a body waits before it comes and after it has gone, m."""
_TIGHT = 0.8
Bus = Literal["pulls-away", "leads", "stops-and-goes"]
BUS_LENGTH = 10.0
"""Length of a bus, m."""
_BUS = Box((0.0, 0.0, 1.7), (BUS_LENGTH, 2.5, 3.0), 0.0, Material((0.85, 0.1, 0.1)))
_BUS_GAP, _BUS_STANDS, _BUS_STARTS, _BUS_PULL = 13.0, 25.0, 0.8, 1.5
"""How far ahead of the camera a bus drives and one that pulls away stands at first, m; when it starts, s; its largest
acceleration, m/s^2."""
_BUS_BRAKES, _BUS_SPEEDS, _BUS_HOLDS, _BUS_WAITS = 2.5, (3.0, 8.0), (2.0, 5.0), (1.0, 3.0)
"""How hard a bus that stops and goes brakes, m/s^2; its speeds, m/s, and how long it holds one or stands, s."""
_BUS_FREE_GAP, _ACROSS = 20.0, 2.0
"""How far ahead of the camera it is at first, m, and its largest acceleration across the direction of travel, m/s^2."""


@dataclass(frozen=True, eq=False)
class _Way:
    """Path of a body on the road at each time (K,): station, offset to the left, turn to the road (rad)."""

    stations: FloatArray
    left: FloatArray
    turn: FloatArray


def traffic(
    route: Route,
    solids: Sequence[Primitive],
    walkway: float,
    rng: np.random.Generator,
    *,
    cars: int,
    pedestrians: int,
    bus: Bus | None = None,
) -> tuple[MovingBody, ...]:
    """Bodies that move around the nominal drive, come into its view, and never touch it or each other.

    Cars drive ahead in the same lane with a changing gap, or come along the other lane; some of these stop for a
    while. Pedestrians walk along the road, `walkway` m from its centreline and clear of the `solids`, or cross it
    ahead of the ego car. A bus in the lane ahead, the first of the bodies, leads all the time, stands there and pulls
    away, or stops and goes: the nominal drive would run into that one. Bodies without room are left out, which is
    logged. The first bodies stay the same when more are asked for.
    """
    car_rng, walker_rng = rng.spawn(2)
    cast = _Cast(route)
    if bus is not None:
        free = bus == "stops-and-goes"
        draw = partial(cast.stopping_bus, rng.spawn(1)[0]) if free else partial(cast.bus, bus)
        cast.add("bus", (_BUS,), 0.5 * _BUS.size[0], 0.5 * _BUS.size[1] + 0.1, draw, by_ego=not free)
    for own_rng in car_rng.spawn(cars):
        parts = props.vehicle(own_rng)
        long = props.length_of(parts)
        draw = partial(cast.leading, long, own_rng) if own_rng.random() < _LEADING else partial(cast.oncoming, own_rng)
        cast.add("car", parts, 0.5 * long, 1.35, draw)
    obstacles = GroundOutlines(solids)
    for own_rng in walker_rng.spawn(pedestrians):
        walk = cast.crossing if own_rng.random() < _CROSSING else cast.walking
        cast.add("pedestrian", props.pedestrian(own_rng), 0.0, 0.35, partial(walk, walkway, own_rng), obstacles)
    return tuple(cast.bodies)


class _Cast:
    """The bodies so far and where they are, so that the next one keeps clear of them and of the ego car."""

    def __init__(self, route: Route) -> None:
        self._road, self._duration = road_along(route), route.duration
        self._times = np.arange(0.0, route.duration + _AFTER, FRAME_PERIOD)
        frames = np.minimum(np.arange(len(self._times)), route.frames - 1)
        over = np.maximum(self._times - route.duration, 0.0)
        self._ego = stations_of(route, self._road)[frames] + max(float(route.speeds[-1]), 1.0) * over
        self._eyes = (route.positions[:, [2, 0]] * [1.0, -1.0])[frames]
        self._gaze = -route.headings[frames]
        self._taken = [(_circles(self._eyes, self._gaze, _EGO_CIRCLES), _EGO_RADIUS + _SWAY)]
        self.bodies: list[MovingBody] = []

    def add(
        self,
        kind: str,
        parts: tuple[Primitive, ...],
        half_length: float,
        radius: float,
        draw: Callable[[], _Way],
        obstacles: GroundOutlines | None = None,
        *,
        by_ego: bool = True,
    ) -> None:
        """Take the first of the drawn ways that is free for circles of `radius` along the body.

        Unless `by_ego`, the ego car does not drive nominally, so it need not be kept clear of, or near.
        """
        count = max(1, int(np.ceil(half_length)))
        centers = np.linspace(-1.0, 1.0, count) * max(half_length - 0.8, 0.0) if count > 1 else np.zeros(1)
        for _ in range(_ATTEMPTS):
            way = draw()
            points, yaws = self._road.along(way.stations, way.left)
            yaws = yaws + way.turn
            if obstacles is not None and obstacles.block(points[::5], radius):
                continue
            ahead = way.stations - self._ego
            here = (way.stations > 3.0) & (way.stations < self._road.length - 3.0)
            here &= ((ahead > -_BEHIND) & (ahead < _AHEAD)) | (not by_ego)
            if self._seen(points, here) < _LEAST_SEEN:
                continue
            circles = _circles(np.where(here[:, None], points, np.nan), yaws, centers)
            if any(
                _touch(circles[here], bodies[here], radius + reach + _ROOM)
                for bodies, reach in self._taken[not by_ego :]
            ):
                continue
            self._taken.append((circles, radius))
            positions = np.column_stack([points, np.where(here, 0.0, _OUT_OF_SIGHT)])
            self.bodies.append(MovingBody(kind, parts, self._times, positions, yaws))
            return
        _LOG.info("no room for another %s on this route", kind)

    def _seen(self, points: FloatArray, here: BoolArray) -> float:
        """Time during which a body at `points` (K, 2) is in front of the camera while the drive lasts, s."""
        away = points - self._eyes
        distance = np.linalg.norm(away, axis=1)
        ahead = away[:, 0] * np.cos(self._gaze) + away[:, 1] * np.sin(self._gaze)
        farthest, aside = _IN_VIEW
        in_sight = here & (distance < farthest) & (ahead > aside * distance) & (self._times < self._duration)
        return float(in_sight.sum()) * FRAME_PERIOD

    def bus(self, way: Bus) -> _Way:
        """Ahead in the lane of the ego car, following its speed with a limited acceleration."""
        speeds = np.diff(self._ego, append=2.0 * self._ego[-1] - self._ego[-2]) / FRAME_PERIOD
        leads = way == "leads"
        station, speed = self._ego[0] + (_BUS_GAP if leads else _BUS_STANDS), speeds[0] if leads else 0.0
        stations = [station]
        for time, ego, ego_speed in zip(self._times[1:], self._ego[:-1], speeds[:-1], strict=True):
            if leads or time > _BUS_STARTS:
                target = ego_speed + 0.3 * (_BUS_GAP - (station - ego))
                limit = _BUS_PULL * FRAME_PERIOD
                speed = max(speed + float(np.clip(target - speed, -limit, limit)), 0.0)
            station += speed * FRAME_PERIOD
            stations.append(station)
        return _Way(np.array(stations), np.full(len(stations), -LANE_OFFSET), np.zeros(len(stations)))

    def stopping_bus(self, rng: np.random.Generator) -> _Way:
        """Ahead in the lane of the ego car, at speeds that are drawn: it holds one for a while, then often stands."""
        targets: list[float] = []
        while len(targets) < len(self._times):
            stands = bool(targets) and targets[-1] > 0.0 and rng.random() < 0.5
            speed, held = (0.0, _BUS_WAITS) if stands else (float(rng.uniform(*_BUS_SPEEDS)), _BUS_HOLDS)
            targets += [speed] * int(rng.uniform(*held) / FRAME_PERIOD)
        station, speed, stations = self._ego[0] + _BUS_FREE_GAP, targets[0], []
        for target in targets[: len(self._times)]:
            stations.append(station)
            bend = np.abs(np.interp(station + np.arange(0.0, 12.0, 3.0), self._road.stations, self._road.bends)).max()
            change = min(target, float(np.sqrt(_ACROSS / max(bend, 1e-6)))) - speed
            speed += float(np.clip(change, -_BUS_BRAKES * FRAME_PERIOD, _BUS_PULL * FRAME_PERIOD))
            station += speed * FRAME_PERIOD
        return _Way(np.array(stations), np.full(len(stations), -LANE_OFFSET), np.zeros(len(stations)))

    def leading(self, length: float, rng: np.random.Generator) -> _Way:
        """Ahead in the lane of the ego car: sometimes nearer, sometimes further."""
        nearest = 6.0 + 0.5 * length
        mean, change = nearest + float(rng.gamma(1.5, 6.0)) + 3.0, float(rng.uniform(1.5, 4.0))
        phase = 2 * np.pi * (self._times / float(rng.uniform(12.0, 25.0)) + float(rng.random()))
        gap = np.maximum(mean + change * np.sin(phase), nearest)
        stations = np.maximum.accumulate(self._ego + gap)
        return _Way(stations, np.full_like(stations, -LANE_OFFSET), np.zeros_like(stations))

    def oncoming(self, rng: np.random.Generator) -> _Way:
        """Along the other lane: meets the ego car at some time of its drive."""
        met = float(rng.uniform(0.5, self._duration + 2.0))
        speed = np.full_like(self._times, float(rng.uniform(2.5, 7.0)))
        if rng.random() < _STOPPING:
            stop = met - float(rng.uniform(0.0, 8.0))
            speed *= 1.0 - pulse(self._times, stop - 3.0, stop + float(rng.uniform(3.0, 7.0)), 2.0)
        driven = np.concatenate([[0.0], np.cumsum(speed[:-1] * FRAME_PERIOD)])
        start = float(np.interp(met, self._times, self._ego) + np.interp(met, self._times, driven))
        return _Way(start - driven, np.full_like(driven, LANE_OFFSET), np.full_like(driven, np.pi))

    def walking(self, walkway: float, rng: np.random.Generator) -> _Way:
        """Along the road on either side, while the ego car comes and passes."""
        met = float(rng.uniform(1.0, self._duration + 6.0))
        side, ahead = float(rng.choice([-1.0, 1.0])), float(rng.choice([-1.0, 1.0]))
        walked = ahead * np.clip(self._times - met, -15.0, 5.0) * float(rng.uniform(0.9, 1.7))
        # In a bend the way along the pavement is longer or shorter than that along the centreline.
        near = float(np.interp(met, self._times, self._ego)) + np.arange(-60.0, 60.5, 0.5)
        pavement = self._road.along(near, self._outside(near, side * walkway))[0]
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(pavement, axis=0), axis=1))])
        stations = np.interp(walked, length - length[len(length) // 2], near)
        turn = 0.0 if ahead > 0 else np.pi
        return _Way(stations, self._outside(stations, side * walkway), np.full_like(stations, turn))

    def crossing(self, walkway: float, rng: np.random.Generator) -> _Way:
        """Over the road, done some seconds before the ego car comes."""
        met = float(rng.uniform(8.0, self._duration + 15.0))
        side, pace = float(rng.choice([-1.0, 1.0])), float(rng.uniform(1.3, 1.8))
        arrived = met - float(rng.uniform(2.5, 7.0))
        left = side * np.clip(walkway - pace * (arrived - self._times), -walkway, walkway)
        stations = np.full_like(left, float(np.interp(met, self._times, self._ego)))
        return _Way(stations, left, np.full_like(left, side * np.pi / 2))

    def _outside(self, stations: FloatArray, left: float) -> FloatArray:
        """`left`, but towards the road where a bend leaves no room."""
        bends = np.interp(stations, self._road.stations, self._road.bends)
        limit = np.where(bends * left > 0.0, _TIGHT / np.maximum(np.abs(bends), 1e-6), np.inf)
        return np.copysign(np.minimum(abs(left), limit), left)


def _circles(points: FloatArray, yaws: FloatArray, centers: FloatArray) -> FloatArray:
    """Centres of circles along bodies at (K, 2) with yaws (K,): (K, C, 2)."""
    along = np.stack([np.cos(yaws), np.sin(yaws)], axis=1)
    circles: FloatArray = points[:, None] + centers[:, None] * along[:, None]
    return circles


def _touch(one: FloatArray, other: FloatArray, limit: float) -> bool:
    """Whether circles (K, C, 2) and (K, D, 2) ever come within `limit` m of each other; NaN is nowhere."""
    apart = one[:, :, None] - other[:, None]
    return bool((np.einsum("kcdi,kcdi->kcd", apart, apart) < limit**2).any())


def surface_points(body: MovingBody, count: int, rng: np.random.Generator) -> FloatArray:
    """Points drawn uniformly on the solid surface of a body but its underside, with outward normals; (N, 6)."""
    solid = replace(body, parts=tuple(part for part in body.parts if part.solid))
    meshes = body_meshes(solid).values()
    corners = np.concatenate([mesh.vertices[mesh.triangles] for mesh in meshes])
    outward = np.concatenate([mesh.normals[mesh.triangles].mean(axis=1) for mesh in meshes])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    normals *= (np.sign((normals * outward).sum(axis=1)) / np.maximum(areas, 1e-12))[:, None]
    areas[normals[:, 2] < -0.5] = 0.0
    drawn = rng.choice(len(areas), count, p=areas / areas.sum())
    shares = rng.dirichlet(np.ones(3), count)
    points = (shares[:, :, None] * corners[drawn]).sum(axis=1)
    return np.column_stack([points, normals[drawn]])


_SKIN = 0.15
"""Points this far outside of the box around a body still count as on it, m."""


class MovingPoints:
    """Tells which points are on moving bodies, by the boxes around these."""

    def __init__(self, bodies: Sequence[MovingBody]) -> None:
        self._bodies = tuple(bodies)
        corners = [np.concatenate([mesh.vertices for mesh in body_meshes(body).values()]) for body in self._bodies]
        self._boxes = [(vertices.min(axis=0) - _SKIN, vertices.max(axis=0) + _SKIN) for vertices in corners]

    def on_body(self, points_s: FloatArray, time: float) -> BoolArray:
        """Mask of points (N, 3) of S, m, that are on a body at `time` s; False for NaN."""
        inside = np.zeros(len(points_s), dtype=bool)
        for body, (low, high) in zip(self._bodies, self._boxes, strict=True):
            position, yaw = body.pose_at(time)
            cos, sin = np.cos(yaw), np.sin(yaw)
            local = (points_s - position) @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
            # Not the road below it: what the wheels stand on is no part of the body.
            inside |= ((local >= low) & (local <= high)).all(axis=1) & (local[:, 2] > 0.5 * _SKIN)
        return inside
