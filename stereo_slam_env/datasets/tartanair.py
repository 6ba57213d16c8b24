"""The layouts of TartanAir, photorealistic drives with exact poses: rectified pairs of a baseline of 0.25 m.

Version 2: `image_lcam_front/NNNNNN_lcam_front.png`, `image_rcam_front`, `pose_lcam_front.txt`, and `imu/cam_time.txt`
(s) or else 10 pairs a second. Version 1: `image_left/NNNNNN_left.png`, `image_right`, `pose_left.txt`, 10 pairs/s.
A row of poses is x y z qx qy qz qw of the left camera as a body with x forward, y right, z down in a world of NED.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from filters import Pose, StereoCamera
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.datasets.image_files import image_size, numbered_images
from stereo_slam_env.datasets.layouts import reference_for
from stereo_slam_env.datasets.sequence import Choice, ImageFiles, RecordedSequence, known_poses
from stereo_slam_env.files.readers import finite_rows, read_table
from stereo_slam_env.recording.recording import NO_REFERENCE

NAME = "tartanair"
FILES = (
    ("image_lcam_front", "image_rcam_front", "pose_lcam_front.txt"),
    ("image_left", "image_right", "pose_left.txt"),
)
STATED = "{} of the recording."
FOCAL_LENGTH, BASELINE, RATE = 320.0, 0.25, 10.0
"""px, m, Hz."""
R_BODY_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Camera vectors (x right, y down, z forward) to those of the body (x forward, y right, z down)."""
_ROUNDING = 1e-3
"""Of the length of a quaternion."""


def open_sequence(path: Path, choice: Choice, *, use_truth: bool = True) -> RecordedSequence:
    """Open the folder of one drive.

    Parameters
    ----------
    path : Path
        For example `P000`.
    choice : Choice
        Frames to use, see `open_image_sequence`, also for what is raised.
    use_truth : bool
        Whether to read the poses.
    """
    path = path.resolve()
    second = (path / "image_lcam_front").is_dir()
    eyes = ("lcam_front", "rcam_front") if second else ("left", "right")
    folders = path / f"image_{eyes[0]}", path / f"image_{eyes[1]}"
    left, right = (numbered_images(folder, suffix=f"_{eye}") for folder, eye in zip(folders, eyes, strict=True))
    count = max([*left, *right], default=-1) + 1
    times, poses = path / "imu" / "cam_time.txt", path / f"pose_{eyes[0]}.txt"
    timed = second and times.exists()
    seconds = read_table(times, 1, finite=False).reshape(-1)[:count] if timed else np.arange(count) / RATE
    truth, truth_from = None, NO_REFERENCE
    if use_truth:
        rows = read_table(poses, 7, finite=False)
        good = finite_rows(rows) & (np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) < _ROUNDING)
        usable = np.where(good[:, None], rows, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        truth = of_camera(usable[:, :3], usable[:, 3:], good)
        truth_from = reference_for(rows[:, :3], STATED.format(poses.name))
    files = ImageFiles(folders, (left, right), seconds, times if timed else folders[0], truth, poses)
    source = {"reader": NAME, "path": str(path), "version": 2 if second else 1}
    return RecordedSequence(f"{NAME}_{path.name}", files, choice, _rig, source, truth_from)


def of_camera(positions: FloatArray, orientations: FloatArray, known: BoolArray) -> list[Pose | None]:
    """Poses of the camera from those (K, 3), (K, 4) of the body in NED, which are the camera's own place."""
    return known_poses(positions, Rotation.from_quat(orientations) * Rotation.from_matrix(R_BODY_CAMERA), known)


def _rig(image: Path) -> StereoCamera:
    width, height = image_size(image)
    # The published (320, 320) is counted from the edge of a pixel: by the exact motion, tracks fit better so.
    return StereoCamera(FOCAL_LENGTH, FOCAL_LENGTH, 0.5 * (width - 1), 0.5 * (height - 1), BASELINE, width, height)
