"""Dense stereo feature tracks, as GTSAM's example data over the first frames of KITTI odometry 00 are stored.

`read_example` reads those inside the gtsam wheel (135 frames, 110 m, one 90 degree turn), `read` a folder with true
poses. Layout: `stereo_factors.txt` (frame_id landmark_id uL uR v X Y Z), `calibration.txt` (fx fy skew cx cy baseline),
`vo_poses.txt` (frame_id, 4x4 T_world_cam by stereo odometry), and, for scoring, `poses.txt` (T_world_cam of
the left camera) and `times.txt`, in place of which the rate of the frames can be given. Beside them may lie
`imu_100hz.csv` (t on the clock of the frames, specific forces, rates; x forward, y left, z up), of the GPS/IMU unit of
the car.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from filters import InertialUnit, Pose, Start, StereoCamera, StereoNoise
from filters.contract.extras import install_command
from filters.contract.validation import positive
from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.datasets.registry import known_by, reference_for
from stereo_slam_env.datasets.tracks import ASSUMED_SIGMA_PX, PointTracks, frames_of, stated_or_assumed
from stereo_slam_env.files.opening import is_there
from stereo_slam_env.files.readers import read_poses, read_table, require_rotations, split_poses
from stereo_slam_env.recording.inertial import samples_of_steps
from stereo_slam_env.recording.recording import Recording, Reference

NAME = "kitti00_stereo_tracks"
FILES = (("stereo_factors.txt", "calibration.txt", "vo_poses.txt", "poses.txt"),)
STATED = "poses.txt of the recording."
MOVED = "It is moved as a whole onto the stereo odometry of frame {}: its place is not independent of the images."
EXAMPLE = ("VO_stereo_factors00.txt", "VO_calibration00.txt", "VO_camera_poses00.txt")
"""Stereo factors, calibration and poses of the example in the gtsam wheel."""
EXAMPLE_INTERVAL = 0.1037  # s between frames; the wheel holds no times
EXAMPLE_REFERENCE = Reference(
    "odometry", "The stereo odometry that comes with the tracks and was fitted to the same pixels."
)
FACTS = {"image_size": (1241, 376), "sigma_px": ASSUMED_SIGMA_PX}
"""Of the public recording: rectified images of the drives of 2011_10_03."""


INERTIAL = "imu_100hz.csv"
UNIT = InertialUnit(
    position=np.array([-0.32, 0.72, -1.08]),
    orientation=np.array([0.5, -0.5, 0.5, 0.5]),
    gyro_density=1.75e-4,
    accelerometer_density=1e-2,
    gyro_walk=2.9e-6,
    accelerometer_walk=1.7e-4,
)
"""The OXTS RT3003 of the car: its place by the calibration of the drives of 2011_10_03, with its axes along those of
the camera, which they are to some 12 mrad; densities as GTSAM states them for its samples of this drive."""


def read(
    path: Path,
    *,
    sigma_px: float | None = None,
    max_per_frame: int | None = 100,
    image_size: tuple[int, int] | None = None,
    inertial: bool = False,
    rate: float | None = None,
) -> Recording:
    """Read the folder.

    Parameters
    ----------
    path : Path
        Folder with the files named in `FILES`.
    sigma_px : float, optional
        Standard deviation of a pixel coordinate to assume, px. None: `ASSUMED`, of a stranger's with a line in the log.
    max_per_frame : int, optional
        Thin the tracks to so many landmarks at a time, long tracks first; None keeps all (387 to 852 a frame, too
        many for a filter whose cost grows with their square or cube).
    image_size : (int, int), optional
        Width and height of the images, px. None: of the public recording; of a stranger's the smallest that hold all
        measurements, with a line in the log.
    inertial : bool
        Give the samples of `INERTIAL` too, and begin with the first frame after which every step has some (frame 14).
    rate : float, optional
        Frames a second, of frame ids 0, 1, 2, ..., where there is no `times.txt`.

    Returns
    -------
    Recording
        W is the left camera at frame 0, also where a later frame is the first. The ground truth of KITTI 00 is wrong
        before frame 16, so that those frames have none there. The rest is moved rigidly so that the first scored pose
        is the one of the stereo odometry, because the true pose of frame 0 need not be known. Frame ids may be absent:
        a longer step, no empty frame. No odometry. One common row v was stored, so there is no `v_right`.

    Raises
    ------
    ValueError
        A file is damaged, has the wrong shape, or holds NaN: the message names it. There are no times and no rate, or
        both.
    """
    frame_ids, odometry = _read_odometry(path / "vo_poses.txt")
    positions, orientations = read_poses(path / "poses.txt")
    times = _times(path, rate, len(positions))
    known = min(len(times), len(positions))
    if frame_ids[-1] >= known:
        raise ValueError(f"{path}: vo_poses.txt has frame {frame_ids[-1]}, times.txt and poses.txt end at {known - 1}")
    recording = known_by(positions)
    first = int(np.searchsorted(frame_ids, 0 if recording is None else recording.first_scored))
    truth: list[Pose | None] = [None] * len(frame_ids)
    truth_from = reference_for(positions, STATED)
    if first < len(frame_ids):
        description = f"{truth_from.description} {MOVED.format(frame_ids[first])}"
        truth_from = replace(truth_from, description=description)
        scored = frame_ids[first:]
        truth[first:] = _moved_to(odometry[first], positions[scored], orientations[scored])
    files = path / "stereo_factors.txt", path / "calibration.txt"
    source = {"reader": NAME, "path": str(path)}
    name = path.resolve().name if recording is None else NAME
    facts, given = None if recording is None else FACTS, {"sigma_px": sigma_px, "image_size": image_size}
    made = _recording(
        name, path, files, frame_ids, times[frame_ids], truth, facts, given, max_per_frame, source, truth_from
    )
    return _with_samples(made, path / INERTIAL, odometry) if inertial else made


def _times(path: Path, rate: float | None, count: int) -> FloatArray:
    """Times of the frames, s, of the file or by their rate."""
    file = path / "times.txt"
    if is_there(file):
        if rate is not None:
            raise ValueError(f"{file} says when the frames were taken: leave rate out, got {rate:g}")
        return read_table(file, 1).reshape(-1)
    if rate is None:
        raise ValueError(f"{path} has no times.txt: give the frames a second, rate=10 (--rate 10)")
    return np.arange(count) / positive("rate", rate)


def _with_samples(recording: Recording, path: Path, poses: FloatArray) -> Recording:
    """The frames from the first on after which every step has inertial samples, with these; it starts at its pose."""
    table = read_table(path, 7, delimiter=",", header_lines=1)
    times = np.array([frame.timestamp for frame in recording.frames])
    steps = samples_of_steps(path, table[:, 0], table[:, [4, 5, 6, 1, 2, 3]], times, UNIT)
    begin = max(k for k, step in enumerate(steps) if step is None)
    if begin == len(steps) - 1:
        raise ValueError(f"{path} does not reach to the last frame: it is of another recording")
    steps[begin] = None
    pairs = zip(recording.frames[begin:], steps[begin:], strict=True)
    return replace(
        recording,
        frames=tuple(replace(frame, inertial=samples) for frame, samples in pairs),
        start=Start(poses[begin, :3, 3], Rotation.from_matrix(poses[begin, :3, :3]).as_quat()),
        source={**recording.source, "inertial": INERTIAL},
    )


def read_example(*, sigma_px: float = ASSUMED_SIGMA_PX, max_per_frame: int | None = 100) -> Recording:
    """Read the example inside the gtsam wheel; options as of `read`.

    The wheel has no ground truth: the reference is the stereo odometry that comes with the tracks, which was fitted to
    the same pixels. It shows gross errors, not which filter is better by centimetres.

    Raises
    ------
    ImportError
        gtsam is not installed.
    """
    stereo_factors, calibration, poses = map(_in_wheel, EXAMPLE)
    frame_ids, odometry = _read_odometry(poses)
    truth: list[Pose | None] = [Pose(r, q) for r, q in zip(*split_poses(odometry), strict=True)]
    times = EXAMPLE_INTERVAL * frame_ids.astype(np.float64)
    files = stereo_factors, calibration
    source = {"reader": "gtsam:kitti00", "frame_interval_s": EXAMPLE_INTERVAL}
    reference = EXAMPLE_REFERENCE
    given = {"sigma_px": sigma_px, "image_size": None}
    return _recording(
        "gtsam_kitti00", poses, files, frame_ids, times, truth, FACTS, given, max_per_frame, source, reference
    )


def _in_wheel(file_name: str) -> Path:
    try:
        import gtsam
    except ImportError as error:
        raise ImportError(f"gtsam is not installed: {install_command('gtsam')}") from error
    try:
        return Path(str(gtsam.findExampleDataFile(file_name)))  # type: ignore[no-untyped-call,unused-ignore]
    except (FileNotFoundError, RuntimeError) as error:
        raise ValueError(f"the installed gtsam has no example file {file_name}: install gtsam 4.3 or newer") from error


def _read_odometry(path: Path) -> tuple[IntArray, FloatArray]:
    """Frame ids (K,), ascending, and T_world_cam (K, 4, 4) of a table `frame_id T00 ... T33`."""
    table = read_table(path, 17)
    frame_ids = table[:, 0].astype(np.int64)
    if not (np.diff(frame_ids) > 0).all():
        raise ValueError(f"{path}: frame ids must increase: sort the rows")
    matrices = table[:, 1:].reshape(-1, 4, 4)
    require_rotations(path, matrices)
    return frame_ids, matrices


def _recording(
    name: str,
    path: Path,
    files: tuple[Path, Path],
    frame_ids: IntArray,
    timestamps: FloatArray,
    truth: list[Pose | None],
    facts: Mapping[str, Any] | None,
    given: Mapping[str, Any],
    max_per_frame: int | None,
    source: Mapping[str, Any],
    truth_from: Reference,
) -> Recording:
    """The recording of stereo factors and calibration in two files; K frames with ascending ids, at `timestamps`, s."""
    stereo_factors, calibration = files
    fx, fy, _, cx, cy, baseline = read_table(calibration, 6)[0].tolist()
    table = read_table(stereo_factors, 8)
    ids = table[:, 0].astype(np.int64)
    unknown = np.setdiff1d(ids, frame_ids)
    if unknown.size:
        raise ValueError(f"{stereo_factors} has observations of frame {unknown[0]}, which has no pose")
    u_left, u_right, v = table[:, 2], table[:, 3], table[:, 4]
    tracks = PointTracks(
        np.searchsorted(frame_ids, ids),
        table[:, 1].astype(np.int64),
        np.column_stack([u_left, v, u_left - u_right]),
    )
    sigmas, size = stated_or_assumed(path, tracks, facts, **given)
    usable = tracks.with_positive_disparity()
    thinned = usable.thinned(max_per_frame)
    settings = {
        "sigma_px": float(sigmas["sigma_px"]),
        "max_per_frame": max_per_frame,
        "dropped_non_positive_disparity": len(tracks) - len(usable),
        "observations_used": len(thinned),
        "observations_in_file": len(tracks),
    }
    return Recording(
        name,
        StereoCamera(fx, fy, cx, cy, baseline, *size),
        frames_of(thinned, timestamps, truth),
        StereoNoise.independent_pixels(sigmas["sigma_px"]),
        source={**source, **settings},
        truth_from=truth_from,
    )


def _moved_to(anchor: FloatArray, positions: FloatArray, orientations: FloatArray) -> list[Pose]:
    """Poses moved rigidly so that the first of them becomes the 4x4 pose `anchor`."""
    rotations = Rotation.from_quat(orientations)
    turn = Rotation.from_matrix(anchor[:3, :3]) * rotations[0].inv()
    moved = turn.apply(positions - positions[0]) + anchor[:3, 3]
    return [Pose(r, q) for r, q in zip(moved, (turn * rotations).as_quat(), strict=True)]
