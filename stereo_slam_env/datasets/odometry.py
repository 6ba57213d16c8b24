"""Odometry of the left camera from the velocities of an inertial navigation system (INS)."""

from __future__ import annotations

import numpy as np

from filters import BodyVelocity, rotations
from filters.validation import FloatArray, positive


def camera_velocities(
    linear_imu: FloatArray,
    angular_imu: FloatArray,
    R_ci: FloatArray,
    p_i: FloatArray,
    *,
    sigma_linear: float,
    sigma_angular: float,
    seed: int | None = None,
) -> list[BodyVelocity | None]:
    """Velocities of the left camera from those of the IMU (K, 3), m/s and rad/s; None for frame 0.

    v_c = R (v_i + w_i x p), w_c = R w_i, with the rotation R_ci (3, 3) and the camera position p_i (3,) in the IMU
    frame. Row k describes the step from frame k - 1 to k, as `Frame.odometry` does. The lever arm p couples the errors:
    their covariance is J diag(sigma_v^2 I, sigma_w^2 I) J^T with J = [[R, -R [p]x], [0, R]], for white noise of
    `sigma_linear` and `sigma_angular` per axis in the IMU frame. With a `seed` that noise is added first, for
    recordings whose truth was made from the same INS: its velocities as they are would be the truth by another name.
    """
    sigmas = positive("sigma_linear", sigma_linear), positive("sigma_angular", sigma_angular)
    if seed is not None:
        noise = np.random.default_rng(seed).standard_normal((2, len(linear_imu), 3))
        linear_imu, angular_imu = linear_imu + sigmas[0] * noise[0], angular_imu + sigmas[1] * noise[1]
    linear = (linear_imu + np.cross(angular_imu, p_i)) @ R_ci.T
    angular = angular_imu @ R_ci.T
    J = np.block([[R_ci, -R_ci @ rotations.skew(p_i)], [np.zeros((3, 3)), R_ci]])
    covariance = (J * np.repeat([sigmas[0] ** 2, sigmas[1] ** 2], 3)) @ J.T
    covariance = 0.5 * (covariance + covariance.T)
    return [None, *(BodyVelocity(v, w, covariance) for v, w in zip(linear[1:], angular[1:], strict=True))]
