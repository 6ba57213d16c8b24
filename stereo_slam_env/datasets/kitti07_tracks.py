"""Stereo feature tracks over the whole of KITTI odometry 07, with noisy velocities.

Layout: `tracks.npz` (features, time_stamps, linear_velocity, rotational_velocity, K, b, cam_T_imu) and
`poses.txt` (KITTI ground truth, T_world_cam).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from filters.camera import StereoCamera
from filters.interface import BodyVelocity
from filters.noise import StereoNoise
from filters.validation import FloatArray, positive
from stereo_slam_env.datasets.tracks import ASSUMED_SIGMA_PX, frames_of, tracks_of_pixels
from stereo_slam_env.files.tables import read_archive, read_poses
from stereo_slam_env.recording.recording import Pose, Recording, Reference

NAME = "kitti07_tracks"
FILES = ("tracks.npz", "poses.txt")
ARRAYS = ("features", "time_stamps", "linear_velocity", "rotational_velocity", "K", "b", "cam_T_imu")
TRUTH = Reference(
    "independent truth",
    "KITTI's ground truth: GPS/INS, to about 0.1 m where RTK held, noisier from frame to frame; the odometry is of the "
    "same INS, with noise added.",
)
IMAGE_SIZE = (1226, 370)  # rectified images of the drives of 2011_09_30; the archive does not hold it


def recognises(path: Path) -> bool:
    """Whether the folder has this layout."""
    return all((path / name).is_file() for name in FILES)


def read(
    path: Path,
    *,
    sigma_px: float = ASSUMED_SIGMA_PX,
    sigma_linear: float = 0.5,
    sigma_angular: float = 0.05,
    max_per_frame: int | None = None,
) -> Recording:
    """Read the folder.

    Parameters
    ----------
    path : Path
        Folder with the files named in `FILES`.
    sigma_px : float
        Standard deviation of a pixel coordinate to assume, px.
    sigma_linear, sigma_angular : float
        White noise of the velocities in the IMU frame, m/s and rad/s per axis.
    max_per_frame : int, optional
        Thin the tracks to so many landmarks at a time, long tracks first; None keeps all (25 to 120 a frame).

    Returns
    -------
    Recording
        W is the left camera at frame 0. Frames after the last pose of the ground truth have no truth.

    Raises
    ------
    ValueError
        A file is damaged, has the wrong shape, or holds NaN: the message names it.
    """
    archive = path / "tracks.npz"
    arrays = read_archive(archive, ARRAYS)
    timestamps = arrays["time_stamps"].reshape(-1)
    count = len(timestamps)
    _check_shapes(archive, arrays, count)
    positions, orientations = read_poses(path / "poses.txt")
    truth = [Pose(r, q) for r, q in zip(positions[:count], orientations[:count], strict=True)]
    camera = _camera(archive, arrays)
    odometry = camera_velocities(
        arrays["linear_velocity"].T,
        arrays["rotational_velocity"].T,
        arrays["cam_T_imu"],
        positive("sigma_linear", sigma_linear),
        positive("sigma_angular", sigma_angular),
    )
    tracks = tracks_of_pixels(arrays["features"].transpose(0, 2, 1))
    positive_disparity = tracks.with_positive_disparity()
    source: dict[str, Any] = {
        "reader": NAME,
        "path": str(path),
        "sigma_px": float(sigma_px),
        "sigma_linear_m_s": float(sigma_linear),
        "sigma_angular_rad_s": float(sigma_angular),
        "max_per_frame": max_per_frame,
        "dropped_non_positive_disparity": len(tracks) - len(positive_disparity),
        "frames_without_truth": count - len(truth),
    }
    frames = frames_of(
        positive_disparity.thinned(max_per_frame),
        timestamps,
        [*truth, *[None] * (count - len(truth))],
        odometry,
    )
    noise = StereoNoise.independent_pixels(sigma_px)
    return Recording(NAME, camera, frames, noise, source=source, truth_from=TRUTH)


def camera_velocities(
    linear_imu: FloatArray,
    angular_imu: FloatArray,
    cam_T_imu: FloatArray,
    sigma_linear: float,
    sigma_angular: float,
) -> list[BodyVelocity | None]:
    """Velocities of the left camera from those of the IMU.

    The camera sits at p in the IMU frame, so v_cam = R (v_imu + w x p), w_cam = R w. `cam_T_imu[:3, 3]` of this data
    set is that p, not the translation of a cam <- imu transform. The lever arm couples the errors: covariance
    J diag(sigma_v^2 I, sigma_w^2 I) J^T with J = [[R, -R [p]x], [0, R]].

    Parameters
    ----------
    linear_imu, angular_imu : (K, 3) ndarray
        m/s and rad/s in the IMU frame. Row k + 1 describes the motion from frame k to frame k + 1, which is how
        `Frame.odometry` counts; row 0 has no step and is left out.
    cam_T_imu : (4, 4) ndarray
        As stored.
    sigma_linear, sigma_angular : float
        Per axis, m/s and rad/s.

    Returns
    -------
    list of K
        None for frame 0.
    """
    R_ci, p_i = cam_T_imu[:3, :3], cam_T_imu[:3, 3]
    linear = (linear_imu + np.cross(angular_imu, p_i)) @ R_ci.T
    angular = angular_imu @ R_ci.T
    x, y, z = p_i
    lever = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    J = np.block([[R_ci, -R_ci @ lever], [np.zeros((3, 3)), R_ci]])
    covariance = (J * np.repeat([sigma_linear**2, sigma_angular**2], 3)) @ J.T
    covariance = 0.5 * (covariance + covariance.T)
    return [None, *(BodyVelocity(v, w, covariance) for v, w in zip(linear[1:], angular[1:], strict=True))]


def _check_shapes(archive: Path, arrays: dict[str, FloatArray], count: int) -> None:
    landmarks = arrays["features"].shape[1] if arrays["features"].ndim == 3 else -1
    wanted: dict[str, tuple[int, ...]] = {
        "features": (4, landmarks, count),
        "linear_velocity": (3, count),
        "rotational_velocity": (3, count),
        "K": (3, 3),
        "cam_T_imu": (4, 4),
    }
    for key, shape in wanted.items():
        if arrays[key].shape != shape:
            raise ValueError(f"{archive}: array {key} has shape {arrays[key].shape}, expected {shape}")
    for key in ARRAYS:
        if not np.isfinite(arrays[key]).all():
            raise ValueError(f"{archive}: array {key} has NaN or infinity: mark unseen features with -1")


def _camera(archive: Path, arrays: dict[str, FloatArray]) -> StereoCamera:
    K, b = arrays["K"], arrays["b"]
    if b.size != 1:
        raise ValueError(f"{archive}: array b has shape {b.shape}, expected one number (the baseline in m)")
    fx, fy, cx, cy = map(float, (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    return StereoCamera(fx, fy, cx, cy, float(b.reshape(-1)[0]), *IMAGE_SIZE)
