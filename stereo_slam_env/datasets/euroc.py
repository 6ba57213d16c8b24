"""The ASL layout of the EuRoC MAV data: raw images, rectified on reading.

`mav0/cam0` (left) and `mav0/cam1` (right), each with `data.csv` (timestamp in ns, file name), `data/` with the images,
and `sensor.yaml`: T_BS, which takes points of the camera to the body, the resolution, pinhole intrinsics (fu, fv, cu,
cv) and radial-tangential distortion (k1, k2, p1, p2). Truth is `mav0/state_groundtruth_estimate0/data.csv`: timestamp
in ns, position and quaternion (w first) of the body in its own world, and more columns that are not used. `mav0/imu0`
has `data.csv` (timestamp in ns, angular rates, specific forces) and `sensor.yaml` (T_BS, densities of the noise).

Frame k is row k of `cam0/data.csv`. The images are rectified on reading, so the camera of the sequence is not the one
in the file. The truth is that of the turned left camera; frames outside the time that it covers are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from filters import InertialSamples, InertialUnit, Pose, StereoCamera
from filters.contract.foreign_text import first_line
from filters.validation import FloatArray, IntArray
from stereo_slam_env.datasets.calibration import rectified_rig
from stereo_slam_env.datasets.image_files import MAX_PIXELS
from stereo_slam_env.datasets.known_recordings import reference_for
from stereo_slam_env.datasets.sequence import Choice, ImageFiles, RecordedSequence, Rectify, known_poses
from stereo_slam_env.files.paths import is_plain_name
from stereo_slam_env.files.readers import finite_rows, read_text
from stereo_slam_env.recording.inertial import samples_of_steps
from stereo_slam_env.recording.recording import NO_REFERENCE, GreyImage

NAME = "euroc"
_IN_MAV0 = tuple(f"mav0/{camera}/{name}" for camera in ("cam0", "cam1") for name in ("data.csv", "sensor.yaml"))
FILES = (_IN_MAV0, tuple(name.removeprefix("mav0/") for name in _IN_MAV0))
INERTIAL = "imu0"
TRUTH = "state_groundtruth_estimate0"
STATED = f"The poses of {TRUTH}, interpolated and carried over to the rectified left camera."
LARGEST_TRUTH_GAP_NS = 100_000_000
"""Truth is interpolated between rows that are no further apart (it comes at 200 Hz)."""
_DENSITIES = (
    "gyroscope_noise_density",
    "accelerometer_noise_density",
    "gyroscope_random_walk",
    "accelerometer_random_walk",
)
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
    sensor, other = (_read_sensor(camera / "sensor.yaml") for camera in cameras)
    rig, turned, rectify = _rectification(sensor, other, cameras[1] / "sensor.yaml")
    ns = np.array(stamps, dtype=np.int64)
    inertial = _samples(root / INERTIAL, ns, sensor, turned) if (root / INERTIAL / "data.csv").exists() else []
    truth, table, truth_from = None, root / TRUTH / "data.csv", NO_REFERENCE
    if use_truth and table.exists():
        rows_ns, rows = _read_truth(table)
        truth, (first, last) = _camera_poses(table, rows_ns, rows, ns, sensor, turned)
        truth_from = reference_for(rows[:, :3], STATED)
        last = last if choice.last is None else min(last, choice.last)
        choice = Choice(max(choice.first or 0, first), last, choice.on_broken)
    folders = cameras[0] / "data", cameras[1] / "data"
    files = ImageFiles(folders, (left, right), 1e-9 * (ns - ns[0]), cameras[0] / "data.csv", truth, table, (), inertial)
    name = root.parent.name if root.name == "mav0" else root.name
    source = {"reader": NAME, "path": str(root), "rectified": "cv2.stereoRectify, alpha 0"}
    return RecordedSequence(f"{NAME}_{name}", files, choice, lambda image: rig, source, truth_from, rectify)


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


def _camera_poses(
    path: Path, rows_ns: IntArray, rows: FloatArray, stamps: IntArray, left: _Sensor, turned: FloatArray
) -> tuple[list[Pose | None], tuple[int, int]]:
    """Poses of the turned left camera at the stamps, and the first and last frame that the rows of truth cover.

    A pose is None where the rows around it hold NaN or are too far apart.
    """
    sensor = path.with_name("sensor.yaml")
    T_bs_truth = _transform(sensor, _text(sensor)) if sensor.exists() else np.eye(4)
    inside = (stamps >= rows_ns[0]) & (stamps <= rows_ns[-1])
    covered = np.flatnonzero(inside)
    if covered.size == 0:
        raise ValueError(f"{path} covers none of the images: it is of another recording, or use_truth=False")
    after = np.clip(np.searchsorted(rows_ns, stamps), 1, len(rows_ns) - 1)
    exact = rows_ns[after] == stamps
    before = np.where(exact, after, after - 1)
    finite = finite_rows(rows) & (np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) < 1e-2)
    near = exact | (rows_ns[after] - rows_ns[before] <= LARGEST_TRUTH_GAP_NS)
    good = inside & near & finite[after] & finite[before]
    usable = np.where(finite[:, None], rows, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    seconds = 1e-9 * (rows_ns - rows_ns[0])
    wanted = np.clip(1e-9 * (stamps - rows_ns[0]), seconds[0], seconds[-1])
    positions = np.column_stack([np.interp(wanted, seconds, usable[:, i]) for i in range(3)])
    R_ws = Slerp(seconds, Rotation.from_quat(usable[:, 3:]))(wanted)
    T_sc = np.linalg.solve(T_bs_truth, left.T_bs)
    orientations = R_ws * Rotation.from_matrix(T_sc[:3, :3] @ turned.T)
    poses = known_poses(positions + R_ws.apply(T_sc[:3, 3]), orientations, good)
    return poses, (int(covered[0]), int(covered[-1]))


def _samples(folder: Path, stamps: IntArray, left: _Sensor, turned: FloatArray) -> list[InertialSamples | None]:
    """Inertial samples of the step to each frame."""
    table, sensor = folder / "data.csv", folder / "sensor.yaml"
    text = _text(sensor)
    T_ci = np.linalg.solve(left.T_bs, _transform(sensor, text))
    densities = (_scalar(sensor, text, key) for key in _DENSITIES)
    unit = InertialUnit(turned @ T_ci[:3, 3], Rotation.from_matrix(turned @ T_ci[:3, :3]).as_quat(), *densities)
    rows_ns, rows = _read_stamped(table, 6)
    origin = stamps[0]
    return samples_of_steps(table, 1e-9 * (rows_ns - origin), rows, 1e-9 * (stamps - origin), unit)


def _read_truth(path: Path) -> tuple[IntArray, FloatArray]:
    """Timestamps (K,) ns, increasing, and rows (K, 7): position and quaternion xyzw."""
    stamps, rows = _read_stamped(path, 7)
    return stamps, rows[:, [0, 1, 2, 4, 5, 6, 3]]


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


@dataclass(frozen=True, eq=False)
class _Sensor:
    """A camera by its `sensor.yaml`: T_bs (4, 4), K (3, 3) px, distortion (4,), and width and height, px."""

    T_bs: FloatArray
    K: FloatArray
    distortion: FloatArray
    size: tuple[int, int]


def _read_sensor(path: Path) -> _Sensor:
    text = _text(path)
    for key, wanted in (("camera_model", "pinhole"), ("distortion_model", "radial-tangential")):
        found = re.search(rf"^{key}\s*:\s*(\S+)", text, re.MULTILINE)
        model = found[1].strip("\"'").replace("_", "-") if found else None
        if model is not None and model != wanted:
            raise ValueError(f"{path}: {key} is {model!r}, only {wanted!r} can be read")
    fu, fv, cu, cv = _numbers(path, text, "intrinsics", 4)
    width, height = (int(number) for number in _numbers(path, text, "resolution", 2))
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ValueError(f"{path}: resolution {width}x{height} is none of an image that is read: correct it")
    return _Sensor(
        _transform(path, text),
        np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]]),
        _numbers(path, text, "distortion_coefficients", 4),
        (width, height),
    )


def _rectification(left: _Sensor, right: _Sensor, path: Path) -> tuple[StereoCamera, FloatArray, Rectify]:
    """The rectified rig, R (3, 3) from the left camera of the file to it, and what rectifies a pair of images.

    Both cameras are turned to a common plane and freed of distortion; only pixels that exist are kept.
    """
    if left.size != right.size:
        raise ValueError(f"{path}: the images are {right.size}, those of the left camera {left.size}: not one rig")
    T_rl = np.linalg.solve(right.T_bs, left.T_bs)
    R_left, R_right, P_left, P_right = cv2.stereoRectify(
        left.K,
        left.distortion,
        right.K,
        right.distortion,
        left.size,
        T_rl[:3, :3],
        T_rl[:3, 3:],
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0,
    )[:4]
    rig = rectified_rig(path, np.asarray(P_left, np.float64), np.asarray(P_right, np.float64), left.size)
    maps = [
        cv2.initUndistortRectifyMap(sensor.K, sensor.distortion, R, P, sensor.size, cv2.CV_16SC2)
        for sensor, R, P in ((left, R_left, P_left), (right, R_right, P_right))
    ]

    def rectify(left_image: GreyImage, right_image: GreyImage) -> tuple[GreyImage, GreyImage]:
        turned = [
            np.asarray(cv2.remap(image, *both, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
            for image, both in zip((left_image, right_image), maps, strict=True)
        ]
        return turned[0], turned[1]

    return rig, np.asarray(R_left, dtype=np.float64), rectify


def _text(path: Path) -> str:
    """Content without comments."""
    return re.sub(r"#.*", "", read_text(path))


def _numbers(path: Path, text: str, key: str, count: int) -> FloatArray:
    found = re.search(rf"^{key}\s*:\s*\[([^\]]*)\]", text, re.MULTILINE)
    if found is None:
        raise ValueError(f"{path} lacks '{key}: [...]': take the calibration of this recording")
    return _parsed(path, found[1], key, count)


def _scalar(path: Path, text: str, key: str) -> float:
    found = re.search(rf"^{key}\s*:\s*(\S+)", text, re.MULTILINE)
    if found is None:
        raise ValueError(f"{path} lacks '{key}': take the data sheet of this unit")
    return float(_parsed(path, found[1], key, 1)[0])


def _transform(path: Path, text: str) -> FloatArray:
    found = re.search(r"^T_BS\s*:[^\[]*\[([^\]]*)\]", text, re.MULTILINE)
    if found is None:
        raise ValueError(f"{path} lacks 'T_BS' with 'data: [...]': take the calibration of this recording")
    T = _parsed(path, found[1], "T_BS", 16).reshape(4, 4)
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        raise ValueError(f"{path}: T_BS holds no rotation: take the calibration of this recording")
    return T


def _parsed(path: Path, words: str, key: str, count: int) -> FloatArray:
    try:
        numbers = np.array([float(word) for word in words.replace(",", " ").split()])
    except ValueError as error:
        raise ValueError(f"{path}: '{key}' holds no numbers ({first_line(error)}): correct it") from error
    if numbers.size != count or not np.isfinite(numbers).all():
        raise ValueError(f"{path}: '{key}' has {numbers.size} numbers where {count} finite ones were expected")
    return numbers
