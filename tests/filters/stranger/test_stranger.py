"""A stranger's parts and filters are right at once, run on the engine as they are, and are consistent."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import (
    InertialSamples,
    InertialUnit,
    LandmarkModel,
    Start,
    StereoEKF,
    StereoObservation,
    Strapdown,
    check_part,
    nees,
)

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, START_COVARIANCE, Frame, drive
from .parts import DoubleSphere, OnS3

UNIT = InertialUnit(np.zeros(3), (0.0, 0.0, 0.0, 1.0), 1.7e-4, 2e-3, 2e-5, 3e-3)
START = Start(linear_velocity=(0.0, 0.0, SPEED), covariance=START_COVARIANCE)


@pytest.mark.parametrize("part", [OnS3(), DoubleSphere()], ids=lambda part: type(part).__name__)
def test_the_part_is_right(part: object) -> None:
    check_part(part)


def final_nees(slam: StereoEKF, frame: Frame) -> float:
    error, covariance = slam.pose_error(frame.position, frame.orientation)
    return float(nees(error[None], covariance[None])[0]) / 6.0


def seen_by(sensor: DoubleSphere, frame: Frame, rng: np.random.Generator) -> StereoObservation:
    """What the double-sphere pair measures of the same points."""
    o = frame.observation
    points_c = np.column_stack([CAMERA.ray(o.uvd), o.uvd[:, 2] / CAMERA.disparity_constant])
    noise = rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, len(o))
    numbers = sensor.predict(CAMERA, points_c, {})
    return StereoObservation(o.ids, numbers[:, :3] + noise, numbers[:, 3] + rng.standard_normal(len(o)))


@pytest.mark.parametrize("error", ["so3", "first-estimates", "right-invariant"])
@pytest.mark.parametrize("own", [{"landmark": OnS3()}, {"measurement": DoubleSphere()}], ids=["S3", "double sphere"])
def test_landmark_and_camera_are_consistent(own: dict[str, object], error: str) -> None:
    """Over twelve drives; the mean of 72 numbers of variance one is within .6 and 1.5 (four sigmas and a half)."""
    found = []
    for seed in range(12):
        options = {"landmark": "shared-anchor", "error": error, "gate": None, **own}
        slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)
        slam.reset(START)
        exact = not isinstance(own.get("landmark"), LandmarkModel)
        frames = drive(seed, 12, depths=(6.0, 40.0), noise_scale=0.0 if exact else 1.0)
        rng = np.random.default_rng(seed)
        for k, frame in enumerate(frames):
            if k:
                slam.predict(DT)
            slam.update(seen_by(slam.options.measurement, frame, rng) if exact else frame.observation)
        found.append(final_nees(slam, frames[-1]))
    assert 0.6 < np.mean(found) < 1.5


def imu_drive(seed: int, count: int = 30) -> tuple[list[Frame], list[InertialSamples]]:
    """A steady turn with an IMU of 200 Hz whose biases and noise are those of the model."""
    rng, h, rate = np.random.default_rng(seed), 0.005, np.array([0.0, 0.3, 0.0])
    gyro_bias, accelerometer_bias = rng.normal(0, 1e-2, 3), rng.normal(0, 5e-2, 3)
    points = np.column_stack([rng.uniform(-12, 25, 400), rng.uniform(-4, 1.5, 400), rng.uniform(4, 45, 400)])
    frames, steps = [], []
    for k in range(count):
        angle = rate[1] * DT * k
        R, radius = Rotation.from_rotvec([0.0, angle, 0.0]), SPEED / rate[1]
        position = radius * np.array([1.0 - np.cos(angle), 0.0, np.sin(angle)])
        p_c = R.inv().apply(points - position)
        uvd = CAMERA.project(np.where(p_c[:, 2:] > 1.0, p_c, [0.0, 0.0, 1.0]))
        ids = np.flatnonzero((p_c[:, 2] > 3.0) & CAMERA.in_view(uvd))[:25]
        uvd = uvd[ids] + rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, len(ids))
        frames.append(Frame(position, R.as_quat(), StereoObservation(ids, uvd)))
        specific = np.array([SPEED * rate[1], -9.81, 0.0])  # centripetal acceleration less gravity, in the camera frame
        samples = np.tile([*(rate + gyro_bias), *(specific + accelerometer_bias)], (20, 1))
        samples += rng.standard_normal((20, 6)) * np.repeat([1.7e-4, 2e-3], 3) / np.sqrt(h)
        steps.append(InertialSamples(h * np.arange(1, 21), samples[:, :3], samples[:, 3:], UNIT))
    return frames, steps


class Failing(DoubleSphere):
    """Raises in the middle of a frame, when it is told to."""

    broken = False
    in_machine_code = False

    def project(self, camera, h):
        """As the base class."""
        if Failing.broken:
            raise ArithmeticError("the lens is dirty")
        return DoubleSphere.project(self, camera, h)


def test_a_part_that_raises_in_the_middle_of_a_frame_leaves_the_state_as_it_was() -> None:
    slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, measurement=Failing(), motion=Strapdown())
    slam.reset(START)
    frames, steps = imu_drive(1, 4)
    rng = np.random.default_rng(0)
    for frame, step in zip(frames[:3], steps, strict=False):
        slam.predict(DT, inertial=step)
        slam.update(seen_by(DoubleSphere(), frame, rng))
    slam.predict(DT, inertial=steps[3])
    state, Failing.broken = slam.state, True
    try:
        with pytest.raises(ArithmeticError, match="the lens is dirty"):
            slam.update(seen_by(DoubleSphere(), frames[3], rng))
    finally:
        Failing.broken = False
    np.testing.assert_array_equal(np.tril(slam.state.P), np.tril(state.P))
    np.testing.assert_array_equal(slam.state.blocks, state.blocks)
    assert slam.update(seen_by(DoubleSphere(), frames[3], rng)).nis_dof > 0
