"""The reference problem: a drive past a cloud of points, pure geometry, for claims about consistency.

No physics, no occlusion, nothing but Eq. 6, Eq. 10 and Gaussian noise, so the filters' models hold exactly (but for the
accelerations, which are those of a car) and theory says what NEES and NIS must be. `long_drive` is the paper's
section 4.4 (800 frames, about 350 m, two wide turns), `short_turn` its section 4.3 (12 frames into a right turn).
"""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.recording.recording import SIMULATION, Frame, LandmarkTruth, Recording, Start, Velocity
from stereo_slam_env.sensing.pixel_noise import NOISE_MODELS
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT, Rig, camera_of
from stereo_slam_env.sensing.sensors import LandmarkSensor, TrackingPolicy
from stereo_slam_env.world.routes import FRAME_PERIOD, ROUTES, Route
from stereo_slam_env.world.vehicle import RouteDriver, advance

# What a filter knows at the start: the pose, and the velocity to this (m/s, rad/s).
START_SIGMAS = np.repeat([1e-6, 1e-6, 0.5, 0.05], 3)


def long_drive(
    seed: int,
    noise: str = "pixels",
    sigma: float = 1.0,
    frames: int = 800,
    landmarks: int = 90,
    rig: Rig = "reference",
) -> Recording:
    """800 frames, about 350 m, one wide turn to the left and one to the right (the paper's 4.4).

    Parameters
    ----------
    seed : int
        Of the cloud, the drive and the noise.
    noise : {"pixels", "uvd", "heavy-tailed", "quantised"}
        u_left, v_left, u_right, v_right independent, or u, v, d independent (the paper's assumption), or one of the
        others of `sensing.pixel_noise`, which are not Gaussian.
    sigma : float
        Standard deviation of each, px.
    frames : int
        Length.
    landmarks : int
        Most landmarks in one frame; refilled when fewer than 65 of 90 are left.
    rig : str, StereoCamera or mapping
        The stereo camera, see `sensing.rigs.camera_of`.

    Raises
    ------
    ValueError
        No such noise or rig, more frames than the route has, or no landmarks.
    """
    return _drive("long-drive", ROUTES["town"](), seed, noise, sigma, frames, landmarks, rig)


def short_turn(
    seed: int,
    noise: str = "pixels",
    sigma: float = 1.0,
    frames: int = 12,
    landmarks: int = 90,
    rig: Rig = "reference",
) -> Recording:
    """12 frames into a right turn (the paper's 4.3); arguments as for `long_drive`."""
    return _drive("short-turn", ROUTES["right-turn"](), seed, noise, sigma, frames, landmarks, rig)


def _drive(name: str, route: Route, seed: int, noise: str, sigma: float, frames: int, most: int, rig: Rig) -> Recording:
    if noise not in NOISE_MODELS:
        raise ValueError(f"noise must be one of {', '.join(NOISE_MODELS)}, got {noise!r}")
    if not 2 <= frames <= route.frames:
        raise ValueError(f"frames must be between 2 and {route.frames} on this route, got {frames!r}")
    if type(most) is not int or most < 1:
        raise ValueError(f"landmarks must be an integer >= 1, got {most!r}")
    camera = camera_of(rig)
    cloud_rng, drive_rng, sensor_rng, start_rng = np.random.default_rng(seed).spawn(4)
    positions = _points_along(route, cloud_rng)
    landmarks = LandmarkTruth(np.arange(len(positions)), positions)
    pixel_noise = NOISE_MODELS[noise](sigma)
    sensor = LandmarkSensor(
        camera,
        pixel_noise,
        landmarks,
        lambda pose, points: np.ones(len(points), dtype=bool),
        TrackingPolicy(max_landmarks=most, refill_below=round(most * 65 / 90)),
        sensor_rng,
    )
    driver = RouteDriver(route, 1.0, drive_rng)
    pose, velocity = driver.start()
    start = _start(velocity, start_rng)
    taken = [Frame(0.0, sensor.observe(pose), truth=pose, truth_velocity=velocity)]
    for k in range(1, frames):
        velocity = driver.drive(pose, np.zeros(2))
        pose = advance(pose, velocity, FRAME_PERIOD)
        taken.append(Frame(k * FRAME_PERIOD, sensor.observe(pose), truth=pose, truth_velocity=velocity))
    source = {
        "problem": name,
        "seed": seed,
        "noise": noise,
        "sigma": sigma,
        "frames": frames,
        "landmarks": most,
        "rig": rig if isinstance(rig, str) else asdict(camera),
    }
    return Recording(name, camera, tuple(taken), pixel_noise.stereo_noise, start, landmarks, source, SIMULATION)


def _start(velocity: Velocity, rng: np.random.Generator) -> Start:
    """The exact pose, and a velocity wrong by what the covariance says."""
    errors = START_SIGMAS[6:] * rng.standard_normal(6)
    return Start(
        linear_velocity=velocity.linear + errors[:3],
        angular_velocity=velocity.angular + errors[3:],
        covariance=np.diag(START_SIGMAS**2),
    )


def _points_along(route: Route, rng: np.random.Generator) -> FloatArray:
    """4 points a metre beside the road (4-14 m, 12 % of them on it) and 1 a metre far off (15-60 m); (N, 3) m in W."""
    ahead = 160.0
    length = route.length + ahead
    near_count, far_count = int(4 * length), int(length)
    near_side = rng.choice([-1.0, 1.0], near_count) * rng.uniform(4.0, 14.0, near_count)
    far_side = rng.choice([-1.0, 1.0], far_count) * rng.uniform(15.0, 60.0, far_count)
    near_height = rng.uniform(-6.0, CAMERA_HEIGHT, near_count)
    on_road = rng.random(near_count) < 0.12
    near_side[on_road] = rng.uniform(-4.0, 4.0, int(on_road.sum()))
    near_height[on_road] = CAMERA_HEIGHT
    along = rng.uniform(0.0, length, near_count + far_count)
    side = np.concatenate([near_side, far_side])
    down = np.concatenate([near_height, rng.uniform(-15.0, CAMERA_HEIGHT, far_count)])

    arc, heading = route.arc_length, np.interp(along, route.arc_length, route.headings)
    beyond = np.maximum(along - arc[-1], 0.0)
    x = np.interp(along, arc, route.positions[:, 0]) + beyond * np.sin(heading) + side * np.cos(heading)
    z = np.interp(along, arc, route.positions[:, 2]) + beyond * np.cos(heading) - side * np.sin(heading)
    return np.stack([x, down, z], axis=1)
