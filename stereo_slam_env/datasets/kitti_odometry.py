"""The layout of the KITTI odometry benchmark, read and written.

`sequences/NN/` holds `calib.txt` (P0 to P3, 3x4 projections from the rectified left grey camera), `times.txt` (s, one
row a frame) and the folders `image_0`, `image_1` (grey, left and right) or `image_2`, `image_3` (colour) with files
`NNNNNN.png`. `poses/NN.txt` beside `sequences` holds T_world_cam of the left grey camera where it is known, 12 numbers
a row.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from filters import StereoCamera
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.image_files import numbered_images, write_image
from stereo_slam_env.datasets.layouts import POSITION, reference_for
from stereo_slam_env.datasets.sequence import (
    Choice,
    ImageFiles,
    RecordedSequence,
    of_left_camera,
    poses_of_rows,
    rig_of,
)
from stereo_slam_env.datasets.written_frame import WrittenFrame, numbers
from stereo_slam_env.files.folders import write_text
from stereo_slam_env.files.opening import require_inside
from stereo_slam_env.files.readers import read_table
from stereo_slam_env.recording.recording import NO_REFERENCE
from stereo_slam_env.sensing.projections import projections
from stereo_slam_env.sensing.sensor_suite import SensorSuite

NAME = "kitti_odometry"
FILES = (("calib.txt", "times.txt", "image_0", "image_1"), ("calib.txt", "times.txt", "image_2", "image_3"))
CAMERAS = {"grey": (0, 1), "colour": (2, 3)}
"""Numbers of the left and the right camera of the two pairs of a KITTI car."""

log = logging.getLogger(__name__)


def poses_file(path: Path) -> Path:
    """File of the true poses of the sequence at `path`."""
    return path.parent.parent / "poses" / f"{path.name}.txt"


def open_sequence(
    path: Path, choice: Choice, *, cameras: str | None = None, use_truth: bool = True
) -> RecordedSequence:
    """Open `sequences/NN`.

    Parameters
    ----------
    path : Path
        The folder of the sequence.
    choice : Choice
        Frames to use, see `open_image_sequence`, also for what is raised.
    cameras : {"grey", "colour"}, optional
        Which pair of cameras; None takes grey where present.
    use_truth : bool
        Whether to read the true poses, where there are any.
    """
    path = path.resolve()
    cameras, folders = chosen_cameras(lambda number: path / f"image_{number}", cameras)
    calibration, times, poses = path / "calib.txt", path / "times.txt", poses_file(path)
    P = projections(calibration, [f"P{n}" for n in CAMERAS[cameras]])
    seconds, truth, truth_from = read_table(times, 1, finite=False).reshape(-1), None, NO_REFERENCE
    if use_truth and poses.exists():
        require_inside(poses, path.parent.parent)
        rows = read_table(poses, 12, finite=False)
        truth = of_left_camera(poses_of_rows(rows), P[0])
        truth_from = reference_for(rows[:, POSITION], f"poses/{poses.name} of the recording.", seconds)
    images = numbered_images(folders[0]), numbered_images(folders[1])
    files = ImageFiles(folders, images, seconds, times, truth, poses)
    source = {"reader": NAME, "path": str(path), "cameras": cameras}
    return RecordedSequence(f"{NAME}_{path.name}", files, choice, rig_of(calibration, P), source, truth_from)


def chosen_cameras(folder_of: Callable[[int], Path], asked: str | None) -> tuple[str, tuple[Path, Path]]:
    """The pair of cameras that was asked for (None: grey where present), and the folders of left and right.

    `folder_of` gives the folder of a camera by its number; a `ValueError` where there is no such pair.
    """
    if asked is None:
        asked = "grey" if all(folder_of(number).is_dir() for number in CAMERAS["grey"]) else "colour"
    if asked not in CAMERAS:
        raise ValueError(f"cameras must be one of {', '.join(CAMERAS)}, got {asked!r}")
    left, right = map(folder_of, CAMERAS[asked])
    return asked, (left, right)


class KittiWriter:
    """Writer of a sequence; without a true pose of every pair there is no file of poses."""

    POSES = "poses.txt"
    """File of the poses, until its place outside of the sequence is known to be free."""

    def __init__(self, folder: Path, suite: SensorSuite) -> None:
        self._folder, self._suite, self._stack = folder, suite, ExitStack()
        self._size, self._without_pose, self._count = (suite.camera.width, suite.camera.height), 0, 0
        for number in CAMERAS["grey"]:
            (folder / f"image_{number}").mkdir(parents=True, exist_ok=True)
        self._times, self._poses = (
            self._stack.enter_context((folder / name).open("w")) for name in ("times.txt", self.POSES)
        )

    def _image(self, side: int, number: int) -> Path:
        return self._folder / f"image_{side}" / f"{number:06d}.png"

    def has_images(self, number: int, stamp: int) -> bool:
        """Whether both images of a number are there."""
        return all(self._image(side, number).is_file() for side in CAMERAS["grey"])

    def write(self, frame: WrittenFrame) -> None:
        """Write images, time and pose of a pair."""
        pair = frame.pair
        for side, image in zip(CAMERAS["grey"], (pair.left, pair.right), strict=True):
            write_image(self._image(side, frame.number), image, self._size, frame.number)
        self._times.write(f"{float(pair.timestamp)!r}\n")
        self._count += 1
        if pair.truth is None:
            self._without_pose += 1
        else:
            self._poses.write(f"{numbers(np.column_stack([pair.truth.R_wc, pair.truth.position]).ravel())}\n")

    def close(self) -> None:
        """Write the calibration, which makes it complete."""
        self._stack.close()
        poses = self._folder / self.POSES
        if self._without_pose:
            if self._without_pose < self._count:
                log.warning("no poses written: %d of %d pairs have no true pose", self._without_pose, self._count)
            poses.unlink()
        write_text(self._folder / "calib.txt", _calibration(self._suite.camera))


def _calibration(camera: StereoCamera) -> str:
    """P0 to P3; the colour cameras of the benchmark, 2 and 3, sit where the grey ones are."""

    def projection(offset: float) -> FloatArray:
        return np.array([[camera.fx, 0.0, camera.cx, offset], [0.0, camera.fy, camera.cy, 0.0], [0.0, 0.0, 1.0, 0.0]])

    grey = (projection(0.0), projection(-camera.disparity_constant))
    return "".join(f"P{n}: {numbers(grey[n % 2].ravel())}\n" for n in range(4))
