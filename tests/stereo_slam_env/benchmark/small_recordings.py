"""A short, exact drive past a few points: every quantity of a run can be known beforehand."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, Pose, Start, StereoCamera, StereoNoise, StereoObservation
from stereo_slam_env.recording.recording import Frame, LandmarkTruth, Recording, Velocity

CAMERA = StereoCamera(700.0, 700.0, 600.0, 180.0, 0.5, 1200, 360)
DT, SPEED, YAW_RATE = 0.1, 5.0, 0.2


def small_recording(
    seed: int | None = 0, frames: int = 15, *, truth: bool = True, odometry: bool = True, sigma: float = 1.0
) -> Recording:
    """Constant speed and yaw rate; 40 points 8 to 90 m ahead; noise of `sigma` px on every pixel."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-10, 10, 40), rng.uniform(-3, 1.5, 40), rng.uniform(12, 90, 40)])
    noise = StereoNoise.independent_pixels(sigma)
    r, R = np.zeros(3), Rotation.identity()
    turn = Rotation.from_rotvec([0.0, YAW_RATE * DT, 0.0])
    half = Rotation.from_rotvec([0.0, 0.5 * YAW_RATE * DT, 0.0])
    taken = []
    for k in range(frames):
        v_w = (R * half).as_matrix() @ [0.0, 0.0, SPEED]
        if k:
            r, R = r + v_w * DT, R * turn
        p_c = (points - r) @ R.as_matrix()
        uvd = CAMERA.project(p_c)
        seen = (p_c[:, 2] > 2.0) & CAMERA.in_view(uvd)
        noisy = uvd[seen] + rng.multivariate_normal(np.zeros(3), noise.R, int(seen.sum()))
        step = BodyVelocity([0.0, 0.0, SPEED], [0.0, YAW_RATE, 0.0], 1e-4 * np.eye(6))
        taken.append(
            Frame(
                k * DT,
                StereoObservation(np.flatnonzero(seen), noisy),
                step if odometry and k else None,
                Pose(r, R.as_quat()) if truth else None,
                Velocity(v_w, np.array([0.0, YAW_RATE, 0.0])) if truth else None,
            )
        )
    start = Start(
        linear_velocity=np.array([0.0, 0.0, SPEED]),
        angular_velocity=np.array([0.0, YAW_RATE, 0.0]),
        covariance=np.diag(np.repeat([1e-6, 1e-6, 0.1, 0.01], 3) ** 2),
    )
    landmarks = LandmarkTruth(np.arange(40), points) if truth else None
    return Recording("small", CAMERA, tuple(taken), noise, start, landmarks, {"made": "by hand", "seed": seed})
