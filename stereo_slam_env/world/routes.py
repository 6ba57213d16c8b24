"""Routes: speed and yaw rate over time, by name or along a recorded drive."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial, wraps
from importlib.metadata import entry_points
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from filters.contract.validation import did_you_mean, positive
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.files.readers import read_poses
from stereo_slam_env.world.recorded_paths import require_one_drive, smoothed, steady, strides
from stereo_slam_env.world.street_grid import StreetGrid, random_streets

ENTRY_POINT_GROUP = "stereo_slam.scenes"
"""Functions of installed packages that register scenes and routes."""
FRAME_PERIOD = 0.1
"""Seconds between two frames of every rig."""
_REACH = 30.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Route:
    """A nominal drive on flat ground, in W."""

    name: str
    """What `named_route` takes: a registered name, or the path of a pose file."""
    speeds: FloatArray
    """(K - 1,): speed of each step, m/s."""
    yaw_rates: FloatArray
    """(K - 1,), about the camera's y axis (down), rad/s: positive turns right."""
    straight_below: float = 1e-3
    """Yaw rate up to which it counts as driving straight ahead, rad/s."""
    streets: StreetGrid | None = None
    """The streets that it leads through, where there are others beside those that it takes."""

    @property
    def frames(self) -> int:
        """Number of frames K; the first one is in the origin of W."""
        return len(self.speeds) + 1

    @cached_property
    def headings(self) -> FloatArray:
        """Yaw at each frame, rad; (K,)."""
        return np.concatenate([[0.0], np.cumsum(self.yaw_rates * FRAME_PERIOD)])

    @cached_property
    def middle_headings(self) -> FloatArray:
        """Yaw half-way through each step, the direction of travel, rad; (K - 1,)."""
        return 0.5 * (self.headings[1:] + self.headings[:-1])

    @cached_property
    def travel(self) -> FloatArray:
        """Rotation of a camera that looks in the direction of travel of each step; (K - 1, 3, 3)."""
        return _yawed(self.middle_headings)

    @cached_property
    def attitudes(self) -> FloatArray:
        """Nominal rotation R_wc of the camera at each frame; (K, 3, 3)."""
        return _yawed(self.headings)

    @cached_property
    def positions(self) -> FloatArray:
        """Nominal camera position at each frame, m in W; (K, 3)."""
        yaw = self.middle_headings
        velocity = self.speeds[:, None] * np.stack([np.sin(yaw), np.zeros_like(yaw), np.cos(yaw)], axis=1)
        return np.concatenate([np.zeros((1, 3)), np.cumsum(velocity * FRAME_PERIOD, axis=0)])

    @cached_property
    def arc_length(self) -> FloatArray:
        """Distance along the route at each frame, m; (K,)."""
        return np.concatenate([[0.0], np.cumsum(self.speeds * FRAME_PERIOD)])

    @property
    def length(self) -> float:
        """Distance along the whole route, m."""
        return float(self.arc_length[-1])

    @property
    def duration(self) -> float:
        """Time of the whole drive, s."""
        return len(self.speeds) * FRAME_PERIOD

    def points_at(self, distances: FloatArray) -> FloatArray:
        """Nominal positions at distances (...) m along the route, in W; (..., 3). Beyond an end it is that end."""
        return np.stack([np.interp(distances, self.arc_length, axis) for axis in self.positions.T], axis=-1)

    def turns(self, least: float) -> list[tuple[int, int]]:
        """First and last frame of every turn by more than `least` rad."""
        turning = np.abs(self.yaw_rates) > self.straight_below
        edges = np.flatnonzero(np.diff(np.concatenate([[False], turning, [False]]).astype(int))).reshape(-1, 2)
        turned = np.abs(self.headings[edges[:, 1]] - self.headings[edges[:, 0]])
        return [(int(first), int(last)) for first, last in edges[turned > least]]

    def nearest(self, position: FloatArray, around: int | None = None) -> int:
        """Index of the frame whose nominal position is nearest to `position` (3,), m in W.

        With `around`, only of those less than 30 m along the route from that frame: where a route crosses or retraces
        itself, this is the pass.
        """
        first, last = 0, self.frames
        if around is not None:
            middle = self.arc_length[around]
            first = int(self.arc_length.searchsorted(middle - _REACH))
            last = int(self.arc_length.searchsorted(middle + _REACH, side="right"))
        away = ((self.positions[first:last] - position) ** 2).sum(axis=1)
        return first + int(away.argmin())


_Kept = TypeVar("_Kept")


def once_per_route(make: Callable[[Route], _Kept]) -> Callable[[Route], _Kept]:
    """Keep what `make` returns for a route, for as long as there is that route."""
    kept_by_route: WeakKeyDictionary[Route, _Kept] = WeakKeyDictionary()

    @wraps(make)
    def keeping(route: Route) -> _Kept:
        if route not in kept_by_route:
            kept_by_route[route] = make(route)
        return kept_by_route[route]

    return keeping


def pulse(time: FloatArray, start: float, end: float, ramp: float) -> FloatArray:
    """1 between `start` and `end`, 0 outside, with raised-cosine ramps of `ramp` seconds inside the window."""
    edge = np.minimum(time - start, end - time) / ramp
    return (0.5 - 0.5 * np.cos(np.pi * np.clip(edge, 0.0, 1.0))).astype(np.float64)


def _yawed(yaws: FloatArray) -> FloatArray:
    """Rotations by yaws (N,) about y, rad; (N, 3, 3)."""
    return rotations.exp(np.stack([np.zeros_like(yaws), yaws, np.zeros_like(yaws)], axis=1))


def _step_times(frames: int) -> FloatArray:
    return (np.arange(frames - 1, dtype=np.float64) + 0.5) * FRAME_PERIOD


def straight() -> Route:
    """200 frames straight ahead at 4.9 m/s."""
    speeds = np.full(199, 4.9)
    return Route("straight", speeds, np.zeros_like(speeds))


def right_turn() -> Route:
    """80 frames: forward for half a second, then 90 degrees to the right (the situation of the paper's 4.3)."""
    time = _step_times(80)
    yaw_rate = (np.pi / 2) / 3.5
    return Route("right-turn", np.full_like(time, 4.0), yaw_rate * pulse(time, 0.5, 5.0, 1.0))


def town() -> Route:
    """800 frames, about 350 m, with one wide turn to the left and one to the right (the paper's 4.4)."""
    time = _step_times(800)
    speeds, yaw_rates = np.full_like(time, 4.9), np.zeros_like(time)
    for start, end, yaw_rate in ((25.0, 31.0, -0.29), (60.0, 66.0, 0.29)):
        speeds -= 1.9 * pulse(time, start - 4.0, end + 4.0, 4.0)
        yaw_rates += yaw_rate * pulse(time, start, end, 1.2)
    return Route("town", speeds, yaw_rates)


def loop() -> Route:
    """790 frames: round a block by four right turns, through the start pose at frame 740, 24 m further."""
    turn, ramp, sides = 6.0, 1.2, (14.0, 11.0)
    starts = 0.5 * sides[0] + np.cumsum([0.0, *(turn + side for side in (sides[1], sides[0], sides[1]))])
    time = _step_times(790)
    speeds, yaw_rates = np.full_like(time, 4.9), np.zeros_like(time)
    for start in starts:
        speeds -= 1.9 * pulse(time, start - 2.0, start + turn + 2.0, 2.0)
        yaw_rates += (np.pi / 2) / (turn - ramp) * pulse(time, start, start + turn, ramp)
    return Route("loop", speeds, yaw_rates)


def random_town(rng: np.random.Generator) -> Route:
    """A drive with one to four turns to either side: 60 to 350 m, at 4 to 6 m/s between the turns."""
    angles, heading = rng.uniform(0.5, 1.7, rng.integers(1, 5)), 0.0
    for number, angle in enumerate(angles):
        turn = rng.choice([-angle, angle])
        angles[number] = turn if abs(heading + turn) < _FARTHEST_ROUND else -turn  # it does not cross itself
        heading += angles[number]
    legs = np.concatenate([rng.uniform(15.0, 50.0, 1), rng.uniform(30.0, 70.0, len(angles))])
    return _turning("random-town", legs, angles, rng.uniform(4.0, 6.0), rng.uniform(9.0, 14.0, len(angles)))


def random_loop(rng: np.random.Generator) -> Route:
    """Round a block with sides of 45 to 80 m, to the left or to the right, and 24 m further."""
    first, second = rng.uniform(45.0, 80.0, 2)
    begun = rng.uniform(0.35, 0.65) * first
    legs = np.array([begun, second, first, second, first - begun + _BEYOND])
    angles = np.full(4, rng.choice([-1.0, 1.0]) * 0.5 * np.pi)
    return _turning("random-loop", legs, angles, rng.uniform(4.0, 5.5), np.full(4, rng.uniform(9.0, 14.0)))


def random_grid(rng: np.random.Generator) -> Route:
    """Through all roads of a grid of streets with blocks of 38 to 54 m, at 5 m/s."""
    streets = random_streets(rng)
    return through_streets(streets, streets.tour)


def through_streets(streets: StreetGrid, choices: Sequence[int]) -> Route:
    """Route from the start of the streets by choices of a road at each junction to the middle of the last road."""
    metres, turns = streets.steps(choices)
    return Route("random-grid", metres / FRAME_PERIOD, turns / FRAME_PERIOD, streets=streets)


def _turning(name: str, legs: FloatArray, angles: FloatArray, cruise: float, radii: FloatArray) -> Route:
    """Straight legs (T + 1,), m, and the turns (T,) between them, rad, with these mean radii, m, at 3 m/s."""
    fast, slow, ramp = cruise * FRAME_PERIOD, _TURN_SPEED * FRAME_PERIOD, round(_RAMP / FRAME_PERIOD)
    rise = slow + (fast - slow) * (0.5 - 0.5 * np.cos(np.pi * (np.arange(ramp) + 0.5) / ramp))
    steps, yaws = [], []  # m and rad in each step
    for number, leg in enumerate(legs):
        before, after = rise[: ramp * (number > 0)], rise[: ramp * (number < len(angles))][::-1]
        even = max(round((leg - before.sum() - after.sum()) / fast), 0)
        steps += [before, np.full(even, fast), after]
        yaws.append(np.zeros(len(before) + even + len(after)))
        if number < len(angles):
            time = _step_times(max(round(abs(angles[number]) * radii[number] / slow), 2 * ramp) + 1)
            shape = pulse(time, 0.0, len(time) * FRAME_PERIOD, 1.2)
            steps.append(np.full(len(time), slow))
            yaws.append(angles[number] * shape / shape.sum())
    return Route(name, np.concatenate(steps) / FRAME_PERIOD, np.concatenate(yaws) / FRAME_PERIOD)


def _typical(draw: Callable[[np.random.Generator], Route]) -> Route:
    """One of the routes that are drawn, always the same."""
    return draw(np.random.default_rng(0))


_TURN_SPEED, _RAMP = 3.0, 3.0
"""In the turns of random routes, m/s; and the time of braking before and of accelerating after them, s."""
_FARTHEST_ROUND = 2.0
"""Farthest direction from the first one on a random route, rad."""
_BEYOND = 24.0
"""m: how far a random loop goes on beyond its start."""
RANDOM_ROUTES: Mapping[str, Callable[[np.random.Generator], Route]] = MappingProxyType(
    {"random-town": random_town, "random-loop": random_loop, "random-grid": random_grid}
)
"""Routes that are drawn anew for each episode, by name."""

_ROUTES: dict[str, Callable[[], Route]] = {
    "straight": straight,
    "right-turn": right_turn,
    "town": town,
    "loop": loop,
    **{name: partial(_typical, draw) for name, draw in RANDOM_ROUTES.items()},
}
ROUTES: Mapping[str, Callable[[], Route]] = MappingProxyType(_ROUTES)
"""Registered routes by name; read-only, see `register_route`."""


def register_route(name: str, route: Route | Callable[[], Route]) -> None:
    """Give a route a name that `gym.make(..., route=name)`, scenarios and commands take.

    A name is known in the process that registers it. For commands and worker processes, an installed package names a
    function that registers its scenes and routes as an entry point in the group `stereo_slam.scenes`.

    Parameters
    ----------
    name : str
        A new one, of letters, digits, ".", "_" and "-".
    route : Route or callable
        The route, or a function that makes it.

    Raises
    ------
    ValueError
        The name is taken or has other characters, or `route` is neither.
    """
    require_new("route", name, ROUTES)
    if not isinstance(route, Route) and not callable(route):
        raise ValueError(f"route must be a Route or a function that makes one, got {route!r}")
    _ROUTES[name] = (lambda: replace(route, name=name)) if isinstance(route, Route) else route


def available_routes() -> dict[str, str]:
    """Names of the registered routes and one line on each."""
    load_registrations()
    routes = {name: make() for name, make in ROUTES.items()}
    return {name: f"{route.frames} frames, {route.length:.0f} m" for name, route in routes.items()}


def require_new(kind: str, name: str, taken: Mapping[str, object]) -> None:
    """Refuse a name to register that is taken or not plain; it becomes part of file names."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9][\w.-]*", name):
        raise ValueError(f"name must be letters, digits, '.', '_' and '-', got {name!r}")
    if name in taken:
        raise ValueError(f"name must be new, got {name!r}: there is such a {kind}, register yours by another name")


@cache
def load_registrations() -> None:
    """Let installed packages register their scenes and routes; one that fails is logged by name."""
    for entry_point in entry_points(group=ENTRY_POINT_GROUP):
        try:
            entry_point.load()()
        except Exception as error:
            _log.warning("scenes of %r are not available: %s: %s", entry_point.name, type(error).__name__, error)


KITTI_PERIOD = 0.1037
"""Mean time between two frames of KITTI odometry, s."""
_AT_REST = 0.02
"""Speed that counts as standing still, m/s."""
_SHORTEST = 5.0
_STRAIGHT_BELOW = 0.08
"""rad/s; recorded drives are never quite straight."""


def kitti_route(path: str | Path, period: float = KITTI_PERIOD) -> Route:
    """The drive of a KITTI pose file with `period` s between two rows, on flat ground and smooth.

    The horizontal path is smoothed over 1.5 m, the distance driven over 0.3 s, both are resampled to `FRAME_PERIOD`;
    the camera looks where it drives. W starts in the first direction of travel. A `ValueError` names the file where it
    is none of 12 numbers a row (the upper 3x4 part of T_world_cam), jumps between two rows, drives backwards, or is
    shorter than 5 m.
    """
    positive("period", period)
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path} is not a file: give a KITTI pose file, 12 numbers a row")
    positions, orientations = read_poses(path)
    level = positions[:, [0, 2]] - positions[0, [0, 2]]
    require_one_drive(path, level, np.array([rotations.matrix(q)[[0, 2], 2] for q in orientations]), period)

    points, driven = strides(level)
    if driven[-1] < _SHORTEST:
        raise ValueError(f"{path} drives only {driven[-1]:.1f} m: a route needs {_SHORTEST:.0f} m")
    arc, smooth = smoothed(points)
    tangents = np.gradient(smooth, axis=0)
    headings = np.unwrap(np.arctan2(tangents[:, 0], tangents[:, 1]))

    duration = (len(level) - 1) * period
    frames = int(duration / FRAME_PERIOD) + 1
    at = np.interp(np.arange(frames) * FRAME_PERIOD, np.arange(len(level)) * period, steady(driven, period))
    speeds = np.diff(at) / FRAME_PERIOD
    heading = np.interp(at, arc, headings)
    return Route(
        str(path),
        np.where(speeds < _AT_REST, 0.0, speeds),
        np.diff(heading) / FRAME_PERIOD,
        straight_below=_STRAIGHT_BELOW,
    )


def named_route(name: str) -> Route:
    """A route by its name in `ROUTES`, or along the KITTI pose file at that path.

    Raises
    ------
    ValueError
        Neither; the message lists the names and the nearest one. Or the file is not a usable pose file.
    """
    if name not in ROUTES:
        load_registrations()
    if name in ROUTES:
        return ROUTES[name]()
    if Path(name).is_file():
        return kitti_route(name)
    hint = did_you_mean(name, ROUTES)
    raise ValueError(f"route must be one of {', '.join(map(repr, ROUTES))} or a KITTI pose file, got {name!r}{hint}")
