"""The first 51 stereo pairs of KITTI odometry 06, with velocities of the INS.

Layout: `image_l/NNNNNN.png`, `image_r/NNNNNN.png`; `calib.txt` with two rows, the 3x4 projection matrices of left and
right; `poses.txt`, T_world_cam of the left camera; `odometry_oxts.csv` (t_s, vx, vy, vz, wx, wy, wz in the IMU frame: x
forward, y left, z up). Row k of the velocities has the time of frame k and describes the step from frame k - 1 to k.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stereo_slam_env.datasets.calibration import rectified_rig
from stereo_slam_env.datasets.frames import CameraFiles, Faults, OnBroken, Times, Truth, poses_of_rows, usable_pairs
from stereo_slam_env.datasets.image_files import image_size, numbered_images
from stereo_slam_env.datasets.odometry import camera_velocities
from stereo_slam_env.datasets.sequence import RecordedSequence
from stereo_slam_env.files.readers import read_table
from stereo_slam_env.recording.recording import Reference

NAME = "kitti06_stereo51"
FILES = (("image_l", "image_r", "calib.txt", "poses.txt", "odometry_oxts.csv"),)
TRUTH = Reference(
    "independent truth",
    "KITTI's ground truth: GPS/INS, which is still settling in frames 0 to 10; the odometry is of the same INS, with "
    "noise added.",
)
R_CI = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
P_I = np.array([1.1, -0.3, 0.7])
"""How the camera sits in the IMU frame (m), to some centimetres and a degree: far below the noise of the odometry."""


def open_sequence(
    path: Path,
    *,
    first: int | None = None,
    last: int | None = None,
    on_broken: OnBroken = "raise",
    sigma_linear: float = 0.5,
    sigma_angular: float = 0.05,
    odometry_seed: int = 0,
) -> RecordedSequence:
    """Open the folder.

    Parameters
    ----------
    path : Path
        Folder with the files named in `FILES`.
    first, last, on_broken
        See `open_image_sequence`, also for what is raised.
    sigma_linear, sigma_angular : float
        White noise that is added to the velocities, m/s and rad/s per axis.
    odometry_seed : int
        Of that noise.
    """
    faults = Faults(on_broken)
    left, right = (CameraFiles(folder := path / name, numbered_images(folder)) for name in ("image_l", "image_r"))
    calibration, velocities = path / "calib.txt", path / "odometry_oxts.csv"
    projections = read_table(calibration, 12)
    if len(projections) != 2:
        raise ValueError(f"{calibration} has {len(projections)} rows where 2 projection matrices were expected")
    table = read_table(velocities, 7, delimiter=",", header_lines=1, finite=False)
    frames_stored = max([*left.files, *right.files], default=-1) + 1
    times = Times(velocities, table[:frames_stored, 0])  # one row more than frames
    truth = Truth(path / "poses.txt", poses_of_rows(read_table(path / "poses.txt", 12, finite=False)))
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
    frames = usable_pairs((left, right), times, faults, truth=truth, odometry=steps, first=first, last=last)
    rig = rectified_rig(
        calibration, projections[0].reshape(3, 4), projections[1].reshape(3, 4), image_size(frames[0].left)
    )
    source: dict[str, Any] = {
        "reader": NAME,
        "path": str(path),
        "odometry": "INS velocities with white noise added",
        "sigma_linear_m_s": float(sigma_linear),
        "sigma_angular_rad_s": float(sigma_angular),
        "odometry_seed": int(odometry_seed),
    }
    return RecordedSequence(NAME, rig.camera, frames, faults, source, TRUTH)
