"""Reference problems with an inertial unit: smooth drives and flights past a cloud of points, in closed form.

A car on a winding road with changing speed: its body pitches and rolls with the accelerations, and follows the
unevenness of the road. A camera that is carried through a hall, in all six degrees of freedom. Both are sums of waves
with phases of the seed, so that accelerations are continuous; samples, odometry and measurements are all of one path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, Pose, Start, StereoCamera, StereoObservation
from filters.contract.validation import finite_array, positive
from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.recording.recording import SIMULATION, Frame, LandmarkTruth, Recording, Velocity
from stereo_slam_env.sensing.corruptions import NOISE_MODELS
from stereo_slam_env.sensing.imu import GRAVITY, DataSheet, Imu, Path
from stereo_slam_env.sensing.rigs import Rig, camera_of
from stereo_slam_env.sensing.smooth_paths import driven_path, flown_path, velocity_on

PERIOD = 0.1
"""s between two frames, unless another rate is asked for."""
DOWN = np.array([0.0, 1.0, 0.0])
START_SIGMAS = np.repeat([1e-6, 1e-6, 0.5, 0.05], 3)
"""Of what filters are told of the start: position, rotation, velocities."""
ODOMETRY_SIGMAS = np.repeat([0.1, 0.01], 3)
"""Of wheels and a yaw-rate sensor: m/s, rad/s."""
NEAREST, FARTHEST = 2.0, 60.0
"""Depth of measured points, m."""
LOST = 0.1
"""Share of the tracks that end in 0.1 s, as those of KLT do."""
_STOPPING = 1.0
"""s that it takes to stop, and to start again."""


def _recorded(
    name: str,
    along: Callable[[np.random.Generator], Path],
    box: tuple[float, float, float],
    seed: int,
    noise: str = "pixels",
    sigma: float = 1.0,
    frames: int = 200,
    landmarks: int = 40,
    rig: Rig = "reference",
    imu: str | DataSheet = "adis16448",
    imu_rate: float = 200.0,
    time_offset: float = 0.0,
    period: float = PERIOD,
    rest: Sequence[float] = (0.0, 0.0),
) -> Recording:
    """A camera on a path.

    Parameters
    ----------
    name : str
        Of the recording.
    along : callable
        Draws a path.
    box : tuple of float
        Half the width and height, and the depth, of where points are around the camera, m.
    seed : int
        Of the path, the points and all errors.
    noise, sigma, rig : str, float, str or StereoCamera or mapping
        As of `long_drive`.
    frames : int
        Length, one period each.
    landmarks : int
        Tracks in a frame.
    imu : str or DataSheet
        Data sheet of the unit, or the name of one of `sensing.imu.DATA_SHEETS`.
    imu_rate, time_offset : float
        Samples a second, and the error of its clock, s.
    period : float
        Time between two frames, s.
    rest : (2,) sequence of float
        Begin and end of a rest, s; it takes a second to stop before it, and another one to go on.

    Raises
    ------
    ValueError
        No such noise, rig or data sheet, or numbers that are too small.
    """
    unit = Imu(imu, rate=imu_rate, time_offset=time_offset)
    if noise not in NOISE_MODELS:
        raise ValueError(f"noise must be one of {', '.join(NOISE_MODELS)}, got {noise!r}")
    for what, value in (("frames", frames), ("landmarks", landmarks)):
        if type(value) is not int or value < 2:
            raise ValueError(f"{what} must be an integer >= 2, got {value!r}")
    period, (halt, go) = positive("period", period), finite_array("rest", rest, (2,)).tolist()
    if not 0.0 <= halt <= go:
        raise ValueError(f"rest must be its begin and its end, s, 0 <= begin <= end, got {rest!r}")
    camera, pixels = camera_of(rig), NOISE_MODELS[noise](sigma)
    path_rng, point_rng, imu_rng, sensor_rng, start_rng = np.random.default_rng(seed).spawn(5)
    level, times = along(path_rng), period * np.arange(frames, dtype=np.float64)
    if go > halt:
        level = _rested(level, halt, go)
    (origin,), R_0 = level(np.zeros(1))

    def path(t: FloatArray) -> tuple[FloatArray, Rotation]:
        """Path in W, the first camera."""
        at, R = level(t)
        return R_0.inv().apply(at - origin), R_0.inv() * R

    samples, _ = unit.measure(path, times, GRAVITY * R_0.inv().apply(DOWN)[0], imu_rng)
    positions, R = path(times)
    velocities = np.array([velocity_on(path, t) for t in times])
    width, height, depth = box
    spread = point_rng.uniform([-width, -height, NEAREST], [width, height, depth], (60 * frames, 3))
    points = positions[point_rng.integers(0, frames, 60 * frames)] + spread
    taken, seen = [], np.zeros(0, dtype=np.int64)
    for k in range(frames):
        points_c = R[k].inv().apply(points - positions[k])
        seen = _tracked(camera, points_c, seen, landmarks, LOST * (period / PERIOD), sensor_rng)
        uvd, v_right = pixels.corrupt(camera.project(points_c[seen]), sensor_rng)
        odometry = None
        if k:
            moved, turn = positions[k] - positions[k - 1], (R[k - 1].inv() * R[k]).as_rotvec()
            half_way = R[k - 1] * Rotation.from_rotvec(0.5 * turn)
            mean = np.concatenate([half_way.inv().apply(moved), turn]) / period
            mean += ODOMETRY_SIGMAS * sensor_rng.standard_normal(6)
            odometry = BodyVelocity(mean[:3], mean[3:], np.diag(ODOMETRY_SIGMAS**2))
        frame = Frame(
            float(times[k]),
            StereoObservation(seen, uvd, v_right),
            odometry,
            Pose(positions[k], R[k].as_quat()),
            Velocity(velocities[k, :3], velocities[k, 3:]),
            inertial=samples[k],
        )
        taken.append(frame)
    start_velocity = velocities[0] + START_SIGMAS[6:] * start_rng.standard_normal(6)
    start = Start(
        linear_velocity=start_velocity[:3], angular_velocity=start_velocity[3:], covariance=np.diag(START_SIGMAS**2)
    )
    source = {"problem": name, "seed": seed, "noise": noise, "sigma": sigma, "frames": frames, "landmarks": landmarks}
    source |= {"rig": rig if isinstance(rig, str) else str(rig), "imu": unit.name, "imu_rate": unit.rate}
    truth = LandmarkTruth(np.arange(len(points)), points)
    return Recording(
        name,
        camera,
        tuple(taken),
        pixels.stereo_noise,
        start,
        truth,
        source | {"time_offset": unit.time_offset, "period": period, "rest": [halt, go]},
        SIMULATION,
    )


def _tracked(
    camera: StereoCamera, points_c: FloatArray, seen: IntArray, most: int, lost: float, rng: np.random.Generator
) -> IntArray:
    """Ids of the points that are tracked on, less those that are lost, and of new ones up to `most`."""
    ahead = points_c[:, 2] > NEAREST
    in_view = ahead & camera.in_view(camera.project(np.where(ahead[:, None], points_c, [0.0, 0.0, 1.0])))
    visible = np.flatnonzero(in_view & (points_c[:, 2] < FARTHEST))
    kept_ids = seen[np.isin(seen, visible) & (rng.random(len(seen)) >= lost)]
    fresh = rng.permutation(np.setdiff1d(visible, seen))[: max(most - len(kept_ids), 0)]
    return np.sort(np.concatenate([kept_ids, fresh]))


def _rested(path: Path, halt: float, go: float) -> Path:
    """The path, with a rest from `halt` to `go`, s: its time stands still."""

    def moving(t: FloatArray) -> FloatArray:
        """Time of the path after t of a start from rest, whose speed grows as a half wave of a cosine."""
        share = np.clip(t / _STOPPING, 0.0, 1.0)
        return np.maximum(t - _STOPPING, 0.0) + 0.5 * _STOPPING * (share - np.sin(np.pi * share) / np.pi)

    return lambda t: path(moving(np.full(1, halt)) - moving(halt - t) + moving(t - go))


inertial_drive = partial(_recorded, "inertial-drive", driven_path, (15.0, 5.0, 40.0))
"""20 s of a car at some 8 m/s on a winding, uneven road."""
inertial_flight = partial(_recorded, "inertial-flight", flown_path, (15.0, 5.0, 30.0))
"""20 s with a camera in the hand or on a drone."""
