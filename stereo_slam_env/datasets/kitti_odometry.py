"""The layout of the KITTI odometry benchmark, read and written.

`sequences/NN/` holds `calib.txt` (P0 to P3, 3x4 projections from the rectified left grey camera), `times.txt` (s, one
row a frame) and the folders `image_0`, `image_1` (grey, left and right) or `image_2`, `image_3` (colour) with files
`NNNNNN.png`. `poses/NN.txt` beside `sequences` holds T_world_cam of the left grey camera where it is known, 12 numbers
a row.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from filters import Pose, StereoCamera
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.image_files import numbered_images
from stereo_slam_env.datasets.layouts import POSITION, reference_for
from stereo_slam_env.datasets.sequence import (
    Choice,
    ImageFiles,
    RecordedSequence,
    of_left_camera,
    poses_of_rows,
    rig_of,
)
from stereo_slam_env.files.opening import require_inside
from stereo_slam_env.files.readers import read_table
from stereo_slam_env.recording.recording import NO_REFERENCE, ImageSequence, StereoPair
from stereo_slam_env.sensing.projections import projections

NAME = "kitti_odometry"
FILES = (("calib.txt", "times.txt", "image_0", "image_1"), ("calib.txt", "times.txt", "image_2", "image_3"))
CAMERAS = {"grey": (0, 1), "colour": (2, 3)}
"""Numbers of the left and the right camera of the two pairs of a KITTI car."""
PARTIAL = ".partial"
"""Ending of the folder of a sequence that is not yet complete."""

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


def write_kitti_sequence(
    sequence: ImageSequence,
    out: str | Path,
    name: str = "00",
    *,
    on_pair: Callable[[int, int], None] | None = None,
) -> Path:
    """Write `out/sequences/NAME` (images, calibration, times) and `out/poses/NAME.txt`.

    Everything is written into `out/sequences/NAME.partial` and renamed at the end: a folder without that ending is
    complete. True poses are written where every pair has one. Odometry has no place in this layout and is left out.
    `source.json`, which is no part of it, says where the images come from.

    Parameters
    ----------
    sequence : ImageSequence
        What to write; it is read once.
    out : str or Path
        Folder for `sequences` and `poses`; other sequences in it stay.
    name : str
        Name of the sequence, two digits in the benchmark.
    on_pair : callable, optional
        Called after every pair with the number written and the number expected.

    Returns
    -------
    Path
        `out/sequences/NAME`.

    Raises
    ------
    ValueError
        The sequence is there already, or a part of it from a writing that was interrupted; the name is no file name; an
        image is not of the camera's size; there are no pairs.
    """
    if not name or Path(name).name != name or name.startswith("."):
        raise ValueError(f"name must be a plain folder name such as '00', got {name!r}")
    final = Path(out) / "sequences" / name
    partial, poses = final.with_name(name + PARTIAL), poses_file(final)
    _require_free(final, partial, poses)
    for number in CAMERAS["grey"]:
        (partial / f"image_{number}").mkdir(parents=True)
    times: list[float] = []
    truth: list[Pose | None] = []
    for number, pair in enumerate(sequence.pairs()):
        _write_images(partial, number, pair, sequence.camera)
        times.append(pair.timestamp)
        truth.append(pair.truth)
        if on_pair is not None:
            on_pair(number + 1, len(sequence))
    if not times:
        raise ValueError(f"sequence {sequence.name!r} has no pairs: nothing was written but the empty {partial}")
    (partial / "calib.txt").write_text(_calibration(sequence.camera))
    (partial / "times.txt").write_text("".join(f"{float(time)!r}\n" for time in times))
    (partial / "source.json").write_text(json.dumps({"name": sequence.name, **sequence.source}, indent=2) + "\n")
    known_poses = [pose for pose in truth if pose is not None]
    if len(known_poses) == len(truth):
        poses.parent.mkdir(exist_ok=True)
        rows = (np.column_stack([pose.R_wc, pose.position]) for pose in known_poses)
        poses.write_text("".join(f"{_row(row.ravel())}\n" for row in rows))
    elif known_poses:
        log.warning(
            "%s not written: %d of %d pairs have no true pose", poses, len(truth) - len(known_poses), len(truth)
        )
    if final.exists():
        final.rmdir()
    partial.rename(final)
    return final


def _require_free(final: Path, partial: Path, poses: Path) -> None:
    if partial.exists():
        raise ValueError(f"{partial} was left by a writing that was interrupted: remove it, then write again")
    if final.exists() and (not final.is_dir() or any(final.iterdir())):
        raise ValueError(f"{final} is not empty: choose another name or folder, or remove it")
    if poses.exists():
        raise ValueError(f"{poses} is there already: choose another name or folder, or remove it")


def _write_images(folder: Path, number: int, pair: StereoPair, camera: StereoCamera) -> None:
    for side, image in enumerate((pair.left, pair.right)):
        path = folder / f"image_{side}" / f"{number:06d}.png"
        if image.dtype != np.uint8 or image.shape != (camera.height, camera.width):
            raise ValueError(
                f"pair {number} cannot be written to {path}: its images must be uint8 of shape "
                f"{(camera.height, camera.width)}, got {image.dtype} of shape {image.shape}"
            )
        done, data = cv2.imencode(".png", image)
        if not done:
            raise ValueError("OpenCV could not encode an image as PNG: install opencv-python-headless with PNG support")
        path.write_bytes(bytes(data))


def _calibration(camera: StereoCamera) -> str:
    """P0 to P3; the colour cameras of the benchmark, 2 and 3, sit where the grey ones are."""

    def projection(offset: float) -> FloatArray:
        return np.array([[camera.fx, 0.0, camera.cx, offset], [0.0, camera.fy, camera.cy, 0.0], [0.0, 0.0, 1.0, 0.0]])

    grey = (projection(0.0), projection(-camera.disparity_constant))
    return "".join(f"P{n}: {_row(grey[n % 2].ravel())}\n" for n in range(4))


def _row(numbers: FloatArray) -> str:
    return " ".join(f"{float(number)!r}" for number in numbers)
