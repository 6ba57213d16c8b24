"""State of many environments in arrays, and what is the same for all of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from filters.geometry.camera import StereoCamera
from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.envs.options import DriveOptions, HeadOptions, StereoOptions
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT
from stereo_slam_env.world.routes import FRAME_PERIOD, Route
from stereo_slam_env.world.vehicle import Car, RouteDriver

NOISE_KINDS = {"pixels": 0, "quantised": 1, "uvd": 2}
"""Noise models that the kernels have; others are drawn one environment after the other."""
NO_NOISE = 3
WEIGHTS = ("progress", "tracking", "collision", "goal", "time", "effort")
"""Terms of the reward, in the order of their columns."""


class Rules(NamedTuple):
    """What is the same for all environments."""

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
    odometry_sigmas: FloatArray
    positions: FloatArray
    """Of the route, (K, 3)."""
    arc_length: FloatArray
    """(K,)."""
    speeds: FloatArray
    yaw_rates: FloatArray
    travel: FloatArray
    """Of the directions of the steps, (K - 1, 9)."""
    attitudes: FloatArray
    """(K, 9)."""
    sway: FloatArray
    """Standard deviations, decays and fresh parts of the disturbance of a scripted drive, (3, 6)."""
    pull: float
    steered: bool
    car: tuple[float, ...]
    """Wheelbase, camera forward, largest speed, acceleration, steering angle and steering rate."""
    body: FloatArray
    """Half the size of the car's body, and its centre in the camera frame; (2, 3)."""
    has_head: bool
    head: FloatArray
    """Largest angles and largest rates; (2, 2)."""
    arena: float
    weights: FloatArray
    """Of `WEIGHTS`, (6,)."""


class Fleet(NamedTuple):
    """State of B environments; landmarks and solids have room for the largest scene."""

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
    step: IntArray
    nearest: IntArray
    """Nearest frame of the route, (B,)."""
    farthest: FloatArray
    """How much of the route has been driven, m."""
    distance: FloatArray
    lost: BoolArray
    """Landmarks that have been tracked and are not to be again, (B, L)."""
    landmarks: FloatArray
    """In W, (B, 3, L)."""
    sizes: IntArray
    """Landmarks of a scene, and nodes of the tree of its solids, (B, 2)."""
    solids: FloatArray
    bounds: NDArray[np.float32]
    links: IntArray
    """See `world.rays.Obstacles`."""
    normals: FloatArray
    """Random numbers of the three streams of motion, odometry and noise, (B, 3, n)."""
    exponentials: FloatArray
    """Those of the choice of landmarks, (B, m)."""
    used: IntArray
    """How many of each have been used, (B, 4)."""


class Outcome(NamedTuple):
    """What a frame of B environments brings."""

    ids: IntArray
    """Landmarks that are tracked, ascending; (B, N), -1 in padding."""
    uvd: FloatArray
    v_right: FloatArray
    seen: IntArray
    """Number of landmarks, (B,)."""
    odometry: FloatArray
    """(B, 6)."""
    terms: FloatArray
    """Of the reward, without weights, (B, 6)."""
    collision: BoolArray
    failed: BoolArray
    success: BoolArray


def rules_of(options: StereoOptions, route: Route, camera: StereoCamera, arena: float) -> Rules:
    """What environments with these options do."""
    car, tracking = Car(), options.tracking
    driver = RouteDriver(route, options.perturbation, np.random.default_rng(0))
    head = options.head(camera.baseline) if isinstance(options, HeadOptions) else None
    return Rules(
        dt=FRAME_PERIOD,
        camera=_numbers(camera, "fx", "fy", "cx", "cy", "disparity_constant", "baseline", "width", "height"),
        camera_height=CAMERA_HEIGHT,
        limits=_numbers(tracking, "nearest", "farthest", "margin"),
        most=tracking.max_landmarks,
        refill_below=tracking.refill_below,
        revisit=tracking.revisit,
        noise=NOISE_KINDS.get(options.noise, NO_NOISE),
        sigma=float(options.sigma),
        odometry_sigmas=np.repeat([options.odometry_sigma_linear, options.odometry_sigma_angular], 3).astype(float),
        positions=route.positions,
        arc_length=route.arc_length,
        speeds=route.speeds,
        yaw_rates=route.yaw_rates,
        travel=route.travel.reshape(-1, 9),
        attitudes=route.attitudes.reshape(-1, 9),
        sway=driver.sway,
        pull=driver.PULL,
        steered=isinstance(options, DriveOptions) and options.policy == "agent",
        car=_numbers(
            car, "wheelbase", "camera_forward", "max_speed", "max_acceleration", "max_steering", "max_steering_rate"
        ),
        body=np.array([[0.5 * side for side in car.size], car.body_c]),
        has_head=head is not None,
        head=np.array([head.max_angles, head.max_rates]) if head else np.ones((2, 2)),
        arena=arena,
        weights=np.array([getattr(options, f"{name}_weight", 0.0) for name in WEIGHTS], dtype=np.float64),
    )


def _numbers(part: object, *names: str) -> tuple[float, ...]:
    return tuple(float(getattr(part, name)) for name in names)


def empty_fleet(count: int, landmarks: int, solids: int, normals: int, exponentials: int) -> Fleet:
    """State of environments before their first reset, with room for so much."""
    return Fleet(
        body=np.zeros((count, 7)),
        pose=np.zeros((count, 7)),
        velocity=np.zeros((count, 6)),
        angles=np.zeros((count, 2)),
        sway=np.zeros((count, 6)),
        car=np.zeros((count, 3)),
        step=np.zeros(count, dtype=np.int64),
        nearest=np.zeros(count, dtype=np.int64),
        farthest=np.zeros(count),
        distance=np.zeros(count),
        lost=np.zeros((count, landmarks), dtype=np.bool_),
        landmarks=np.zeros((count, 3, landmarks)),
        sizes=np.zeros((count, 2), dtype=np.int64),
        solids=np.zeros((count, solids, 9)),
        bounds=np.zeros((count, solids, 6, 8), dtype=np.float32),
        links=np.zeros((count, solids, 8), dtype=np.int64),
        normals=np.zeros((count, 3, normals)),
        exponentials=np.zeros((count, exponentials)),
        used=np.zeros((count, 4), dtype=np.int64),
    )


def empty_outcome(count: int, most: int) -> Outcome:
    """A frame that has brought nothing."""
    return Outcome(
        ids=np.full((count, most), -1),
        uvd=np.zeros((count, most, 3)),
        v_right=np.zeros((count, most)),
        seen=np.zeros(count, dtype=np.int64),
        odometry=np.zeros((count, 6)),
        terms=np.zeros((count, len(WEIGHTS))),
        collision=np.zeros(count, dtype=np.bool_),
        failed=np.zeros(count, dtype=np.bool_),
        success=np.zeros(count, dtype=np.bool_),
    )
