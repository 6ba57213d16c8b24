"""Accelerations of a camera are those that its tracks show, without what their noise adds."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from filters import (
    BodyVelocity,
    ConstantVelocity,
    InertialSamples,
    InertialUnit,
    StereoCamera,
    StereoNoise,
    StereoObservation,
)
from stereo_slam_env.frontend.camera_motion import (
    camera_steps,
    needed_motion,
    odometry_errors,
    require_gyro_units,
    set_up_for_tracks,
)
from stereo_slam_env.recording.recording import Frame, Recording, Reference

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


@pytest.mark.parametrize("scale", [1e-3, 1e3 * 1e-6, 1e-9])
def test_motions_of_no_camera_are_refused_with_the_doubt_about_their_times(scale):
    recording = drive(6.0, 0.6)[:60]
    hasty = replace(
        recording, frames=tuple(replace(frame, timestamp=scale * frame.timestamp) for frame in recording.frames)
    )
    with pytest.raises(
        ValueError, match=r"accelerations of \S+ m/s\^2 and \S+ rad/s\^2, as no camera has, at .* seconds"
    ):
        needed_motion(hasty)


def with_gyro(recording: Recording, scale: float, turning: int = FRAMES) -> Recording:
    """With samples of a gyro that turns so many times as far as the images, in the first `turning` steps alone."""
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5])
    unit = InertialUnit(np.zeros(3), turn.as_quat(), 1e-4, 1e-3, 1e-6, 1e-4)
    frames, times = [recording.frames[0]], np.array([0.25 * DT, 0.5 * DT, DT])
    for k, (frame, found) in enumerate(zip(recording.frames[1:], camera_steps(CAMERA, recording.frames), strict=True)):
        rate = scale * turn.inv().apply(Rotation.from_matrix(found.step.R).as_rotvec()) / DT
        samples = InertialSamples(times, np.tile(rate, (3, 1)), np.tile([0.0, 0.0, 9.81], (3, 1)), unit)
        frames.append(replace(frame, inertial=samples) if k < turning else frame)
    return replace(recording, frames=tuple(frames))


@pytest.mark.parametrize(
    ("scale", "refused"),
    [(1.0, False), (28.0, False), (32.0, True), (np.rad2deg(1.0), True), (108.0, True), (112.0, False)],
)
def test_a_gyro_in_degrees_is_known_by_the_turns_of_the_images(scale, refused):
    """However slow it turns: its rates are below what any camera turns by."""
    recording = with_gyro(drive(0.5, 0.5)[:60], scale)
    if not refused:
        require_gyro_units(recording)
        return
    said = f"the gyro turns {scale:.1f} times as far as the images: .*degrees per second"
    with pytest.raises(ValueError, match=said):
        require_gyro_units(recording)


def test_five_turns_tell_the_unit_of_a_gyro_and_four_do_not():
    recording = drive(0.5, 2.0)[:60]
    turns = [
        np.linalg.norm(Rotation.from_matrix(one.step.R).as_rotvec()) for one in camera_steps(CAMERA, recording.frames)
    ]
    enough = np.cumsum(np.array(turns) > 0.005)
    require_gyro_units(with_gyro(recording, 57.3, turning=int(np.argmax(enough == 4)) + 1))
    with pytest.raises(ValueError, match="degrees per second"):
        require_gyro_units(with_gyro(recording, 57.3, turning=int(np.argmax(enough == 5)) + 1))


def test_the_velocity_between_frames_counts_with_their_own_times():
    """Frames of uneven times along one steady motion show no acceleration."""
    recording = drive(0.0, 0.0)
    steady = [replace(frame, timestamp=DT * k) for k, frame in enumerate(recording.frames)]
    uneven = [frame for k, frame in enumerate(steady) if k % 3]
    found = needed_motion(replace(recording, frames=tuple(uneven)), NOTHING)
    assert found.sigma_acceleration < 0.4


# --- odometry against tracks ---

SIGMAS = np.repeat([0.05, 0.02], 3)


def swaying(late: float = 0.0, bias: ArrayLike = 0.0, turns: float = 0.2, seed: int = 0) -> Recording:
    """A camera that sways before 100 points, with odometry `late` by some seconds and off by a bias, rad/s."""
    rng, fine = np.random.default_rng(seed), DT / 20
    times = np.arange(20 * (FRAMES + 10)) * fine
    rates = turns * np.sin(np.outer(times, [1.3, 2.1, 1.7]))
    speeds = 0.3 * np.cos(np.outer(times, [1.1, 0.7, 1.9]))
    points, pixels = rng.uniform(-1.0, 1.0, (100, 3)) * 3.0 + [0.0, 0.0, 6.0], np.linalg.cholesky(NOISE.R)
    p, R, frames, covariance = np.zeros(3), Rotation.identity(), [], np.diag(SIGMAS**2)
    for k in range(FRAMES):
        uvd = CAMERA.project(R.inv().apply(points - p)) + rng.normal(size=(len(points), 3)) @ pixels.T
        seen, odometry = np.flatnonzero(CAMERA.in_view(uvd)), None
        if k:
            begin = 20 * (k + 4) - round(late / fine)
            over = slice(begin, begin + 20)
            noise = SIGMAS * rng.normal(size=6)
            odometry = BodyVelocity(
                speeds[over].mean(axis=0) + noise[:3], rates[over].mean(axis=0) + bias + noise[3:], covariance
            )
        frames.append(Frame(k * DT, StereoObservation(seen, uvd[seen]), odometry))
        for i in range(20 * (k + 5), 20 * (k + 6)):
            p, R = p + R.apply(speeds[i] * fine), R * Rotation.from_rotvec(rates[i] * fine)
    return Recording("swaying", CAMERA, tuple(frames), NOISE, truth_from=Reference("surveyed", "exact"))


@pytest.mark.parametrize("late", [0.0, 0.07, 0.2, -0.05])
def test_the_delay_of_odometry_is_measured_as_well_as_it_claims(late):
    found = odometry_errors(swaying(late))
    assert found.delay_sigma < 0.01
    assert abs(found.delay - late) < 3.5 * found.delay_sigma


def test_a_bias_of_its_rates_is_measured_as_well_as_it_claims():
    bias = (0.011, -0.011, 0.006)
    errors = [odometry_errors(swaying(0.05, bias, seed=seed)) for seed in range(4)]
    normalised = np.array([(e.bias - bias) / e.bias_sigma for e in errors])
    assert np.abs(normalised).max() < 4.0
    assert max(e.bias_sigma.max() for e in errors) < 0.004


def test_without_turns_a_delay_stays_as_unknown_as_it_was():
    found = odometry_errors(swaying(0.1, turns=0.0))
    assert (found.delay, found.delay_sigma) == (0.0, 0.05)


def test_a_recording_is_set_up_with_its_odometry_in_time_and_without_the_bias():
    wrong, right = swaying(0.2, (0.02, 0.0, 0.0)), swaying()
    read = set_up_for_tracks(wrong)
    assert "ms late" in read.source["odometry"]
    pairs = [(a.odometry, b.odometry) for a, b in zip(read.frames[1:-3], right.frames[1:-3], strict=True)]
    off = np.array([np.r_[a.linear - b.linear, a.angular - b.angular] for a, b in pairs])
    assert np.abs(off.mean(axis=0)).max() < 0.01
    assert np.all(off.std(axis=0) < 2.0 * SIGMAS)
    assert all(np.all(np.diag(a.covariance) > np.diag(b.covariance)) for a, b in pairs)


def test_odometry_of_a_part_of_the_drive_is_measured_there():
    whole = swaying(0.1)
    part = replace(
        whole, frames=tuple(replace(f, odometry=f.odometry if k % 3 else None) for k, f in enumerate(whole.frames))
    )
    few = replace(
        whole, frames=tuple(replace(f, odometry=f.odometry if k < 33 else None) for k, f in enumerate(whole.frames))
    )
    assert odometry_errors(part).delay == pytest.approx(0.1, abs=0.02)
    assert abs(odometry_errors(few).delay) < 0.2
    assert [f.odometry is None for f in set_up_for_tracks(few).frames] == [f.odometry is None for f in few.frames]


def test_odometry_of_few_frames_and_of_simulations_is_left_alone():
    assert odometry_errors(swaying(0.2)[:20]) is None
    simulated = replace(swaying(0.2), truth_from=Reference("simulation", "exact"))
    assert set_up_for_tracks(simulated) is simulated
