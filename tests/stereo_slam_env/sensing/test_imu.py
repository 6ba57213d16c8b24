"""The simulated inertial unit: exact without errors, and with errors those of its data sheet."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.sensing.imu import DATA_SHEETS, DataSheet, Imu

EXACT = DataSheet(0.0, 0.0, 0.0, 0.0, gyro_bias=0.0, accelerometer_bias=0.0)
GRAVITY = np.array([0.0, 9.81, 0.0])
FRAMES = 0.1 * np.arange(60)
RATE, RADIUS = 0.4, 10.0


def circle(t: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """A steady turn to the right: w about y, centripetal acceleration along x."""
    angle = RATE * t
    at = RADIUS * np.column_stack([1.0 - np.cos(angle), np.zeros(len(t)), np.sin(angle)])
    return at, Rotation.from_rotvec(np.outer(angle, [0.0, 1.0, 0.0]))


def still(t: np.ndarray) -> tuple[np.ndarray, Rotation]:
    return np.zeros((len(t), 3)), Rotation.identity(len(t))


def numbers(imu: Imu, path=circle, seed: int = 0) -> np.ndarray:
    """All samples of a drive, (N, 6), in the camera frame as stated."""
    steps, _ = imu.measure(path, FRAMES, GRAVITY, np.random.default_rng(seed))
    turn = Rotation.from_quat(imu.orientation).as_matrix()
    return np.vstack([np.hstack([s.angular_rates @ turn.T, s.specific_forces @ turn.T]) for s in steps[1:]])


def test_without_errors_it_measures_the_turn_and_the_force() -> None:
    """With the lever arm: r = R - x of the unit, so w^2 r towards the centre, along x, and w^2 z against z."""
    imu = Imu(EXACT)
    x, _, z = imu.position
    force = [RATE**2 * (RADIUS - x), -9.81, -(RATE**2) * z]
    np.testing.assert_allclose(numbers(imu), np.tile([0.0, RATE, 0.0, *force], (59 * 20, 1)), atol=2e-5)


def test_the_steps_are_those_of_the_frames() -> None:
    steps, biases = Imu("bmi088", rate=100.0).measure(circle, FRAMES, GRAVITY, np.random.default_rng(0))
    assert steps[0] is None
    assert len(steps) == len(biases) == len(FRAMES)
    for step in steps[1:]:
        assert len(step.times) == 10
        step.check_step(0.1)
        assert step.unit.gyro_density == DATA_SHEETS["bmi088"].gyro_density


def test_noise_and_walks_are_those_of_the_sheet() -> None:
    """Over 100 drives of 6 s at rest: white noise within 2 %, biases at the start and walks within 20 %."""
    sheet = DATA_SHEETS["car"]
    first, last, white = [], [], []
    for seed in range(100):
        steps, biases = Imu("car", rate=20.0).measure(still, FRAMES, 0.0 * GRAVITY, np.random.default_rng(seed))
        first.append(biases[0])
        last.append(biases[-1] - biases[0])
        for step, bias in zip(steps[1:], biases, strict=False):
            white.append(np.hstack([step.angular_rates, step.specific_forces]) - bias)
    off = np.sqrt(np.mean(np.square(np.vstack(white)), axis=0)) * np.sqrt(0.05)
    np.testing.assert_allclose(off, np.repeat([sheet.gyro_density, sheet.accelerometer_density], 3), rtol=0.02)
    np.testing.assert_allclose(np.std(first, axis=0), np.repeat([0.01, 0.1], 3), rtol=0.2)
    walked = np.repeat([sheet.gyro_walk, sheet.accelerometer_walk], 3) * np.sqrt(5.9)
    np.testing.assert_allclose(np.std(last, axis=0), walked, rtol=0.2)


@pytest.mark.parametrize(("error", "axes"), [("scale", [1]), ("misalignment", [0, 2])])
def test_scale_and_misalignment_are_constant_over_a_drive(error: str, axes: list[int]) -> None:
    """A scale shows along gravity, a misalignment across it."""
    sheet, off = DataSheet(0.0, 0.0, 0.0, 0.0, gyro_bias=0.0, accelerometer_bias=0.0, **{error: 0.01}), []
    for seed in range(60):
        measured = numbers(Imu(sheet, rate=20.0), still, seed)[:, 3:] + GRAVITY
        assert np.ptp(measured, axis=0).max() < 1e-9
        off.append(measured[0])
    assert np.std(np.array(off)[:, axes]) == pytest.approx(0.01 * 9.81, rel=0.25)


def test_a_clock_that_is_late_shows_a_later_path() -> None:
    def faster(t: np.ndarray) -> tuple[np.ndarray, Rotation]:
        return np.zeros((len(t), 3)), Rotation.from_rotvec(np.outer(0.5 * t**2, [0.0, 1.0, 0.0]))

    exact, late = (numbers(Imu(EXACT, time_offset=offset), faster) for offset in (0.0, 0.02))
    np.testing.assert_allclose(late[:, 1] - exact[:, 1], 0.02, atol=1e-9)


def test_what_is_not_stated_is_a_unit_before_the_left_camera_at_200_hertz() -> None:
    """x forward, y left, z up in the unit; its sheet is the one of EuRoC, of which biases are what is usual."""
    imu, sheet = Imu(), DataSheet(1.0, 2.0, 3.0, 4.0)
    assert imu.sheet is DATA_SHEETS["adis16448"]
    assert (imu.position, imu.rate, imu.time_offset) == ((0.05, -0.1, 0.2), 200.0, 0.0)
    axes = Rotation.from_quat(imu.orientation).as_matrix()
    np.testing.assert_allclose(axes, np.column_stack([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), atol=1e-12)
    assert (sheet.gyro_bias, sheet.accelerometer_bias, sheet.scale, sheet.misalignment) == (0.01, 0.1, 0.0, 0.0)
    with pytest.raises(ValueError, match=r"^imu has no data sheet 'bmi08'"):
        Imu("bmi08")


def test_densities_are_those_of_the_published_sheets() -> None:
    degree, micro_g = np.deg2rad(1.0), 9.80665e-6
    assert DATA_SHEETS["adis16448"] == DataSheet(1.7e-4, 2.0e-3, 1.9e-5, 3.0e-3, scale=5e-4, misalignment=5e-4)
    for name, gyro, accelerometer in (("bmi088", 0.014, 175.0), ("car", 0.05, 500.0)):
        sheet = DATA_SHEETS[name]
        assert sheet.gyro_density == pytest.approx(gyro * degree, rel=0.05)
        assert sheet.accelerometer_density == pytest.approx(accelerometer * micro_g, rel=0.05)
