"""State of B vehicles in arrays that can be copied while it runs, and what is the same for all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from copy import deepcopy
from typing import Annotated, Any, ClassVar, NamedTuple, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.rotations import matrix
from stereo_slam_env.sensing.imu import Imu
from stereo_slam_env.sensing.padding import TrackingPolicy
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT
from stereo_slam_env.simulator.rays import COLUMNS
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.world.vehicle import Car, Head, Sway

NOISE_KINDS = {"pixels": 0, "quantised": 1, "uvd": 2}
"""Noise models that the kernels have; others are drawn one row after the other."""
NO_NOISE = 3
WEIGHTS = ("progress", "tracking", "collision", "goal", "time", "jerk", "effort")
"""Terms of the reward, in the order of their columns."""
ARENA = 60.0
"""m from the route: what is farther away has left the arena."""
ODOMETRY_SIGMAS = (0.1, 0.01)
"""Usual standard deviations of the odometry, each axis, m/s and rad/s."""


Record = TypeVar("Record")
RIDE_STEPS, RIDE_WAVES = 20, 7
"""Steps of a smooth ride in a frame, which are samples of an inertial unit, and waves of the road."""


class Rules(NamedTuple):
    """Rules, the same for all rows."""

    dt: float
    camera: tuple[float, ...]
    """fx, fy, cx, cy, disparity constant, baseline, width, height."""
    camera_height: float
    limits: tuple[float, ...]
    """Nearest and farthest depth, m, and distance to the edge of the images, px."""
    most: int
    room: int
    """Most measurements in a frame: `most` landmarks that stand, and those on moving bodies."""
    refill_below: int
    revisit: bool
    noise: int
    sigma: float
    lasting: tuple[float, float]
    """Standard deviation of the errors that last, px, and how much of one is left after a frame."""
    exact: bool
    """Whether rays and contacts are computed here; otherwise `Fleet.seen` and `Fleet.touching` have the answers."""
    odometry_sigmas: FloatArray
    sway: FloatArray
    """Standard deviations, decays and fresh parts of the disturbance of a scripted drive, (3, 6)."""
    pull: float
    steered: bool
    car: tuple[float, ...]
    """Wheelbase, camera forward, largest speed, acceleration, steering angle, steering rate, lateral acceleration."""
    lane: float
    """How far beside the route a car that is steered may be, m."""
    slowest: float
    """Mean speed below which a car that is steered arrives too late, m/s."""
    body: FloatArray
    """Half the size of the car's body, and its centre in the camera frame; (2, 3)."""
    smooth: bool
    """Whether the camera follows the car by `ride`, with continuous accelerations."""
    roughness: float
    """Scale of the unevenness of the road."""
    imu_place: tuple[float, ...]
    """Of an inertial unit in the camera frame, m."""
    imu_turn: tuple[float, ...]
    """Rotation matrix that takes its vectors to the camera frame, row by row."""
    has_head: bool
    head: FloatArray
    """Largest angles and largest rates; (2, 2)."""
    weights: FloatArray
    """Of `WEIGHTS`, (7,)."""


class Fleet(NamedTuple):
    """State of B rows, with the axes of each array: L landmarks, K frames of the route, M moving bodies.

    Solids (S, their tree T) and parts of moving bodies (P) have C numbers. There is room for the largest scene.
    """

    body: Annotated[FloatArray, "B 7"]
    """Position and orientation of the camera as if it looked straight ahead."""
    pose: Annotated[FloatArray, "B 7"]
    """Position and orientation of the camera."""
    velocity: Annotated[FloatArray, "B 6"]
    """Linear and angular velocity of the camera over the last step."""
    angles: Annotated[FloatArray, "B 2"]
    """Pan and tilt of the head, rad."""
    sway: Annotated[FloatArray, "B 6"]
    """Disturbance of a scripted drive."""
    car: Annotated[FloatArray, "B 6"]
    """Speed, steering angle and heading; accelerations forward and to the side; squared jerk of the last step."""
    ride: Annotated[FloatArray, "B R"]
    """State of a smooth ride, see `ride`."""
    step: Annotated[IntArray, "B"]
    """Number of the frame."""
    nearest: Annotated[IntArray, "B"]
    """Nearest frame of the route."""
    farthest: Annotated[FloatArray, "B"]
    """How much of the route has been driven, m."""
    distance: Annotated[FloatArray, "B"]
    """Way driven, m."""
    turned: Annotated[FloatArray, "B 2"]
    """By how much the head has turned in the last step, rad."""
    lost: Annotated[BoolArray, "B L"]
    """Landmarks that have been tracked and are not to be again."""
    inside: Annotated[NDArray[np.uint8], "B L"]
    """Landmarks within range and inside both images."""
    seen: Annotated[BoolArray, "B L"]
    """Landmarks that nothing hides, where the rules are not exact."""
    touching: Annotated[BoolArray, "B"]
    """Whether the car touches something, where the rules are not exact."""
    positions: Annotated[FloatArray, "B K 3"]
    """Positions of the route, m."""
    arc_length: Annotated[FloatArray, "B K"]
    """Distance along the route, m."""
    speeds: Annotated[FloatArray, "B K"]
    """Speeds of the steps of the route, m/s; the last one is unused, as those of `yaw_rates` and `travel`."""
    yaw_rates: Annotated[FloatArray, "B K"]
    """Yaw rates of the steps of the route, rad/s."""
    travel: Annotated[FloatArray, "B K 9"]
    """Rotation matrices to the directions of the steps."""
    attitudes: Annotated[FloatArray, "B K 9"]
    """Rotation matrices of the poses of the route."""
    landmarks: Annotated[FloatArray, "B 3 L"]
    """Landmarks in W, m."""
    sizes: Annotated[IntArray, "B 5"]
    """Landmarks of a scene that stand, nodes of the tree of its solids, moving bodies, frames of the route, landmarks
    on moving bodies, which come after those that stand."""
    solids: Annotated[FloatArray, "B S C"]
    """Solids of the scene, see `rays.Obstacles`, as the next two."""
    bounds: Annotated[NDArray[np.float32], "B T 6 8"]
    """Bounds of the nodes of their tree."""
    links: Annotated[IntArray, "B T 8"]
    """Children of the nodes."""
    tracks: Annotated[FloatArray, "B M K 5"]
    """Moving bodies at each frame: place (x, y, z) in S, m, cosine and sine of the yaw."""
    shares: Annotated[IntArray, "B M 7"]
    """First part of each moving body, one past its last one, and its frames K; its first landmark, one past its last
    one, how many of them are tracked at a time; code of its kind, see `BODY_KINDS`."""
    surface: Annotated[FloatArray, "B Q 7"]
    """Landmarks on moving bodies, in the frame of the body: point, m, outward normal, number of the body."""
    balls: Annotated[FloatArray, "B M 7"]
    """Around each moving body: the ball in the frame of the body, then its centre now in S."""
    parts: Annotated[FloatArray, "B P C"]
    """Solids of the moving bodies, in their frames."""
    parts_now: Annotated[FloatArray, "B P C"]
    """The same in S, now."""
    lasting: Annotated[FloatArray, "B L E"]
    """Errors that last of each landmark, over their standard deviation: u, v left, u, v right; E = 0: none."""
    measured_at: Annotated[IntArray, "B L"]
    """Frame in which each landmark was last measured, -1 where it never was."""
    normals: Annotated[FloatArray, "B 3 n"]
    """Random numbers of the three streams of motion, odometry and noise."""
    exponentials: Annotated[FloatArray, "B m"]
    """Those of the choice of landmarks."""
    used: Annotated[IntArray, "B 4"]
    """How many of each have been used."""


class Sensed(NamedTuple):
    """Frame of B rows, in full precision, with the axes of each array."""

    ids: Annotated[IntArray, "B N"]
    """Landmarks that are tracked, ascending; -1 in padding."""
    uvd: Annotated[FloatArray, "B N 3"]
    """Their measurements, px."""
    v_right: Annotated[FloatArray, "B N"]
    """Their rows in the right image, px."""
    number: Annotated[IntArray, "B"]
    """Number of landmarks."""
    moving: Annotated[IntArray, "B"]
    """Number of those on moving bodies, which are the last."""
    odometry: Annotated[FloatArray, "B 6"]
    """Linear and angular velocity by the odometry, m/s and rad/s."""
    inertial: Annotated[FloatArray, "B n 6"]
    """Angular rates and specific forces in the frame of the inertial unit, over the step; of a smooth ride only."""
    terms: Annotated[FloatArray, "W B"]
    """Terms of the reward, with weights."""
    reward: Annotated[FloatArray, "B"]
    """Sum of these."""
    beside: Annotated[FloatArray, "B"]
    """Distance of a car that is steered from its route, to the side, m."""
    collision: Annotated[BoolArray, "B"]
    """Whether the car has hit something."""
    failed: Annotated[BoolArray, "B"]
    """Whether the episode has failed."""
    success: Annotated[BoolArray, "B"]
    """Whether it has succeeded."""


def make_rules(
    camera: StereoCamera,
    tracking: TrackingPolicy = TrackingPolicy(),  # noqa: B008 (frozen)
    *,
    moving: int = 0,
    noise: str = "pixels",
    sigma: float = 1.0,
    lasting: float = 0.0,
    lasting_time: float | None = None,
    odometry_sigmas: tuple[float, float] = ODOMETRY_SIGMAS,
    perturbation: float = 1.0,
    steered: bool = False,
    lane: float = math.inf,
    slowest: float = 0.0,
    head: Head | None = None,
    weights: Mapping[str, float] | None = None,
    exact: bool = True,
    smooth: bool = False,
    roughness: float = 1.0,
    imu: Imu = Imu(),  # noqa: B008 (frozen)
) -> Rules:
    """Rules of vehicles that drive along the routes of their scenes.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    tracking : TrackingPolicy
        Of landmarks.
    moving : int
        Most landmarks on moving bodies in a frame.
    noise, sigma
        Of landmarks, see `sensing.pixel_noise`.
    lasting : float
        Standard deviation, px, of the part of each landmark's errors that lasts, in each coordinate of both images.
    lasting_time : float, optional
        Correlation time of that part, a Gauss-Markov process of first order, s. None: it never changes.
    odometry_sigmas : (2,) tuple
        Standard deviations, each axis, m/s and rad/s.
    perturbation : float
        Scale of the sway of a scripted drive.
    steered : bool
        Whether commands drive the car, and not a script.
    lane : float
        How far beside the route a car that is steered may be, m.
    slowest : float
        Mean speed below which a car that is steered arrives too late, m/s.
    head : Head, optional
        What carries the cameras; None: they are fixed to the car.
    weights : mapping, optional
        Of the terms of the reward `WEIGHTS`; 0 where there is none.
    exact : bool
        Whether rays and contacts are computed in closed form.
    smooth : bool
        Whether the camera has continuous accelerations.
    roughness : float
        Scale of the unevenness of the road of a smooth ride.
    imu : Imu
        Where an inertial unit sits.
    """
    car, sway = Car(), Sway(perturbation)
    return Rules(
        dt=FRAME_PERIOD,
        camera=_numbers(camera, "fx", "fy", "cx", "cy", "disparity_constant", "baseline", "width", "height"),
        camera_height=CAMERA_HEIGHT,
        limits=_numbers(tracking, "nearest", "farthest", "margin"),
        most=tracking.max_landmarks,
        room=tracking.max_landmarks + moving,
        refill_below=tracking.refill_below,
        revisit=tracking.revisit,
        noise=NOISE_KINDS.get(noise, NO_NOISE),
        sigma=float(sigma),
        lasting=(float(lasting), 1.0 if lasting_time is None else math.exp(-FRAME_PERIOD / lasting_time)),
        exact=exact,
        odometry_sigmas=np.repeat(odometry_sigmas, 3).astype(float),
        sway=sway.numbers,
        pull=sway.PULL,
        steered=steered,
        car=_numbers(
            car,
            "wheelbase",
            "camera_forward",
            "max_speed",
            "max_acceleration",
            "max_steering",
            "max_steering_rate",
            "max_lateral_acceleration",
        ),
        lane=float(lane),
        slowest=float(slowest),
        body=np.array([[0.5 * side for side in car.size], car.body_c]),
        smooth=smooth,
        roughness=float(roughness),
        imu_place=tuple(map(float, imu.position)),
        imu_turn=tuple(matrix(imu.orientation).ravel().tolist()),
        has_head=head is not None,
        head=np.array([head.max_angles, head.max_rates]) if head else np.ones((2, 2)),
        weights=np.array([(weights or {}).get(name, 0.0) for name in WEIGHTS], dtype=np.float64),
    )


def _numbers(part: object, *names: str) -> tuple[float, ...]:
    return tuple(float(getattr(part, name)) for name in names)


def empty_fleet(count: int, normals: int, *, lasting: bool) -> Fleet:
    """State of rows before their first reset, with room for so many random numbers and for nothing in the scene.

    `lasting` says whether there are errors that last.
    """
    return _empty(Fleet, B=count, n=normals, C=COLUMNS, R=24 + RIDE_WAVES, E=4 if lasting else 0)


def empty_sensed(count: int, most: int, samples: int = 0) -> Sensed:
    """A frame that has brought nothing, with room for so many landmarks and inertial samples."""
    sensed = _empty(Sensed, B=count, N=most, n=samples, W=len(WEIGHTS))
    sensed.ids[...] = -1
    return sensed


def _empty(kind: Callable[..., Record], **sizes: int) -> Record:
    """Record of zeros, whose annotations say the type and the axes of each array; an axis without a size is empty."""
    arrays = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        scalar, axes = get_args(hint)
        while inner := get_args(scalar):  # the scalar is innermost; NumPy 2.5 has fewer levels than 2.4
            scalar = inner[-1]
        shape = [int(axis) if axis.isdigit() else sizes.get(axis, 0) for axis in axes.split()]
        arrays[name] = np.zeros(shape, dtype=scalar)
    return kind(**arrays)


State = dict[str, Any]


class Kept:
    """Object whose state is the attributes `changes`; all others are as its arguments made them."""

    changes: ClassVar[tuple[str, ...]] = ()

    def snapshot(self) -> State:
        """The state, a copy that can be pickled; what nobody changes, as scenes, is shared."""
        return {name: _copied(getattr(self, name)) for name in self._state_names()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go back to a state, which stays as it is."""
        for name in self._state_names():
            setattr(self, name, _restored(getattr(self, name), state[name]))

    def _state_names(self) -> Collection[str]:
        return self.changes


class _GeneratorState(NamedTuple):
    """A random generator, with what it needs to spawn the next ones."""

    kind: type[np.random.BitGenerator]
    seeds: dict[str, Any]
    state: Mapping[str, Any]


def _copied(value: Any) -> Any:
    if isinstance(value, Kept):
        return value.snapshot()
    if isinstance(value, np.random.Generator):
        bits = value.bit_generator
        return _GeneratorState(type(bits), bits.seed_seq.state, bits.state)  # type: ignore[attr-defined]
    return [_copied(each) for each in value] if _is_list_of_such(value) else deepcopy(value)


def _restored(now: Any, state: Any) -> Any:
    """Value that an attribute of value `now` becomes."""
    if isinstance(now, Kept):
        now.restore(state)
        return now
    if isinstance(state, _GeneratorState):
        bits = state.kind(np.random.SeedSequence(**state.seeds))
        bits.state = state.state
        return np.random.Generator(bits)
    if isinstance(state, list) and (_is_list_of_such(now) or _is_list_of_such(state)):
        pairs = zip(now if len(now) == len(state) else [None] * len(state), state, strict=True)
        return [_restored(*pair) for pair in pairs]
    return deepcopy(state)


def _is_list_of_such(value: Any) -> bool:
    """Whether something is a list with generators or `Kept` in it."""
    such = Kept, np.random.Generator, _GeneratorState
    return isinstance(value, list) and any(isinstance(each, such) or _is_list_of_such(each) for each in value)
