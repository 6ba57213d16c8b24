"""Odometry from the velocities of an inertial navigation system (INS)."""

from __future__ import annotations

import numpy as np

from filters.interface import BodyVelocity
from filters.validation import FloatArray, positive
from stereo_slam_env.datasets.kitti07_tracks import camera_velocities


def noisy_camera_velocities(
    linear_imu: FloatArray,
    angular_imu: FloatArray,
    R_ci: FloatArray,
    p_i: FloatArray,
    *,
    sigma_linear: float,
    sigma_angular: float,
    seed: int,
) -> list[BodyVelocity | None]:
    """Velocities of the left camera from those of the INS, with white noise added to them.

    The ground truth of such recordings was made from the same INS, so its velocities as they are would be the truth
    by another name: noise makes wheel-odometry-like measurements of them, with a covariance that is right.

    Parameters
    ----------
    linear_imu, angular_imu : (K, 3)
        m/s and rad/s in the IMU frame (x forward, y left, z up). Row k describes the step from frame k - 1 to k.
    R_ci : (3, 3)
        Takes vectors from the IMU frame to the camera frame.
    p_i : (3,)
        Camera position in the IMU frame, m.
    sigma_linear, sigma_angular : float
        Noise to add, standard deviation per axis, m/s and rad/s.
    seed : int
        Of the noise; the same seed gives the same odometry.

    Returns
    -------
    list of K
        None for frame 0.
    """
    sigmas = positive("sigma_linear", sigma_linear), positive("sigma_angular", sigma_angular)
    noise = np.random.default_rng(seed).standard_normal((2, len(linear_imu), 3))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R_ci, p_i
    return camera_velocities(linear_imu + sigmas[0] * noise[0], angular_imu + sigmas[1] * noise[1], T, *sigmas)
