"""The layout of the Karlsruhe stereo sequences (A. Geiger, 2009 and 2010).

A folder such as `2009_09_08_drive_0010` with `I1_NNNNNN.png` (left) and `I2_NNNNNN.png` (right), rectified, and
`insdata.txt`: one line a frame of ten numbers from the GPS/IMU unit: time (s), latitude, longitude (deg), altitude, x,
y, z (m, z up), roll, pitch, yaw (rad). The calibration is `2009_09_08_calib.txt`, in the folder or beside it, with
lines `P1_roi:` and `P2_roi:` of twelve numbers: the 3x4 projection matrices of the images as they are stored (`P1:` and
`P2:` there are those before the images were cut to their region of interest).

This was put together from public programs that read these sequences; the sequences themselves were not at hand. Not
confirmed, and dealt with so:

- the unit of time: it is taken to be s, and times that are then too close or too far apart are refused;
- where yaw counts from and which way: that reading is taken that agrees with the direction in which the positions move;
  if none does, or the car does not move, there is no truth;
- where the unit sits on the car: it is taken to be at the left camera and aligned with it. The true position is wrong
  by up to that distance times the turn, and the orientation by the camera's tilt;
- the accuracy: GPS without corrections. This is a weak truth, of metres; it tells gross errors from good tracks.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from filters import Pose
from filters.contract.validation import positive
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.calibration import rig_of
from stereo_slam_env.datasets.image_files import numbered_images
from stereo_slam_env.datasets.sequence import Choice, ImageFiles, RecordedSequence, known_poses
from stereo_slam_env.files.opening import require_inside
from stereo_slam_env.files.readers import finite_rows, read_table
from stereo_slam_env.recording.recording import Reference
from stereo_slam_env.sensing.projections import projections

NAME = "karlsruhe"
FILES = (("I1_*", "I2_*", "*calib.txt"), ("I1_*", "I2_*", "../*calib.txt"))
INS_COLUMNS = 10
POSITION, ATTITUDE = slice(4, 7), slice(7, 10)
DEFAULT_RATE_HZ = 10.0
_LIKELY_STEP = (0.02, 1.0)  # s
R_UNIT_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Takes camera vectors (x right, y down, z forward) to the unit's frame (x forward, y left, z up)."""

_YAW = {
    "from east, counter-clockwise": (1.0, 0.0),
    "from east, clockwise": (-1.0, 0.0),
    "from north, counter-clockwise": (1.0, 0.5 * np.pi),
    "from north, clockwise": (-1.0, 0.5 * np.pi),
}
"""Reading of yaw -> (sign, offset) that turn it into an angle from x, counter-clockwise."""
_MOVES = 0.3
"""m between two frames; below, the direction of motion says nothing."""
_AGREES = np.deg2rad(15.0)

log = logging.getLogger(__name__)


def open_sequence(
    path: Path, choice: Choice, *, use_truth: bool = True, rate_hz: float | None = None
) -> RecordedSequence:
    """Open the folder of a sequence.

    Parameters
    ----------
    path : Path
        For example `2009_09_08_drive_0010`.
    choice : Choice
        Frames to use, see `open_image_sequence` (the paper's right turn is frames 61 to 72 of drive 0010).
    use_truth : bool
        Whether to take the poses of the GPS/IMU unit as (weak) truth.
    rate_hz : float, optional
        Frame rate to take instead of the times in `insdata.txt`; None takes those, and 10 Hz where there are none.
    """
    path = path.resolve()
    left, right = (numbered_images(path, prefix) for prefix in ("I1_", "I2_"))
    calibration = _calibration(path)
    P = projections(calibration, ["P1_roi", "P2_roi"])
    ins = path / "insdata.txt"
    table = read_table(ins, INS_COLUMNS, finite=False) if ins.exists() else None
    if table is not None and rate_hz is None:
        seconds = _stored_times(ins, table)
    else:
        rate_hz = positive("rate_hz", DEFAULT_RATE_HZ if rate_hz is None else rate_hz)
        seconds = np.arange(max([*left, *right], default=-1) + 1) / rate_hz
    truth = reading = None
    if use_truth and table is not None:
        if (reading := _reading_of_yaw(table)) is None:
            log.warning("%s: yaw fits no direction of motion, the sequence has no truth", ins)
        else:
            truth = _camera_poses(table, reading)
    files = ImageFiles((path, path), (left, right), seconds, ins, truth, ins)
    source = {
        "reader": NAME,
        "path": str(path),
        "calibration": str(calibration),
        "times": "insdata.txt" if rate_hz is None else f"assumed {rate_hz:g} Hz",
    }
    truth_from = Reference(
        "unknown",
        f"The poses in insdata.txt, of a unit taken to sit at the left camera, its yaw counted {reading}: weak, to "
        "metres.",
    )
    return RecordedSequence(f"{NAME}_{path.name}", files, choice, rig_of(calibration, P), source, truth_from)


def _reading_of_yaw(table: FloatArray) -> str | None:
    """The key of `_YAW` that agrees best with the course in rows of `insdata.txt`; None: none, or no motion."""
    good = table[finite_rows(table)]
    steps = np.diff(good[:, POSITION], axis=0)[:, :2]
    moving = np.linalg.norm(steps, axis=1) > _MOVES
    if not moving.any():
        return None
    course = np.arctan2(steps[moving, 1], steps[moving, 0])
    # Yaw half-way between the frames, for the chord points that way in a turn.
    yaw = np.unwrap(good[:, ATTITUDE][:, 2])
    halfway = (0.5 * (yaw[1:] + yaw[:-1]))[moving]
    misfit = {
        name: float(np.median(np.abs(_wrapped(sign * halfway + offset - course))))
        for name, (sign, offset) in _YAW.items()
    }
    best = min(misfit, key=misfit.__getitem__)
    return best if misfit[best] < _AGREES else None


def _camera_poses(table: FloatArray, reading: str) -> list[Pose | None]:
    """Poses of the left camera in the frame of x, y, z; None where a row is not finite."""
    good = finite_rows(table)
    roll, pitch, yaw = np.where(good[:, None], table[:, ATTITUDE], 0.0).T
    sign, offset = _YAW[reading]
    R_wu = Rotation.from_euler("ZYX", np.column_stack([sign * yaw + offset, pitch, roll]))
    return known_poses(table[:, POSITION], R_wu * Rotation.from_matrix(R_UNIT_CAMERA), good)


def _stored_times(path: Path, table: FloatArray) -> FloatArray:
    """From the first one on, s."""
    finite = table[np.isfinite(table[:, 0]), 0]
    step = float(np.median(np.diff(finite))) if finite.size > 1 else _LIKELY_STEP[0]
    if not _LIKELY_STEP[0] <= step <= _LIKELY_STEP[1]:
        raise ValueError(f"{path}: times are {step:.6g} apart, which are no seconds: give rate_hz=10 instead of them")
    return np.asarray(table[:, 0] - (finite[0] if finite.size else 0.0))


def _wrapped(angle: FloatArray) -> FloatArray:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _calibration(path: Path) -> Path:
    """The file that is most likely the calibration of this sequence."""
    date = "_".join(path.name.split("_")[:3])
    beside = (path.parent / f"{name}calib.txt" for name in (f"{path.name}_", f"{date}_", ""))
    found = [*sorted(path.glob("*calib.txt")), *(candidate for candidate in beside if candidate.exists())]
    if not found:
        raise ValueError(f"{path} has no calibration: put {date}_calib.txt into it or beside it")
    return require_inside(found[0], path.parent)
