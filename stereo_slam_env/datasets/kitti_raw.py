"""The layout of the KITTI raw data (rectified and synchronised drives).

`DATE/calib_cam_to_cam.txt`, `calib_imu_to_velo.txt` and `calib_velo_to_cam.txt` beside the drive, and in
`DATE/DATE_drive_NNNN_sync/` the folders `image_00`, `image_01` (grey, left and right) or `image_02`, `image_03`
(colour), each with `timestamps.txt` and `data/NNNNNNNNNN.png`, and `oxts` with `timestamps.txt`, `dataformat.txt` and
`data/NNNNNNNNNN.txt`: one line of 30 numbers a frame from the GPS/IMU unit.

Truth is the pose of that unit, carried over to the left camera by the calibration (that of the odometry benchmark was
made in the same way); x east, y north, z up, by the formulas of the development kit (`readme.txt` and
`convertOxtsToPose.m`). Its velocities are given along forward, left and up of the level surface and are turned into the
unit's frame by roll and pitch; its accelerations and rates are inertial samples, one a frame. Row k is taken for the
step from frame k - 1 to k, which suits the ground truth best.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, InertialSamples, InertialUnit, Pose
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.image_files import numbered_images
from stereo_slam_env.datasets.kitti_odometry import CAMERAS, chosen_cameras
from stereo_slam_env.datasets.sequence import Choice, ImageFiles, RecordedSequence, known_poses, of_left_camera, rig_of
from stereo_slam_env.datasets.track_files import camera_velocities
from stereo_slam_env.files.opening import require_inside
from stereo_slam_env.files.readers import finite_rows, read_text
from stereo_slam_env.recording.inertial import samples_of_steps
from stereo_slam_env.recording.recording import Reference
from stereo_slam_env.sensing.projections import camera_position, entry, projections, read_entries

NAME = "kitti_raw"
TRUTH = Reference(
    "unknown",
    "The poses in oxts, carried over to the left camera by the calibration; the odometry is of the same files, with "
    "noise added.",
)
CALIBRATION = "calib_cam_to_cam.txt"
EXTRINSICS = ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt")
FILES = (
    (f"../{CALIBRATION}", "image_00/data", "image_01/data"),
    (f"../{CALIBRATION}", "image_02/data", "image_03/data"),
)
EARTH_RADIUS = 6378137.0
"""m, as in the development kit."""
OXTS_NUMBERS = 30
LAT, LON, ALT, ROLL, PITCH, YAW = range(6)
LEVEL_VELOCITY, BODY_FORCES, BODY_RATES = slice(8, 11), slice(11, 14), slice(17, 20)
"""Columns vf, vl, vu (m/s), ax, ay, az (m/s^2, gravity included) and wx, wy, wz (rad/s)."""
DENSITIES = 1.75e-4, 1e-2, 2.9e-6, 1.7e-4
"""Of the OXTS RT3003, as of `InertialUnit`."""


def open_sequence(
    path: Path,
    choice: Choice,
    *,
    cameras: str | None = None,
    use_oxts: bool = True,
    sigma_linear: float = 0.5,
    sigma_angular: float = 0.05,
    odometry_seed: int = 0,
) -> RecordedSequence:
    """Open `DATE/DATE_drive_NNNN_sync`.

    Parameters
    ----------
    path : Path
        The folder of the drive.
    choice : Choice
        Frames to use, see `open_image_sequence`, also for what is raised.
    cameras : {"grey", "colour"}, optional
        Which pair of cameras; None takes grey where present.
    use_oxts : bool
        Whether to take truth and odometry from the GPS/IMU unit, where there is one.
    sigma_linear, sigma_angular : float
        White noise that is added to the velocities of the GPS/IMU unit, m/s and rad/s per axis.
    odometry_seed : int
        Of that noise.
    """
    path = path.resolve()
    cameras, folders = chosen_cameras(lambda number: path / f"image_{number:02d}" / "data", cameras)
    calibration = require_inside(path.parent / CALIBRATION, path.parent)
    P = projections(calibration, [f"P_rect_{n:02d}" for n in CAMERAS[cameras]])
    times, oxts = folders[0].parent / "timestamps.txt", path / "oxts" / "data"
    seconds = _read_timestamps(times)
    truth, odometry, inertial = None, [], []
    if has_oxts := use_oxts and oxts.is_dir() and all((path.parent / name).exists() for name in EXTRINSICS):
        packets, T_ci = _read_packets(oxts, len(seconds)), _imu_to_reference_camera(path.parent, calibration)
        truth = of_left_camera(_reference_camera_poses(packets, T_ci), P[0])
        odometry = _odometry(packets, T_ci, camera_position(P[0]), sigma_linear, sigma_angular, odometry_seed)
        inertial = _samples(oxts, packets, seconds[: len(packets)], T_ci, camera_position(P[0]))
    images = numbered_images(folders[0]), numbered_images(folders[1])
    files = ImageFiles(folders, images, seconds, times, truth, oxts, odometry, inertial)
    source: dict[str, Any] = {
        "reader": NAME,
        "path": str(path),
        "cameras": cameras,
        "odometry": "velocities of the GPS/IMU unit with white noise added" if has_oxts else None,
        "sigma_linear_m_s": float(sigma_linear),
        "sigma_angular_rad_s": float(sigma_angular),
        "odometry_seed": int(odometry_seed),
    }
    return RecordedSequence(path.name, files, choice, rig_of(calibration, P), source, TRUTH)


def _read_timestamps(path: Path) -> FloatArray:
    """Lines `2011-09-26 13:02:25.964389445` as s since the first one; NaN where a line is no time."""
    try:
        lines = read_text(path).splitlines()
    except FileNotFoundError:
        raise ValueError(f"{path} is missing: copy it from the recording") from None
    while lines and not lines[-1].strip():
        lines.pop()
    stamps = np.array([_stamp(line) for line in lines], dtype="datetime64[ns]")
    good = stamps[~np.isnat(stamps)]
    if good.size == 0:
        raise ValueError(f"{path} holds no time such as '2011-09-26 13:02:25.964389445': copy it again")
    nanoseconds = (stamps - good[0]) / np.timedelta64(1, "ns")
    return np.asarray(1e-9 * nanoseconds)


def _stamp(line: str) -> np.datetime64:
    try:
        return np.datetime64(line.strip(), "ns") if "-" in line else _NO_TIME
    except ValueError:
        return _NO_TIME


_NO_TIME = np.datetime64("NaT", "ns")


def _read_packets(folder: Path, count: int) -> FloatArray:
    """One row of 30 numbers a frame, up to the last of `count` that has a file; NaN where it is missing or damaged."""
    packet_names = {path.name for path in folder.iterdir()}
    files = {k: folder / name for k in range(count) if (name := f"{k:010d}.txt") in packet_names}
    packets = np.full((max(files, default=-1) + 1, OXTS_NUMBERS), np.nan)
    for k, path in files.items():
        try:
            numbers = [float(word) for word in read_text(path).split()]
        except (OSError, ValueError):
            continue
        if len(numbers) == OXTS_NUMBERS:
            packets[k] = numbers
    return packets


def _imu_to_reference_camera(folder: Path, calibration: Path) -> FloatArray:
    """T (4, 4) that takes points from the IMU frame to the rectified frame of camera 00."""
    T = np.eye(4)
    for name in EXTRINSICS:
        path = require_inside(folder / name, folder)
        entries = read_entries(path)
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = entry(path, entries, "R", (3, 3)), entry(path, entries, "T", (3,))
        T = step @ T
    rectify = np.eye(4)
    rectify[:3, :3] = entry(calibration, read_entries(calibration), "R_rect_00", (3, 3))
    return np.asarray(rectify @ T, dtype=np.float64)


def _reference_camera_poses(packets: FloatArray, T_ci: FloatArray) -> list[Pose | None]:
    good = finite_rows(packets[:, :6])
    usable = np.where(good[:, None], packets[:, :6], 0.0)
    positions = _mercator_positions(*np.where(good[:, None], packets[:, :3], np.nan).T)
    R_wi = Rotation.from_euler("ZYX", usable[:, [YAW, PITCH, ROLL]])
    R_ci, t_ci = T_ci[:3, :3], T_ci[:3, 3]
    return known_poses(positions + R_wi.apply(-R_ci.T @ t_ci), R_wi * Rotation.from_matrix(R_ci.T), good)


def _odometry(
    packets: FloatArray,
    T_ci: FloatArray,
    left_in_reference: FloatArray,
    sigma_linear: float,
    sigma_angular: float,
    seed: int,
) -> list[BodyVelocity | None]:
    good = finite_rows(packets[:, :20])
    usable = np.where(good[:, None], packets[:, :20], 0.0)
    R_ci = T_ci[:3, :3]
    steps = camera_velocities(
        _levelled_to_body(usable[:, LEVEL_VELOCITY], usable[:, ROLL], usable[:, PITCH]),
        usable[:, BODY_RATES],
        R_ci,
        R_ci.T @ (left_in_reference - T_ci[:3, 3]),
        sigma_linear=sigma_linear,
        sigma_angular=sigma_angular,
        seed=seed,
    )
    return [step if ok else None for step, ok in zip(steps, good, strict=True)]


def _samples(
    path: Path, packets: FloatArray, seconds: FloatArray, T_ci: FloatArray, left_in_reference: FloatArray
) -> list[InertialSamples | None]:
    """Inertial samples of the step to each frame: the mean of the packets at its ends; None where one is no use."""
    unit = InertialUnit(T_ci[:3, 3] - left_in_reference, Rotation.from_matrix(T_ci[:3, :3]).as_quat(), *DENSITIES)
    numbers = np.hstack([packets[:, BODY_RATES], packets[:, BODY_FORCES]])
    good = np.flatnonzero(finite_rows(numbers) & np.isfinite(seconds))
    if len(good) < 2 or not (np.diff(seconds[good]) > 0.0).all():
        return []
    return samples_of_steps(path, seconds[good], numbers[good], seconds, unit)


def _mercator_positions(latitude: FloatArray, longitude: FloatArray, altitude: FloatArray) -> FloatArray:
    """Positions (K, 3), m, of (K,) degrees, degrees and m; true to scale at the first finite latitude."""
    finite = latitude[np.isfinite(latitude)]
    scale = np.cos(np.deg2rad(finite[0])) if finite.size else 1.0
    x = scale * EARTH_RADIUS * np.deg2rad(longitude)
    y = scale * EARTH_RADIUS * np.log(np.tan(np.deg2rad(90.0 + latitude) / 2.0))
    return np.column_stack([x, y, altitude])


def _levelled_to_body(vectors: FloatArray, roll: FloatArray, pitch: FloatArray) -> FloatArray:
    """Vectors (K, 3) along forward, left and up of the level earth's surface, in the unit's tilted frame."""
    tilt = Rotation.from_euler("YX", np.column_stack([pitch, roll]))
    body: FloatArray = tilt.inv().apply(vectors)
    return body
