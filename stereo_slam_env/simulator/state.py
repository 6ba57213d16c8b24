"""State of B vehicles in arrays that can be copied while it runs, and what is the same for all of them."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from copy import deepcopy
from typing import Any, ClassVar, NamedTuple

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
WEIGHTS = ("progress", "tracking", "collision", "goal", "time", "effort")
"""Terms of the reward, in the order of their columns."""
ARENA = 60.0
"""m from the route: what is farther away has left the arena."""
ODOMETRY_SIGMAS = (0.1, 0.01)
"""Usual standard deviations of the odometry, each axis, m/s and rad/s."""


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
    """Of `WEIGHTS`, (6,)."""


class Fleet(NamedTuple):
    """State of B rows; landmarks, solids, moving bodies and routes have room for the largest scene."""

    body: FloatArray
    """Position and orientation of the camera as if it looked straight ahead, (B, 7)."""
    pose: FloatArray
    """Of the camera, (B, 7)."""
    velocity: FloatArray
    """Linear and angular velocity of the camera over the last step, (B, 6)."""
    angles: FloatArray
    """Of the head, (B, 2)."""
    sway: FloatArray
    """Disturbance of a scripted drive, (B, 6)."""
    car: FloatArray
    """Speed, steering angle and heading, (B, 3)."""
    ride: FloatArray
    """State of a smooth ride, see `ride`; (B, 31)."""
    step: IntArray
    nearest: IntArray
    """Nearest frame of the route, (B,)."""
    farthest: FloatArray
    """How much of the route has been driven, m."""
    distance: FloatArray
    turned: FloatArray
    """By how much the head has turned in the last step, rad; (B, 2)."""
    lost: BoolArray
    """Landmarks that have been tracked and are not to be again, (B, L)."""
    inside: NDArray[np.uint8]
    """Landmarks within range and inside both images, (B, L)."""
    seen: BoolArray
    """Landmarks that nothing hides, where the rules are not exact; (B, L)."""
    touching: BoolArray
    """Whether the car touches something, where the rules are not exact; (B,)."""
    positions: FloatArray
    """Of the route, (B, K, 3)."""
    arc_length: FloatArray
    """(B, K)."""
    speeds: FloatArray
    """Of the steps, (B, K), the last one unused, as those of `yaw_rates` and `travel`."""
    yaw_rates: FloatArray
    """(B, K)."""
    travel: FloatArray
    """Of the directions of the steps, (B, K, 9)."""
    attitudes: FloatArray
    """(B, K, 9)."""
    landmarks: FloatArray
    """In W, (B, 3, L)."""
    sizes: IntArray
    """Landmarks of a scene, nodes of the tree of its solids, moving bodies, frames of the route; (B, 4)."""
    solids: FloatArray
    bounds: NDArray[np.float32]
    links: IntArray
    """See `rays.Obstacles`."""
    tracks: FloatArray
    """Of moving bodies at each frame: place (x, y, z) in S, m, cosine and sine of the yaw; (B, M, K, 5)."""
    shares: IntArray
    """First part of each moving body, one past its last one, and its frames K; (B, M, 3)."""
    balls: FloatArray
    """Around each moving body: the ball in the frame of the body, then its centre now in S; (B, M, 7)."""
    parts: FloatArray
    """Solids of the moving bodies, in their frames, (B, P, 10)."""
    parts_now: FloatArray
    """The same in S, now."""
    lasting: FloatArray
    """Errors that last of each landmark, over their standard deviation: u, v left, u, v right; (B, L, 4).
    (B, L, 0) where the rules have none."""
    measured_at: IntArray
    """Frame in which each landmark was last measured, -1 where it never was; (B, L)."""
    normals: FloatArray
    """Random numbers of the three streams of motion, odometry and noise, (B, 3, n)."""
    exponentials: FloatArray
    """Those of the choice of landmarks, (B, m)."""
    used: IntArray
    """How many of each have been used, (B, 4)."""


class Sensed(NamedTuple):
    """Frame of B rows, in full precision."""

    ids: IntArray
    """Landmarks that are tracked, ascending; (B, N), -1 in padding."""
    uvd: FloatArray
    v_right: FloatArray
    number: IntArray
    """Of landmarks, (B,)."""
    odometry: FloatArray
    """(B, 6)."""
    inertial: FloatArray
    """Angular rates and specific forces in the frame of the inertial unit, over the step; (B, n, 6), n = 0 without a
    smooth ride."""
    terms: FloatArray
    """Of the reward, with weights, (6, B)."""
    reward: FloatArray
    beside: FloatArray
    """Distance of a car that is steered from its route, to the side, m; (B,)."""
    collision: BoolArray
    failed: BoolArray
    success: BoolArray


def make_rules(
    camera: StereoCamera,
    tracking: TrackingPolicy = TrackingPolicy(),  # noqa: B008 (frozen)
    *,
    noise: str = "pixels",
    sigma: float = 1.0,
    lasting: float = 0.0,
    lasting_time: float | None = None,
    odometry_sigmas: tuple[float, float] = ODOMETRY_SIGMAS,
    perturbation: float = 1.0,
    steered: bool = False,
    lane: float = math.inf,
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
    return Fleet(
        body=np.zeros((count, 7)),
        pose=np.zeros((count, 7)),
        velocity=np.zeros((count, 6)),
        angles=np.zeros((count, 2)),
        sway=np.zeros((count, 6)),
        car=np.zeros((count, 3)),
        ride=np.zeros((count, 24 + RIDE_WAVES)),
        step=np.zeros(count, dtype=np.int64),
        nearest=np.zeros(count, dtype=np.int64),
        farthest=np.zeros(count),
        distance=np.zeros(count),
        turned=np.zeros((count, 2)),
        lost=np.zeros((count, 0), dtype=np.bool_),
        inside=np.zeros((count, 0), dtype=np.uint8),
        seen=np.zeros((count, 0), dtype=np.bool_),
        touching=np.zeros(count, dtype=np.bool_),
        positions=np.zeros((count, 0, 3)),
        arc_length=np.zeros((count, 0)),
        speeds=np.zeros((count, 0)),
        yaw_rates=np.zeros((count, 0)),
        travel=np.zeros((count, 0, 9)),
        attitudes=np.zeros((count, 0, 9)),
        landmarks=np.zeros((count, 3, 0)),
        sizes=np.zeros((count, 4), dtype=np.int64),
        solids=np.zeros((count, 0, COLUMNS)),
        bounds=np.zeros((count, 0, 6, 8), dtype=np.float32),
        links=np.zeros((count, 0, 8), dtype=np.int64),
        tracks=np.zeros((count, 0, 0, 5)),
        shares=np.zeros((count, 0, 3), dtype=np.int64),
        balls=np.zeros((count, 0, 7)),
        parts=np.zeros((count, 0, COLUMNS)),
        parts_now=np.zeros((count, 0, COLUMNS)),
        lasting=np.zeros((count, 0, 4 if lasting else 0)),
        measured_at=np.zeros((count, 0), dtype=np.int64),
        normals=np.zeros((count, 3, normals)),
        exponentials=np.zeros((count, 0)),
        used=np.zeros((count, 4), dtype=np.int64),
    )


def empty_sensed(count: int, most: int, samples: int = 0) -> Sensed:
    """A frame that has brought nothing, with room for so many landmarks and inertial samples."""
    return Sensed(
        ids=np.full((count, most), -1),
        uvd=np.zeros((count, most, 3)),
        v_right=np.zeros((count, most)),
        number=np.zeros(count, dtype=np.int64),
        odometry=np.zeros((count, 6)),
        inertial=np.zeros((count, samples, 6)),
        terms=np.zeros((len(WEIGHTS), count)),
        reward=np.zeros(count),
        beside=np.zeros(count),
        collision=np.zeros(count, dtype=np.bool_),
        failed=np.zeros(count, dtype=np.bool_),
        success=np.zeros(count, dtype=np.bool_),
    )


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
