"""The ASL layout of the EuRoC MAV data and of TUM-VI: raw images, rectified on reading.

`mav0/cam0` (left) and `mav0/cam1` (right), each with `data.csv` (timestamp in ns, file name), `data/` with the images,
and `sensor.yaml`: T_BS, which takes points of the camera to the body, the resolution, pinhole intrinsics (fu, fv, cu,
cv) and a distortion, radial-tangential or equidistant. TUM-VI has Kalibr's `dso/camchain.yaml` instead. Truth is
`mav0/state_groundtruth_estimate0/data.csv`, of TUM-VI `mav0/mocap0/data.csv`: timestamp in ns, position and quaternion
(w first) of the body in its own world, of EuRoC its velocity and the biases of gyros and accelerometers. Inertial
samples are `mav0/imu0/data.csv`: timestamp in ns, angular rates, specific forces; the unit is that of `sensor.yaml`
there (T_BS, densities of the noise), of TUM-VI that of `dso/imu_config.yaml`, which is the body itself. Odometry is
`mav0/odom0/data.csv`, see `asl_writer`.

Frame k is row k of `cam0/data.csv`. The images are rectified on reading, so the camera of the sequence is not the one
in the file. The truth is that of the turned left camera; frames outside the time that it covers are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, InertialSamples, InertialUnit, Pose
from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.datasets.layouts import reference_for
from stereo_slam_env.datasets.restated import TrueMotion, as_they_are, rates_between, sample_of_files
from stereo_slam_env.datasets.sequence import Choice, ImageFiles, RecordedSequence, poses_at
from stereo_slam_env.files.opening import is_plain_name
from stereo_slam_env.files.readers import finite_rows, read_text
from stereo_slam_env.recording.inertial import samples_of_steps
from stereo_slam_env.recording.recording import NO_REFERENCE
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.sensing.imu import GRAVITY
from stereo_slam_env.sensing.lenses import Rectification
from stereo_slam_env.sensing.rig_files import body_of_camera, imu_shift, noise_of_unit, read_calibration

NAME = "euroc"
_IN_MAV0 = tuple(f"mav0/{camera}/{name}" for camera in ("cam0", "cam1") for name in ("data.csv", "sensor.yaml"))
_CAMCHAIN = "dso/camchain.yaml"
FILES = (
    _IN_MAV0,
    tuple(name.removeprefix("mav0/") for name in _IN_MAV0),
    ("mav0/cam0/data.csv", "mav0/cam1/data.csv", _CAMCHAIN),
)
_INERTIAL, _UNIT, _ODOMETRY = "imu0", "dso/imu_config.yaml", "odom0"
_LOWER = np.tril_indices(6)
_WITH_STATES = 16
"""Numbers of a row of truth with velocity and biases."""
TRUTHS = ("state_groundtruth_estimate0", "mocap0")
STATED = "The poses of {}, interpolated and carried over to the rectified left camera."
_NORM = 1e-2
"""Largest difference to 1 of the norm of a quaternion."""
_LATEST_NS = np.iinfo(np.int64).max


def open_sequence(path: Path, choice: Choice, *, use_truth: bool = True) -> RecordedSequence:
    """Open the folder that holds `mav0`, or `mav0` itself.

    Parameters
    ----------
    path : Path
        For example `MH_01_easy`.
    choice : Choice
        Frames to use, see `open_image_sequence`, also for what is raised.
    use_truth : bool
        Whether to read the truth, where there is one, and to leave out the frames that it does not cover.
    """
    path = path.resolve()
    root = path / "mav0" if (path / "mav0").is_dir() else path
    cameras = root / "cam0", root / "cam1"
    stamps, left_names = _read_listing(cameras[0])
    right_of = dict(zip(*_read_listing(cameras[1]), strict=True))
    left = _existing(cameras[0], dict(enumerate(left_names)))
    right = _existing(cameras[1], {k: right_of[stamp] for k, stamp in enumerate(stamps) if stamp in right_of})
    calibration = cameras[0] / "sensor.yaml"
    calibration = calibration if calibration.exists() else root.parent / _CAMCHAIN
    stated = read_calibration(calibration)
    if not isinstance(stated, Rectification):
        raise ValueError(
            f"{calibration} is of rectified images, this layout has raw ones: put the file of the maker there"
        )
    rectify, notes = as_they_are(stated, lambda: sample_of_files((left, right), stated.lenses[0].size), str(root))
    ns = np.array(stamps, dtype=np.int64)
    seconds = 1e-9 * (ns - ns[0])
    T_bc, inertial = body_of_camera(calibration), []
    if (root / _INERTIAL / "data.csv").exists():
        inertial = _samples(root / _INERTIAL, ns, T_bc, rectify.R_left, imu_shift(calibration))
    tables = [root / name / "data.csv" for name in TRUTHS]
    truth, truth_from, table = None, NO_REFERENCE, next((path for path in tables if path.exists()), tables[0])
    if use_truth and table.exists():
        rows_ns, rows, states = _read_truth(table)
        T_sc = _camera_in_truth(table, T_bc, rectify.R_left)
        sound = finite_rows(rows) & (np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) < _NORM)
        seconds_of_rows = 1e-9 * (rows_ns - ns[0])
        poses = Trajectory(rows[sound, :3], rows[sound, 3:], seconds_of_rows[sound], gauge=None)
        truth, choice = poses_at(poses, seconds, T_sc, table, choice)
        truth_from = reference_for(rows[:, :3], STATED.format(table.parent.name))
    folders = cameras[0] / "data", cameras[1] / "data"
    odometry = _odometry(root / _ODOMETRY / "data.csv", ns, rectify.R_left)
    listing = cameras[0] / "data.csv"
    files = ImageFiles(folders, (left, right), seconds, listing, truth, table, odometry, inertial)
    name = root.parent.name if root.name == "mav0" else root.name
    source: dict[str, Any] = {
        "reader": NAME,
        "path": str(root),
        "rectified": "cv2.stereoRectify, alpha 0",
        "epoch_s": 1e-9 * int(ns[0]),
        **({"notes": list(notes)} if notes else {}),
    }
    sequence = RecordedSequence(
        f"{NAME}_{name}", files, choice, lambda image: rectify.camera, source, truth_from, rectify
    )
    origin = None if truth is None else truth[sequence.frame_numbers[0]]
    if origin is not None:  # its world has z up
        sequence.gravity = tuple((origin.R_wc.T @ [0.0, 0.0, -GRAVITY]).tolist())
        if states.any():  # zeros throughout fill a place
            rates = rates_between(seconds_of_rows[sound], rows[sound, 3:])
            biases = states[sound, 3:] if states[:, 3:].any() else None
            sequence.motion = TrueMotion(seconds_of_rows[sound], states[sound, :3], rates, biases), T_sc
    return sequence


def _odometry(path: Path, ns: IntArray, turned: FloatArray) -> list[BodyVelocity | None]:
    """Mean velocity of the turned left camera over the step to each frame; none where there is no row of its stamp."""
    if not path.exists():
        return []
    stamps, rows = _read_stamped(path, 6 + len(_LOWER[0]))
    by_stamp, turn = dict(zip(stamps.tolist(), rows, strict=True)), np.kron(np.eye(2), turned)
    steps: list[BodyVelocity | None] = []
    for stamp in ns.tolist():
        if (row := by_stamp.get(stamp)) is None:
            steps.append(None)
            continue
        P = np.zeros((6, 6))
        P[_LOWER] = row[6:]
        P = turn @ (P + np.tril(P, -1).T) @ turn.T
        try:
            steps.append(BodyVelocity(turned @ row[:3], turned @ row[3:6], P))
        except ValueError as error:
            raise ValueError(f"{path}: the row of {stamp} is no velocity with a covariance: {error}") from error
    return steps


def _read_listing(folder: Path) -> tuple[list[int], list[str]]:
    """Timestamps, ns, and file names of `data.csv`."""
    path = folder / "data.csv"
    stamps, names = [], []
    for number, line in _rows(path):
        stamp, _, name = (part.strip() for part in line.partition(","))
        if not re.fullmatch(r"[0-9]{1,19}", stamp) or int(stamp) > _LATEST_NS or not is_plain_name(name):
            raise ValueError(f"{path}: line {number} is not 'timestamp in ns,file name': correct it")
        stamps.append(int(stamp))
        names.append(name)
    if not stamps:
        raise ValueError(f"{path} lists no images: copy it again")
    return stamps, names


def _rows(path: Path) -> Iterator[tuple[int, str]]:
    """Lines of a table with their numbers, without comments and empty ones."""
    for number, line in enumerate(read_text(path, errors="replace").splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line


def _existing(folder: Path, names: dict[int, str]) -> dict[int, Path]:
    paths = {k: folder / "data" / name for k, name in names.items()}
    return {k: path for k, path in paths.items() if path.is_file()}


def _camera_in_truth(table: Path, T_bc: FloatArray, turned: FloatArray) -> Pose:
    """Pose of the turned left camera in the body of the true poses, which is that of the rig, or one on it."""
    sensor = table.with_name("sensor.yaml")
    T_bs: FloatArray = body_of_camera(sensor) if sensor.exists() else np.eye(4)
    T_sc: FloatArray = np.linalg.solve(T_bs, T_bc).astype(np.float64)
    return Pose(T_sc[:3, 3], Rotation.from_matrix(T_sc[:3, :3] @ turned.T).as_quat())


def _samples(
    folder: Path, stamps: IntArray, T_bc: FloatArray, turned: FloatArray, shift: float
) -> list[InertialSamples | None]:
    """Inertial samples of the step to each frame; the unit is told in the frame of the turned left camera.

    `shift` is added to times of the images for those of the unit, s.
    """
    table, sheet, T_bi = folder / "data.csv", folder / "sensor.yaml", np.eye(4)
    if sheet.exists():
        T_bi = body_of_camera(sheet)
    else:
        sheet = folder.parents[1] / _UNIT
    T_ci = np.linalg.solve(T_bc, T_bi)
    orientation = Rotation.from_matrix(turned @ T_ci[:3, :3]).as_quat()
    unit = InertialUnit(turned @ T_ci[:3, 3], orientation, *noise_of_unit(sheet))
    rows_ns, rows = _read_stamped(table, 6)
    return samples_of_steps(table, 1e-9 * (rows_ns - stamps[0]), rows, 1e-9 * (stamps - stamps[0]) + shift, unit)


def _read_truth(path: Path) -> tuple[IntArray, FloatArray, FloatArray]:
    """Timestamps (K,) ns, increasing, rows (K, 7), position and quaternion xyzw, and (K, 9) or (K, 0), states."""
    has_states = next((line.count(",") >= _WITH_STATES for _, line in _rows(path)), False)
    stamps, rows = _read_stamped(path, _WITH_STATES if has_states else 7)
    return stamps, rows[:, [0, 1, 2, 4, 5, 6, 3]], rows[:, 7:]


def _read_stamped(path: Path, count: int) -> tuple[IntArray, FloatArray]:
    """Timestamps (K,) ns, increasing, and the `count` numbers behind them."""
    stamps, rows = [], []
    for number, line in _rows(path):
        words = line.split(",")
        try:
            stamp, row = np.int64(words[0]), [float(word) for word in words[1 : count + 1]]
            if len(row) < count:
                raise ValueError
        except (ValueError, OverflowError) as error:
            raise ValueError(
                f"{path}: line {number} is not a timestamp in ns and {count} numbers: correct it"
            ) from error
        stamps.append(stamp)
        rows.append(row)
    if len(rows) < 2 or not (np.diff(stamps) > 0).all():
        raise ValueError(f"{path} must have two rows or more with increasing timestamps: copy it again")
    return np.array(stamps, dtype=np.int64), np.array(rows)
