"""Scenes as arrays, room for them in the state, and observations and truth of the rows as arrays of their own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.rotations import Nine, Three
from filters.kernels.compilation import entry, kernel
from stereo_slam_env.recording.body_truth import BODY_KINDS
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT
from stereo_slam_env.simulator.contacts import touches
from stereo_slam_env.simulator.motion import LOOK_AHEAD, route_ahead, route_of
from stereo_slam_env.simulator.rays import COLUMNS, KIND, TRIANGLE, Obstacles, hits, obstacles, solid_rows, way_to
from stereo_slam_env.simulator.state import ARENA, Fleet, Rules, Sensed
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.routes import FRAME_PERIOD, Route
from stereo_slam_env.world.scene import BOX, CYLINDER, MovingBody, Scene
from stereo_slam_env.world.traffic import surface_points


class Traffic(NamedTuple):
    """Moving bodies as arrays, see `Fleet`."""

    tracks: FloatArray
    shares: IntArray
    balls: FloatArray
    parts: FloatArray
    surface: FloatArray


_WAITING = -100.0
"""Bodies that are lower than this, m, wait before they come or after they have gone, see `traffic`."""
_SPARE = 8
"""Landmarks on a moving body for each that is tracked at a time."""


def traffic_arrays(bodies: Sequence[MovingBody], landmarks: int = 0, rng: np.random.Generator | None = None) -> Traffic:
    """Bodies frame by frame, until all of them are at rest; `landmarks` are tracked on each, half as many on people."""
    frames = [int(np.ceil(body.times[-1] / FRAME_PERIOD)) + 1 for body in bodies]
    tracks, shares = np.zeros((len(bodies), max(frames, default=0), 5)), np.zeros((len(bodies), 7), dtype=np.int64)
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
        shares[m, :3] = first, first + len(rows), frames[m]
        shares[m, 6] = BODY_KINDS.index(body.kind) + 1 if body.kind in BODY_KINDS else 0
        balls[m, :4] = _ball_around(rows)
    surface = [np.zeros((0, 7))]
    generators = rng.spawn(len(bodies)) if rng is not None and landmarks else []
    for m, (body, own_rng) in enumerate(zip(bodies, generators, strict=bool(generators))):
        most = landmarks_on(body.kind, landmarks)
        points = surface_points(body, _SPARE * most, own_rng)
        first = sum(len(part) for part in surface)
        shares[m, 3:6] = first, first + len(points), most
        surface.append(np.column_stack([points, np.full(len(points), m)]))
    solids = np.concatenate(parts) if parts else np.zeros((0, COLUMNS))
    return Traffic(tracks, shares, balls, solids, np.concatenate(surface))


def landmarks_on(kind: str, landmarks: int) -> int:
    """Landmarks that are tracked at a time on a body of a kind: half as many on people."""
    return -(-landmarks // 2) if kind == "pedestrian" else landmarks


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
        first, last, frames = fleet.shares[b, m, 0], fleet.shares[b, m, 1], fleet.shares[b, m, 2]
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
def is_present(fleet: Fleet, b: int, m: int) -> bool:
    """Whether a moving body neither waits nor comes or goes in this step."""
    last, step = fleet.shares[b, m, 2] - 1, max(fleet.step[b] - 1, 0)
    track = fleet.tracks[b, m]
    return bool(track[min(step, last), 2] > _WAITING and track[min(step + 1, last), 2] > _WAITING)


@kernel
def move_landmarks(fleet: Fleet, b: int, camera_height: float) -> None:
    """Put the landmarks on moving bodies of a row where they are in this frame, in W."""
    first, landmarks = fleet.sizes[b, 0], fleet.landmarks[b]
    for q in range(fleet.sizes[b, 4]):
        point = fleet.surface[b, q]
        m = int(point[6])
        at = fleet.tracks[b, m, min(fleet.step[b], fleet.shares[b, m, 2] - 1)]
        landmarks[0, first + q] = -(at[1] + at[4] * point[0] + at[3] * point[1])
        landmarks[1, first + q] = camera_height - (at[2] + point[2])
        landmarks[2, first + q] = at[0] + at[3] * point[0] - at[4] * point[1]


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
            if bodies.balls[m, 6] > _WAITING and _passes(bodies.balls[m], camera, way):
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


class SceneArrays(NamedTuple):
    """Landmarks in W (N, 3), m, the solids that hide them, what moves, the scene itself for who draws it, its route."""

    landmarks: FloatArray
    solids: Obstacles
    traffic: Traffic
    scene: Scene
    route: Route

    def __deepcopy__(self, memo: dict[int, Any]) -> SceneArrays:
        return self  # nobody changes it


def scene_arrays(
    scene: Scene, route: Route, moving_landmarks: int = 0, rng: np.random.Generator | None = None
) -> SceneArrays:
    """A scene along a route as arrays; of landmarks on moving bodies, so many of each are tracked at a time."""
    landmarks = WorldFrame(CAMERA_HEIGHT).to_world(scene.landmark_points)
    traffic = traffic_arrays(scene.moving, moving_landmarks, rng)
    return SceneArrays(landmarks, obstacles(scene.solids), traffic, scene, route)


def put_scene(fleet: Fleet, b: int, scene: SceneArrays) -> None:
    """Put a scene where row `b` has it; there must be room."""
    landmarks, solids, traffic = len(scene.landmarks), scene.solids, scene.traffic
    nodes, bodies, parts = len(solids.bounds), len(traffic.shares), len(traffic.parts)
    fleet.landmarks[b, :, :landmarks] = scene.landmarks.T
    fleet.solids[b, : len(solids.solids)] = solids.solids
    fleet.bounds[b, :nodes], fleet.links[b, :nodes] = solids.bounds, solids.links
    fleet.tracks[b, :bodies, : traffic.tracks.shape[1]] = traffic.tracks
    fleet.shares[b, :bodies], fleet.balls[b, :bodies] = traffic.shares, traffic.balls
    fleet.parts[b, :parts] = traffic.parts
    fleet.surface[b, : len(traffic.surface)] = traffic.surface
    frames = put_route(fleet, b, scene.route)
    fleet.sizes[b] = landmarks, nodes, bodies, frames, len(traffic.surface)


def put_route(fleet: Fleet, b: int, route: Route) -> int:
    """Put a route where row `b` has it, and return its number of frames."""
    frames, steps = route.frames, route.frames - 1
    fleet.positions[b, :frames], fleet.arc_length[b, :frames] = route.positions, route.arc_length
    fleet.attitudes[b, :frames] = route.attitudes.reshape(-1, 9)
    fleet.speeds[b, :steps], fleet.yaw_rates[b, :steps] = route.speeds, route.yaw_rates
    fleet.travel[b, :steps] = route.travel.reshape(-1, 9)
    return frames


def with_room(fleet: Fleet, scene: SceneArrays) -> Fleet:
    """The same state with room for a scene; itself where there is room."""
    solids, traffic = len(scene.solids.solids), scene.traffic
    points = len(traffic.surface)
    landmarks = len(scene.landmarks) + points
    bodies, frames, parts = len(traffic.shares), traffic.tracks.shape[1], len(traffic.parts)
    has_room = (
        *(fleet.landmarks.shape[2], fleet.solids.shape[1], *fleet.tracks.shape[1:3]),
        *(fleet.parts.shape[1], fleet.arc_length.shape[1], fleet.surface.shape[1]),
    )
    needed = landmarks, solids, bodies, frames, parts, scene.route.frames, points
    if all(need <= room for need, room in zip(needed, has_room, strict=True)):
        return fleet
    landmarks, solids, bodies, frames, parts, steps, points = (
        room if need <= room else need + need // 4 for need, room in zip(needed, has_room, strict=True)
    )
    shapes = {
        **dict.fromkeys(("lost", "inside", "seen", "lasting", "measured_at"), (landmarks,)),
        "landmarks": (3, landmarks),
        **dict.fromkeys(("solids", "bounds", "links"), (solids,)),
        "tracks": (bodies, frames),
        **dict.fromkeys(("shares", "balls"), (bodies,)),
        "surface": (points,),
        **dict.fromkeys(("parts", "parts_now"), (parts,)),
        **dict.fromkeys(("positions", "arc_length", "speeds", "yaw_rates", "travel", "attitudes"), (steps,)),
        "exponentials": (max(4096, 4 * landmarks),),
    }

    def grown(name: str) -> Any:
        old = getattr(fleet, name)
        new = np.zeros((len(old), *shapes[name], *old.shape[1 + len(shapes[name]) :]), dtype=old.dtype)
        new[tuple(slice(0, size) for size in old.shape)] = old
        return new

    return fleet._replace(**{name: grown(name) for name in shapes})


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
    """Pack the frame of all rows for the observation."""
    count, most, single = len(fleet.step), rules.room, np.float32
    frame = Shown(
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
    _show(rules, fleet, sensed, frame)
    return frame


@entry
def _show(rules: Rules, fleet: Fleet, sensed: Sensed, shown: Shown) -> None:
    most = rules.room
    for b in range(len(fleet.step)):
        count, pose, velocity = sensed.number[b], fleet.pose[b], fleet.velocity[b]
        for k in range(most):
            is_filled = k < count
            shown.mask[b, k] = 1 if is_filled else 0
            shown.ids[b, k] = sensed.ids[b, k] if is_filled else -1
            shown.v_right[b, k] = sensed.v_right[b, k] if is_filled else 0.0
            for a in range(3):
                shown.uvd[b, k, a] = sensed.uvd[b, k, a] if is_filled else 0.0
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
