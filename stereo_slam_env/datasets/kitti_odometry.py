"""The layout of the KITTI odometry benchmark.

`sequences/NN/` holds `calib.txt` (P0 to P3, 3x4 projections from the rectified left grey camera), `times.txt` (s, one
row a frame) and the folders `image_0`, `image_1` (grey, left and right) or `image_2`, `image_3` (colour) with files
`NNNNNN.png`. `poses/NN.txt` beside `sequences` holds T_world_cam of the left grey camera where it is known, 12 numbers
a row.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from stereo_slam_env.datasets.broken import Faults, OnBroken
from stereo_slam_env.datasets.calibration import entry, read_entries, rectified_rig
from stereo_slam_env.datasets.frames import Eye, Times, Truth, poses_of_rows, usable_pairs
from stereo_slam_env.datasets.image_files import image_size, numbered_images
from stereo_slam_env.datasets.kitti_cameras import CAMERAS, chosen_cameras, has_cameras
from stereo_slam_env.datasets.sequence import RecordedSequence
from stereo_slam_env.files.inside import require_inside
from stereo_slam_env.files.tables import read_table
from stereo_slam_env.recording.recording import Reference

NAME = "kitti_odometry"
FILES = ("calib.txt", "times.txt", "image_0|image_2", "image_1|image_3")


def recognises(path: Path) -> bool:
    """Whether the folder is one sequence of this layout."""
    has_pair = any(has_cameras(_folder_of(path), cameras) for cameras in CAMERAS)
    return has_pair and all((path / name).is_file() for name in FILES[:2])


def poses_file(path: Path) -> Path:
    """Where the true poses of the sequence at `path` belong."""
    return path.parent.parent / "poses" / f"{path.name}.txt"


def open_sequence(
    path: Path,
    *,
    first: int | None = None,
    last: int | None = None,
    on_broken: OnBroken = "raise",
    cameras: str | None = None,
    use_truth: bool = True,
) -> RecordedSequence:
    """Open `sequences/NN`.

    Parameters
    ----------
    path : Path
        The folder of the sequence.
    first, last : int, optional
        Frame numbers to start and to end with, both included.
    on_broken : {"raise", "skip"}
        What to do about a pair that cannot be used.
    cameras : {"grey", "colour"}, optional
        Which pair of cameras; None takes grey where present.
    use_truth : bool
        Whether to read the true poses, where there are any.

    Raises
    ------
    ValueError
        Something is missing, damaged or contradictory: one line that names the file.
    """
    path = path.resolve()
    faults = Faults(on_broken)
    chosen = chosen_cameras(_folder_of(path), cameras)
    numbers = CAMERAS[chosen]
    left, right = (Eye(folder := _folder_of(path)(n), numbered_images(folder)) for n in numbers)
    calibration = path / "calib.txt"
    entries = read_entries(calibration)
    P_left, P_right = (entry(calibration, entries, f"P{n}", (3, 4)) for n in numbers)
    times = Times(path / "times.txt", read_table(path / "times.txt", 1, finite=False).reshape(-1))
    poses, truth = poses_file(path), None
    if use_truth and poses.is_file():
        require_inside(poses, path.parent.parent)
        truth = Truth(poses, poses_of_rows(read_table(poses, 12, finite=False)))
    frames = usable_pairs((left, right), times, faults, truth=truth, first=first, last=last)
    rig = rectified_rig(calibration, P_left, P_right, image_size(frames[0].left))
    source: dict[str, Any] = {
        "reader": NAME,
        "path": str(path),
        "cameras": chosen,
        "first": frames[0].number,
        "last": frames[-1].number,
        "on_broken": on_broken,
    }
    truth_from = Reference("independent truth", f"poses/{poses.name} of the recording; KITTI made its own by GPS/INS.")
    return RecordedSequence(f"{NAME}_{path.name}", rig.camera, rig.of_left(frames), faults, source, truth_from)


def _folder_of(path: Path) -> Callable[[int], Path]:
    return lambda number: path / f"image_{number}"
