"""Stereo pairs with poses and velocities of an INS, as the first 51 pairs of KITTI odometry 06 are stored.

Layout: `image_l/NNNNNN.png`, `image_r/NNNNNN.png`; `calib.txt` with two rows, the 3x4 projection matrices of left and
right; `poses.txt`, T_world_cam of the left camera; `odometry_oxts.csv` (t_s, vx, vy, vz, wx, wy, wz in the IMU frame: x
forward, y left, z up). Row k of the velocities has the time of frame k and describes the step from frame k - 1 to k.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stereo_slam_env.datasets.calibration import rig_of
from stereo_slam_env.datasets.image_files import numbered_images
from stereo_slam_env.datasets.registry import POSITION, known_by, reference_for
from stereo_slam_env.datasets.sequence import Choice, ImageFiles, RecordedSequence, poses_of_rows
from stereo_slam_env.datasets.tracks import camera_velocities
from stereo_slam_env.files.readers import read_table

NAME = "kitti06_stereo51"
FILES = (("image_l", "image_r", "calib.txt", "poses.txt", "odometry_oxts.csv"),)
STATED = "poses.txt of the recording; the odometry is odometry_oxts.csv, with noise added."
R_CI = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
P_I = np.array([1.1, -0.3, 0.7])
"""How the camera sits in the IMU frame (m), to some centimetres and a degree: far below the noise of the odometry."""


def open_sequence(
    path: Path, choice: Choice, *, sigma_linear: float = 0.5, sigma_angular: float = 0.05, odometry_seed: int = 0
) -> RecordedSequence:
    """Open the folder.

    Parameters
    ----------
    path : Path
        Folder with the files named in `FILES`.
    choice : Choice
        Frames to use, see `open_image_sequence`, also for what is raised.
    sigma_linear, sigma_angular : float
        White noise that is added to the velocities, m/s and rad/s per axis.
    odometry_seed : int
        Of that noise.
    """
    folders = path / "image_l", path / "image_r"
    left, right = map(numbered_images, folders)
    calibration, velocities, poses = path / "calib.txt", path / "odometry_oxts.csv", path / "poses.txt"
    projections = read_table(calibration, 12).reshape(-1, 3, 4)
    if len(projections) != 2:
        raise ValueError(f"{calibration} has {len(projections)} rows where 2 projection matrices were expected")
    table = read_table(velocities, 7, delimiter=",", header_lines=1, finite=False)
    frames_stored = max([*left, *right], default=-1) + 1  # the table has one row more
    odometry = camera_velocities(
        np.nan_to_num(table[:, 1:4]),
        np.nan_to_num(table[:, 4:7]),
        R_CI,
        P_I,
        sigma_linear=sigma_linear,
        sigma_angular=sigma_angular,
        seed=odometry_seed,
    )
    steps = [step if np.isfinite(row).all() else None for step, row in zip(odometry, table, strict=True)]
    rows, seconds = read_table(poses, 12, finite=False), table[:frames_stored, 0]
    truth_from = reference_for(rows[:, POSITION], STATED, seconds)
    files = ImageFiles(folders, (left, right), seconds, velocities, poses_of_rows(rows), poses, steps)
    source: dict[str, Any] = {
        "reader": NAME,
        "path": str(path),
        "odometry": "INS velocities with white noise added",
        "sigma_linear_m_s": float(sigma_linear),
        "sigma_angular_rad_s": float(sigma_angular),
        "odometry_seed": int(odometry_seed),
    }
    P = projections[0], projections[1]
    name = NAME if known_by(rows[:, POSITION]) else path.resolve().name
    return RecordedSequence(name, files, choice, rig_of(calibration, P), source, truth_from)
