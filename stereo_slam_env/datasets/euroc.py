"""The ASL layout of the EuRoC MAV data: raw images, rectified on reading.

`mav0/cam0` (left) and `mav0/cam1` (right), each with `data.csv` (timestamp in ns, file name), `data/` with the images,
and `sensor.yaml` (see `euroc_rig`). Truth is `mav0/state_groundtruth_estimate0/data.csv`: timestamp in ns, position and
quaternion (w first) of the body in its own world, and more columns that are not used.

Frame k is row k of `cam0/data.csv`. The images are rectified on reading, so the camera of the sequence is not the one
in the file. The truth is that of the turned left camera; frames outside the time that it covers are left out.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from filters.validation import FloatArray, IntArray
from stereo_slam_env.datasets.broken import Faults, OnBroken
from stereo_slam_env.datasets.euroc_rig import Sensor, read_sensor, read_transform, rectification
from stereo_slam_env.datasets.frames import Eye, Times, Truth, usable_pairs
from stereo_slam_env.datasets.sequence import RecordedSequence
from stereo_slam_env.files.inside import is_plain_name
from stereo_slam_env.files.tables import finite_rows
from stereo_slam_env.files.text import read_text
from stereo_slam_env.recording.recording import Pose, Reference

NAME = "euroc"
FILES = (
    "mav0/cam0/data.csv|cam0/data.csv",
    "mav0/cam0/sensor.yaml|cam0/sensor.yaml",
    "mav0/cam1/data.csv|cam1/data.csv",
    "mav0/cam1/sensor.yaml|cam1/sensor.yaml",
)
TRUTH = "state_groundtruth_estimate0"
TRUTH_FROM = Reference(
    "independent truth", f"{TRUTH}: motion capture or laser tracker, smoothed with the IMU; no camera has a part in it."
)
LARGEST_TRUTH_GAP_NS = 100_000_000
"""Truth is interpolated between rows that are no further apart (it comes at 200 Hz)."""
_LATEST_NS = np.iinfo(np.int64).max


def recognises(path: Path) -> bool:
    """Whether the folder, or its `mav0`, has this layout."""
    root = _root(path)
    return all((root / eye / name).is_file() for eye in ("cam0", "cam1") for name in ("data.csv", "sensor.yaml"))


def open_sequence(
    path: Path,
    *,
    first: int | None = None,
    last: int | None = None,
    on_broken: OnBroken = "raise",
    use_truth: bool = True,
) -> RecordedSequence:
    """Open the folder that holds `mav0`, or `mav0` itself.

    Parameters
    ----------
    path : Path
        For example `MH_01_easy`.
    first, last : int, optional
        Frame numbers to start and to end with, both included.
    on_broken : {"raise", "skip"}
        What to do about a pair that cannot be used.
    use_truth : bool
        Whether to read the truth, where there is one, and to leave out the frames that it does not cover.

    Raises
    ------
    ValueError
        Something is missing, damaged or contradictory: one line that names the file.
    """
    root = _root(path.resolve())
    faults = Faults(on_broken)
    stamps, left_names = _read_listing(root / "cam0")
    right_of = dict(zip(*_read_listing(root / "cam1"), strict=True))
    left_files = _existing(root / "cam0", dict(enumerate(left_names)))
    right_files = _existing(root / "cam1", {k: right_of[stamp] for k, stamp in enumerate(stamps) if stamp in right_of})
    sensors = (read_sensor(root / "cam0" / "sensor.yaml"), read_sensor(root / "cam1" / "sensor.yaml"))
    rig, turned, rectify = rectification(sensors, root / "cam1" / "sensor.yaml")
    ns = np.array(stamps, dtype=np.int64)
    times = Times(root / "cam0" / "data.csv", 1e-9 * (ns - ns[0]))
    truth, table = None, root / TRUTH / "data.csv"
    if use_truth and table.is_file():
        poses, covered = _camera_poses(table, ns, sensors[0], turned)
        truth = Truth(table, poses)
        first = max(first or 0, covered[0])
        last = covered[1] if last is None else min(last, covered[1])
    frames = usable_pairs(
        (Eye(root / "cam0" / "data", left_files), Eye(root / "cam1" / "data", right_files)),
        times,
        faults,
        truth=truth,
        first=first,
        last=last,
    )
    name = root.parent.name if root.name == "mav0" else root.name
    source: dict[str, Any] = {
        "reader": NAME,
        "path": str(root),
        "first": frames[0].number,
        "last": frames[-1].number,
        "on_broken": on_broken,
        "rectified": "cv2.stereoRectify, alpha 0",
    }
    return RecordedSequence(
        f"{NAME}_{name}", rig.camera, frames, faults, source, TRUTH_FROM, stored_size=sensors[0].size, rectify=rectify
    )


def _root(path: Path) -> Path:
    return path / "mav0" if (path / "mav0").is_dir() else path


def _read_listing(folder: Path) -> tuple[list[int], list[str]]:
    """Timestamps, ns, and file names of `data.csv`."""
    path = folder / "data.csv"
    stamps, names = [], []
    for number, line in enumerate(read_text(path, errors="replace").splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        stamp, _, name = (part.strip() for part in line.partition(","))
        if not re.fullmatch(r"[0-9]{1,19}", stamp) or int(stamp) > _LATEST_NS or not is_plain_name(name):
            raise ValueError(f"{path}: line {number} is not 'timestamp in ns,file name': correct it")
        stamps.append(int(stamp))
        names.append(name)
    if not stamps:
        raise ValueError(f"{path} lists no images: copy it again")
    return stamps, names


def _existing(folder: Path, names: dict[int, str]) -> dict[int, Path]:
    paths = {k: folder / "data" / name for k, name in names.items()}
    return {k: path for k, path in paths.items() if path.is_file()}


def _camera_poses(
    path: Path, stamps: IntArray, left: Sensor, turned: FloatArray
) -> tuple[list[Pose | None], tuple[int, int]]:
    """Poses of the turned left camera at the stamps, and the first and last frame that the truth covers.

    A pose is None where the rows around it hold NaN or are too far apart.
    """
    rows_ns, rows = _read_truth(path)
    T_bs_truth = np.eye(4)
    sensor = path.with_name("sensor.yaml")
    if sensor.is_file():
        T_bs_truth = read_transform(sensor)
    covered = np.flatnonzero((stamps >= rows_ns[0]) & (stamps <= rows_ns[-1]))
    if covered.size == 0:
        raise ValueError(f"{path} covers none of the images: it is of another recording, or use_truth=False")
    after = np.clip(np.searchsorted(rows_ns, stamps), 1, len(rows_ns) - 1)
    exact = rows_ns[after] == stamps
    before = np.where(exact, after, after - 1)
    finite = finite_rows(rows) & (np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) < 1e-2)
    near = exact | (rows_ns[after] - rows_ns[before] <= LARGEST_TRUTH_GAP_NS)
    inside = (stamps >= rows_ns[0]) & (stamps <= rows_ns[-1])
    good = inside & near & finite[after] & finite[before]
    usable = np.where(finite[:, None], rows, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    seconds = 1e-9 * (rows_ns - rows_ns[0])
    wanted = np.clip(1e-9 * (stamps - rows_ns[0]), seconds[0], seconds[-1])
    positions = np.column_stack([np.interp(wanted, seconds, usable[:, i]) for i in range(3)])
    R_ws = Slerp(seconds, Rotation.from_quat(usable[:, 3:]))(wanted)
    T_sc = np.linalg.solve(T_bs_truth, left.T_bs)
    camera_positions = positions + R_ws.apply(T_sc[:3, 3])
    orientations = (R_ws * Rotation.from_matrix(T_sc[:3, :3] @ turned.T)).as_quat()
    poses = [Pose(r, q) if ok else None for r, q, ok in zip(camera_positions, orientations, good, strict=True)]
    return poses, (int(covered[0]), int(covered[-1]))


def _read_truth(path: Path) -> tuple[IntArray, FloatArray]:
    """Timestamps (K,) ns, increasing, and rows (K, 7): position and quaternion xyzw."""
    stamps, rows = [], []
    for number, line in enumerate(read_text(path, errors="replace").splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        words = line.split(",")
        try:
            x, y, z, qw, qx, qy, qz = (float(word) for word in words[1:8])
            stamps.append(np.int64(words[0]))
        except (ValueError, OverflowError) as error:
            raise ValueError(f"{path}: line {number} is not a timestamp in ns and 7 numbers: correct it") from error
        rows.append([x, y, z, qx, qy, qz, qw])
    if len(rows) < 2 or not (np.diff(stamps) > 0).all():
        raise ValueError(f"{path} must have two rows or more with increasing timestamps: copy it again")
    return np.array(stamps, dtype=np.int64), np.array(rows)
