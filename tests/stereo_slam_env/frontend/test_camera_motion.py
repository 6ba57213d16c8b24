"""Accelerations of a camera are those that its tracks show, without what their noise adds."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import ConstantVelocity, StereoCamera, StereoNoise, StereoObservation
from stereo_slam_env.frontend.camera_motion import needed_motion
from stereo_slam_env.recording.recording import Frame, Recording

CAMERA = StereoCamera(400.0, 400.0, 319.5, 239.5, 0.25, 640, 480)
NOISE = StereoNoise.independent_pixels(0.3)
DT, FRAMES = 0.1, 200
NOTHING = ConstantVelocity(1e-6, 1e-6)


def drive(linear: float, angular: float) -> Recording:
    """A camera before 100 points; every other acceleration takes the one before it back."""
    rng = np.random.default_rng(1)
    points, pixels = rng.uniform(-1.0, 1.0, (100, 3)) * [3.0, 3.0, 3.0] + [0.0, 0.0, 6.0], np.linalg.cholesky(NOISE.R)
    p, R, v, w, frames = np.zeros(3), Rotation.identity(), np.zeros(3), np.zeros(3), []
    for k in range(FRAMES):
        uvd = CAMERA.project(R.inv().apply(points - p)) + rng.normal(size=(len(points), 3)) @ pixels.T
        seen = np.flatnonzero(CAMERA.in_view(uvd))
        frames.append(Frame(k * DT, StereoObservation(seen, uvd[seen])))
        if k % 2 == 0:
            a, alpha = linear * rng.normal(size=3), angular * rng.normal(size=3)
        else:
            a, alpha = -a, -alpha
        v, w = v + a * DT, w + alpha * DT
        p, R = p + v * DT, R * Rotation.from_rotvec(w * DT)
    return Recording("drive", CAMERA, tuple(frames), NOISE)


@pytest.mark.parametrize(("linear", "angular"), [(6.0, 0.6), (1.0, 3.0)])
def test_accelerations_are_measured(linear, angular):
    found = needed_motion(drive(linear, angular), NOTHING)
    assert found.sigma_acceleration == pytest.approx(linear, rel=0.12)
    assert found.sigma_angular_acceleration == pytest.approx(angular, rel=0.12)


def test_noise_of_the_tracks_is_no_acceleration():
    found = needed_motion(drive(0.0, 0.0), NOTHING)
    assert found.sigma_acceleration < 0.4  # the noise of the motions alone is worth 1 m/s^2
    assert found.sigma_angular_acceleration < 0.1


def test_a_calm_drive_and_one_without_common_tracks_keep_the_usual_motion():
    assert needed_motion(drive(1.0, 0.1)) == ConstantVelocity()
    assert needed_motion(drive(1.0, 0.1)[:1], NOTHING) == NOTHING
