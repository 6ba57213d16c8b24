"""Reference problems: recordings of pure geometry, for claims about consistency.

No occlusion, nothing but the filters' models and Gaussian noise, so theory says what NEES and NIS must be.

A drive of the simulator past a cloud of points: Eq. 6 and Eq. 10 hold exactly, but for the accelerations, which are
those of a car. `long_drive` is the paper's section 4.4 (800 frames, about 350 m, two wide turns), `short_turn` its
section 4.3 (12 frames into a right turn).

Large orientation uncertainty, `relative_noise_loop`: a tumbling camera in a sparse cloud, with noise proportional to
what is measured. It is the simulation of Zhang, Wu, Song, Huang and Dissanayake, "Convergence and Consistency
Analysis for a 3-D Invariant-EKF SLAM" (RA-L 2017): 500 steps, 300 landmarks, and a standard deviation of `level`
times the value for every component of the odometry and of every measured point. Path, turn rates (0.67 rad a step on
average) and the box of landmarks are those of the simulation its authors released. What had to be chosen, for a
stereo camera:

- The published sensor sees points up to 120 degrees off its axis within 25 m, 6.5 of the 300 at a time. A pinhole
  camera does not; here it is 120 degrees wide and sees to 35 m, which gives the same number.
- The noise of a point is Gaussian in (x, y, z) with covariance Psi, carried to (u, v, d) by the Jacobian J of the
  projection: R = J Psi J^T is then exactly the covariance of what is measured. Projecting a noisy point would add a
  bias that no filter models.
- Psi is made of the true point and the covariance of the odometry of the true motion, so that the noise a filter is
  told is the noise there is. Values below 0.1 m and 0.01 rad count as these: R stays regular.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, StereoCamera, StereoNoise, StereoObservation
from filters.contract.inputs import Start
from filters.contract.validation import positive
from filters.geometry.arrays import FloatArray
from filters.geometry.poses import Pose
from stereo_slam_env.recording.recording import SIMULATION, Frame, LandmarkTruth, Recording, Velocity
from stereo_slam_env.sensing.corruptions import NOISE_MODELS
from stereo_slam_env.sensing.padding import TrackingPolicy
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT, RIGS, Rig, camera_of
from stereo_slam_env.simulator.scene_arrays import SceneArrays, scene_arrays
from stereo_slam_env.simulator.simulator import Simulator
from stereo_slam_env.simulator.state import make_rules
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.routes import ROUTES, Route
from stereo_slam_env.world.scene import Ground, Material, Scene


def _drive(
    name: str,
    route: str,
    seed: int,
    noise: str = "pixels",
    sigma: float = 1.0,
    frames: int = 800,
    landmarks: int = 90,
    rig: Rig = "reference",
) -> Recording:
    """A drive along a route past a cloud.

    Parameters
    ----------
    name, route : str
        Of the recording; one of `world.routes.ROUTES`.
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
    if noise not in NOISE_MODELS:
        raise ValueError(f"noise must be one of {', '.join(NOISE_MODELS)}, got {noise!r}")
    way = ROUTES[route]()
    if not 2 <= frames <= way.frames:
        raise ValueError(f"frames must be between 2 and {way.frames} on this route, got {frames!r}")
    if type(landmarks) is not int or landmarks < 1:
        raise ValueError(f"landmarks must be an integer >= 1, got {landmarks!r}")
    camera = camera_of(rig)
    cloud_rng, drive_rng, sensor_rng, start_rng = np.random.default_rng(seed).spawn(4)
    cloud, pixel_noise = _cloud_along(way, cloud_rng), NOISE_MODELS[noise](sigma)
    tracking = TrackingPolicy(max_landmarks=landmarks, refill_below=round(landmarks * 65 / 90))
    simulator = Simulator(make_rules(camera, tracking, noise=noise, sigma=sigma), 1, pixel_noise)
    simulator.put(0, cloud, [drive_rng, sensor_rng, np.random.default_rng(0), start_rng])
    only = np.ones(1, dtype=np.bool_)
    simulator.begin(only)
    taken = [simulator.frame(0)]
    for _ in range(1, frames):
        simulator.step(np.zeros((1, 2)), only)
        taken.append(replace(simulator.frame(0), odometry=None))
    start, truth = simulator.start(0), LandmarkTruth(np.arange(len(cloud.landmarks)), cloud.landmarks)
    source = {
        "problem": name,
        "seed": seed,
        "noise": noise,
        "sigma": sigma,
        "frames": frames,
        "landmarks": landmarks,
        "rig": rig if isinstance(rig, str) and rig in RIGS else asdict(camera),
    }
    return Recording(name, camera, tuple(taken), pixel_noise.stereo_noise, start, truth, source, SIMULATION)


long_drive = partial(_drive, "long-drive", "town")
"""800 frames, about 350 m, one wide turn to the left and one to the right (the paper's 4.4)."""
short_turn = partial(_drive, "short-turn", "right-turn", frames=12)
"""12 frames into a right turn (the paper's 4.3)."""


def _cloud_along(route: Route, rng: np.random.Generator) -> SceneArrays:
    """A scene of landmarks alone, nothing solid."""
    points_s, grey = WorldFrame(CAMERA_HEIGHT).to_scene(_points_along(route, rng)), Material((0.5, 0.5, 0.5))
    low, high = points_s[:, :2].min(axis=0), points_s[:, :2].max(axis=0)
    ground = Ground((float(low[0]), float(low[1])), (float(high[0]), float(high[1])), grey)
    return scene_arrays(Scene(ground, (), (), points_s), route)


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


# ---- large orientation uncertainty -----------------------------------------------------------------------------------

CAMERA = StereoCamera(230.0, 230.0, 399.5, 399.5, 0.5, 800, 800)
SIGHT = 35.0  # m
NEAREST = 1.0  # m
MARGIN = 30.0  # m, of the box of landmarks around the path
SMALLEST_LENGTH, SMALLEST_ANGLE = 0.1, 0.01
KNOWN_START = 1e-6


def relative_noise_loop(
    seed: int,
    level: float = 0.05,
    frames: int = 500,
    landmarks: int = 300,
    sight: float = SIGHT,
    point_level: float | None = None,
) -> Recording:
    """The tumbling camera, with odometry in every frame and an R for every measurement.

    Parameters
    ----------
    seed : int
        Of the landmarks and of all noise; the path is always the same.
    level : float
        Standard deviation of the noise, relative to what is measured; 0.01 and 0.05 are published.
    frames, landmarks : int
        Length, one second each, and landmarks in the box.
    sight : float
        How far the camera sees, m: the fewer landmarks in view, the larger the uncertainty.
    point_level : float, optional
        Level of the measured points, where it is not that of the odometry: the higher, the worse landmarks start.
    """
    level, sight = positive("level", level), positive("sight", sight)
    point_level = level if point_level is None else positive("point_level", point_level)
    if frames < 2:
        raise ValueError(f"frames must be at least 2, got {frames!r}")
    if landmarks < 1:
        raise ValueError(f"landmarks must be at least 1, got {landmarks!r}")
    rng = np.random.default_rng(seed)
    positions, rotations = _path(frames)
    box = positions.min(axis=0) - MARGIN, positions.max(axis=0) + MARGIN
    # W is the first camera frame.
    to_w, origin = rotations[0].inv(), positions[0]
    points_w = to_w.apply(rng.uniform(*box, (landmarks, 3)) - origin)
    positions, rotations = to_w.apply(positions - origin), to_w * rotations

    taken = []
    for k in range(frames):
        odometry, velocity = None, None
        if k:
            odometry, velocity = _step(positions[k - 1 : k + 1], rotations[k - 1 : k + 1], level, rng)
        observation = _observe(rotations[k].inv().apply(points_w - positions[k]), point_level, sight, rng)
        pose = Pose(positions[k], rotations[k].as_quat())
        taken.append(Frame(float(k), observation, odometry, truth=pose, truth_velocity=velocity))
    return Recording(
        "relative-noise-loop",
        CAMERA,
        tuple(taken),
        StereoNoise.independent_pixels(1.0),  # not used: every measurement brings its own
        Start(covariance=KNOWN_START**2 * np.eye(12)),
        LandmarkTruth(np.arange(landmarks), points_w),
        {"problem": "relative-noise-loop", "seed": seed, "level": level, "frames": frames}
        | {"landmarks": landmarks, "sight": sight, "point_level": point_level},
        SIMULATION,
    )


def _path(frames: int) -> tuple[FloatArray, Rotation]:
    """Positions (frames, 3), m, on a closed curve of about 100 x 80 x 40 m, and orientations that tumble."""
    k = np.arange(frames)
    positions = np.stack([50 * np.cos(0.075 * k), 40 * np.sin(0.05 * k), 20 * np.sin(0.05 * k + 1.0)], axis=1)
    return positions, Rotation.from_euler("xyz", np.stack([0.5 * k + 2.0, -0.3 * k, 0.4 * k], axis=1))


def _step(
    positions: FloatArray, rotations: Rotation, level: float, rng: np.random.Generator
) -> tuple[BodyVelocity, Velocity]:
    """Odometry of one step, the linear part in the camera frame half-way through the turn; and the true velocity."""
    moved = positions[1] - positions[0]
    turn = (rotations[0].inv() * rotations[1]).as_rotvec()
    half_way = rotations[0] * Rotation.from_rotvec(0.5 * turn)
    linear = half_way.inv().apply(moved)
    smallest = np.repeat([SMALLEST_LENGTH, SMALLEST_ANGLE], 3)
    sigmas = level * np.maximum(np.abs(np.concatenate([linear, turn])), smallest)
    errors = sigmas * rng.standard_normal(6)
    return BodyVelocity(linear + errors[:3], turn + errors[3:], np.diag(sigmas**2)), Velocity(moved, turn)


def _observe(points_c: FloatArray, level: float, sight: float, rng: np.random.Generator) -> StereoObservation:
    """Measurements of the points (N, 3), given in the camera frame."""
    ids = np.flatnonzero((points_c[:, 2] > NEAREST) & (np.linalg.norm(points_c, axis=1) < sight))
    ids = ids[CAMERA.in_view(CAMERA.project(points_c[ids]))]
    points_seen = points_c[ids]
    sigmas = level * np.maximum(np.abs(points_seen), SMALLEST_LENGTH)
    J = CAMERA.project_jacobian(points_seen)
    root = J * sigmas[:, None, :]
    errors = np.einsum("mij,mj->mi", root, rng.standard_normal(points_seen.shape))
    return StereoObservation(ids, CAMERA.project(points_seen) + errors, R=root @ root.transpose(0, 2, 1))
