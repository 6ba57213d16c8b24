"""The layout that VSLAM-LAB brings its data sets into: one folder a sequence, whichever data set it is of.

`rgb.csv` (ts_rgb_0 (ns), path_rgb_0, ts_rgb_1 (ns), path_rgb_1), `calibration.yaml` (`cameras`: pinholes, with radial-
tangential or equidistant lenses, and T_BS, which takes points of the camera to the body) and, where it is known,
`groundtruth.csv` (ts (ns), tx, ty, tz, qx, qy, qz, qw of the body). Raw pairs are rectified on reading.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from filters import Pose
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.layouts import reference_for
from stereo_slam_env.datasets.restated import as_they_are, sample_of_files
from stereo_slam_env.datasets.sequence import Choice, ImageFiles, RecordedSequence, poses_at
from stereo_slam_env.files.opening import require_inside
from stereo_slam_env.files.readers import parse_table, read_text
from stereo_slam_env.recording.recording import NO_REFERENCE
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.sensing.lenses import Rectification
from stereo_slam_env.sensing.rig_files import body_of_camera, read_calibration

NAME = "vslam_lab"
FILES = (("rgb.csv", "calibration.yaml"),)
COLUMNS = ("ts_rgb_0 (ns)", "path_rgb_0", "ts_rgb_1 (ns)", "path_rgb_1")
STATED = "groundtruth.csv of the recording, as poses of the body of T_BS, carried over to the left camera."
LARGEST_SHIFT_NS = 5_000_000
"""Images of one pair are taken no further apart."""


def open_sequence(
    path: Path,
    choice: Choice,
    *,
    use_truth: bool = True,
    rgb_csv: str | Path | None = None,
    calibration: str | Path | None = None,
) -> RecordedSequence:
    """Open the folder of one sequence.

    Parameters
    ----------
    path : Path
        Folder with `rgb.csv`.
    choice : Choice
        Frames to use, see `open_image_sequence`, also for what is raised; frame k is row k of `rgb.csv`.
    use_truth : bool
        Whether to read the true poses, where there are any, and to leave out the frames that they do not cover.
    rgb_csv, calibration : str or Path, optional
        Files in place of `rgb.csv` and `calibration.yaml`, as an experiment of VSLAM-LAB has its own.
    """
    path = path.resolve()
    listing = path / "rgb.csv" if rgb_csv is None else Path(rgb_csv)
    sheet = path / "calibration.yaml" if calibration is None else Path(calibration)
    table = path / "groundtruth.csv"
    stamps, images = _read_listing(listing, path)
    read = read_calibration(sheet)
    camera = read.camera if isinstance(read, Rectification) else read
    size = camera.width, camera.height
    found, notes = as_they_are(read, lambda: sample_of_files(images, size), str(path))
    rectify = found if isinstance(found, Rectification) and found.needed else None
    seconds = 1e-9 * (stamps - stamps[0])
    truth, truth_from = None, NO_REFERENCE
    if use_truth and table.exists() and (rows := _rows(table)).size:
        trajectory = Trajectory(rows[:, 1:4], rows[:, 4:8], 1e-9 * (rows[:, 0] - stamps[0]), gauge=None)
        T_bc = _of_matrix(body_of_camera(sheet))
        if rectify is not None:
            T_bc = T_bc @ Pose(np.zeros(3), rotations.from_matrix(rectify.R_left.T))
        truth, choice = poses_at(trajectory, seconds, T_bc, table, choice)
        truth_from = reference_for(rows[:, 1:4], STATED)
    files = ImageFiles((path, path), images, seconds, listing, truth, table)
    source: dict[str, Any] = {"reader": NAME, "path": str(path), "epoch_s": 1e-9 * int(stamps[0])}
    source |= {"notes": list(notes)} if notes else {}
    return RecordedSequence(f"{NAME}_{path.name}", files, choice, lambda image: camera, source, truth_from, rectify)


def _read_listing(path: Path, root: Path) -> tuple[FloatArray, tuple[dict[int, Path], dict[int, Path]]]:
    """Times of the left images, ns, and the images of both cameras by row."""
    lines = read_text(path, errors="replace").splitlines()
    rows = list(csv.reader(lines))
    header = [cell.strip() for cell in rows[0]] if rows else []
    if missing := [name for name in COLUMNS if name not in header]:
        raise ValueError(f"{path} lacks the columns {', '.join(missing)}: it must list the images of both cameras")
    at = [header.index(name) for name in COLUMNS]
    stamps, images = [], ({}, {})  # type: tuple[list[int], tuple[dict[int, Path], dict[int, Path]]]
    for number, row in enumerate((row for row in rows[1:] if row), start=2):
        try:
            times = int(row[at[0]]), int(row[at[2]])
            files = [_image(root, row[column]) for column in (at[1], at[3])]
        except (ValueError, IndexError) as error:
            raise ValueError(
                f"{path}: line {number} is not 'time in ns, image, time in ns, image' inside of it"
            ) from error
        if abs(times[1] - times[0]) > LARGEST_SHIFT_NS:
            raise ValueError(f"{path}: in line {number} the images are {abs(times[1] - times[0])} ns apart: no pair")
        for eye, file in enumerate(files):
            if file.is_file():
                images[eye][len(stamps)] = file
        stamps.append(times[0])
    if not stamps:
        raise ValueError(f"{path} lists no images: copy it again")
    return np.array(stamps, dtype=np.float64), images


def _image(root: Path, name: str) -> Path:
    image_path = Path(name.strip())
    if not name.strip() or image_path.is_absolute() or ".." in image_path.parts:
        raise ValueError(f"{name!r} is no image inside the recording")
    return require_inside(root / image_path, root)


def _rows(path: Path) -> FloatArray:
    """Rows (K, 8): time, ns, position, quaternion xyzw; none where the file has its header alone."""
    text = "\n".join(read_text(path).splitlines()[1:])
    return parse_table(path, text, 8, delimiter=",") if text.strip() else np.empty((0, 8))


def _of_matrix(T: FloatArray) -> Pose:
    return Pose(T[:3, 3].copy(), rotations.from_matrix(T[:3, :3]))
