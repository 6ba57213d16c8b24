"""The smooth ride in numbers: waves of the road, springs, the low-pass, and samples of the unit (3 s)."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters.geometry import rotations
from stereo_slam_env.sensing.imu import DataSheet, Imu
from stereo_slam_env.simulator.motion import ODOMETRY
from stereo_slam_env.world.routes import Route

from .vehicles import drive, vehicle

EXACT = DataSheet(0.0, 0.0, 0.0, 0.0, gyro_bias=0.0, accelerometer_bias=0.0)
WAVES = {
    "height": {0.125: 0.02, 0.375: 0.008, 1.1: 0.003},
    "pitch": {0.5: 2e-3, 1.1: 2e-3},
    "roll": {0.5: 2e-3, 1.1: 2e-3},
}
"""Amplitudes, m and rad, by wave number, rad/m."""
SPEED = 4.9


def angles_of(frames):
    """Pitch and roll, upwards and to the left positive or not as the camera has them, rad: about its x and z."""
    return np.array([rotations.log(frame.truth.R_wc) for frame in frames])


def fitted(values, metres, waves):
    """Amplitudes of waves by least squares, whatever their phases, and what they leave."""
    columns = [np.ones_like(metres)]
    for number in waves:
        columns += [np.sin(number * metres), np.cos(number * metres)]
    solution, *_ = np.linalg.lstsq(np.column_stack(columns), values, rcond=None)
    left = values - np.column_stack(columns) @ solution
    return np.hypot(solution[1::2], solution[2::2]), np.abs(left).max()


@pytest.mark.parametrize("roughness", [1.0, 2.5])
@pytest.mark.parametrize("kind", WAVES)
def test_the_road_is_made_of_these_waves(kind, roughness):
    """At a constant speed on a straight road nothing else moves the camera; it begins level, at its height."""
    simulator = vehicle(smooth=True, roughness=roughness)
    frames = drive(simulator, [[0, 0]] * 190)
    metres = SPEED * 0.1 * np.arange(len(frames))
    values = {
        "height": np.array([frame.truth.position[1] for frame in frames]),
        "pitch": angles_of(frames)[:, 0],
        "roll": angles_of(frames)[:, 2],
    }[kind]
    amplitudes, left = fitted(values, metres, WAVES[kind])
    np.testing.assert_allclose(amplitudes, roughness * np.array([*WAVES[kind].values()]), rtol=0.01)
    assert left < 1e-4
    assert values[0] == 0.0
    np.testing.assert_allclose([frame.truth.position[2] for frame in frames], metres, atol=1e-9)


def test_the_velocity_that_is_true_is_that_of_the_camera_at_the_frame():
    """By differences of poses over 0.1 s, whose waves are 2 m long and longer: to a few per cent."""
    frames = drive(vehicle(smooth=True, roughness=2.0), [[0, 0]] * 60)
    position = np.array([frame.truth.position for frame in frames])
    for k in range(2, 58):
        around = (position[k + 1] - position[k - 1]) / 0.2
        np.testing.assert_allclose(frames[k].truth_velocity.linear, around, atol=0.02)
        turn = rotations.log(frames[k - 1].truth.R_wc.T @ frames[k + 1].truth.R_wc) / 0.2
        np.testing.assert_allclose(frames[k].truth_velocity.angular, turn, atol=6e-3)


def lean_after(commands, **options):
    """Attitude (pitch, yaw, roll) at the end of a drive on an even road, rad."""
    simulator = vehicle(smooth=True, roughness=0.0, steered=True, lane=1e3, **options)
    frames = drive(simulator, commands)
    heading = simulator.fleet.car[0, 2]
    return rotations.log(rotations.exp([0.0, -heading, 0.0]) @ frames[-1].truth.R_wc), frames


def test_springs_pitch_with_the_acceleration_along_and_roll_with_that_across():
    """7 mrad per m/s^2 once they are at rest: the nose up in front of a push, the body outwards in a bend."""
    (pitch, _, roll), frames = lean_after([[0.5, 0.0]] * 35)  # 1.5 m/s^2
    assert pitch == pytest.approx(0.007 * 1.5, rel=0.1)
    assert roll == pytest.approx(0.0, abs=1e-9)
    (pitch, _, roll), frames = lean_after([[0.0, 0.3]] * 60)
    across = frames[-1].truth_velocity.angular[1] * np.linalg.norm(frames[-1].truth_velocity.linear)
    assert across > 1.0
    assert roll == pytest.approx(-0.007 * across, rel=0.1)
    assert abs(pitch) < 0.3 * abs(roll)


def test_springs_swing_with_their_frequency_and_damping():
    """After the brakes have stopped the car: 1.2 Hz, and a damping of 0.45."""
    _, frames = lean_after([[-1.0, 0.0]] * 17 + [[0.0, 0.0]] * 30)
    pitch = angles_of(frames)[20:, 0]
    design = np.column_stack([pitch[1:-1], pitch[:-2]])  # x'' of a damped swing
    (a, b), *_ = np.linalg.lstsq(design, pitch[2:], rcond=None)
    poles = np.log(np.roots([1.0, -a, -b]).astype(complex)) / 0.1
    assert np.abs(poles[0]) == pytest.approx(np.sqrt(60.0), rel=0.05)
    assert -poles[0].real == pytest.approx(3.5, rel=0.1)


def test_the_camera_follows_a_steady_push_by_two_time_constants():
    """A critically damped low-pass of 30 rad/s is 2/30 s late."""
    _, frames = lean_after([[0.4, 0.0]] * 25)  # 1.2 m/s^2
    speeds = np.array([frame.truth_velocity.linear[2] for frame in frames])
    expected = SPEED + 1.2 * (0.1 * np.arange(26) - 2.0 / 30.0)
    np.testing.assert_allclose(speeds[10:], expected[10:], atol=0.02)


PLACE, TURN = (0.3, -0.2, 0.5), Rotation.from_euler("xyz", [0.4, -0.3, 1.1]).as_quat()


def samples_of(place=(0.0, 0.0, 0.0), orientation=(0.0, 0.0, 0.0, 1.0), roughness=2.0):
    """Rates and forces in the camera frame, (steps, 20, 6), with the poses before and after each step."""
    imu = Imu(EXACT, position=place, orientation=tuple(orientation))
    simulator = vehicle(smooth=True, steered=True, lane=1e3, imu=imu, roughness=roughness)
    turn, samples, poses = Rotation.from_quat(orientation).as_matrix(), [], [simulator.frame(0)]
    for command in [[0.5, 0.3]] * 6 + [[-0.6, -0.5]] * 8:
        poses.append(drive(simulator, [command])[-1])
        numbers = simulator.sensed.inertial[0].copy()
        samples.append(np.hstack([numbers[:, :3] @ turn.T, numbers[:, 3:] @ turn.T]))
    return np.array(samples), poses


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), PLACE])
def test_rates_and_forces_lead_from_pose_to_pose(place):
    """Integrated over 20 samples of 5 ms: turns exactly, velocities of the unit's place to 1e-6 m/s."""
    samples, frames = samples_of(place)
    for step, (before, after) in zip(samples, pairwise(frames), strict=True):
        R, gained = before.truth.R_wc, np.zeros(3)
        for rate, force in zip(step[:, :3], step[:, 3:], strict=True):
            gained += 0.005 * (R @ rotations.exp(0.0025 * rate) @ force + [0.0, 9.81, 0.0])
            R = R @ rotations.exp(0.005 * rate)
        np.testing.assert_allclose(R, after.truth.R_wc, atol=1e-9)
        had, has = (
            frame.truth_velocity.linear + frame.truth.R_wc @ np.cross(frame.truth_velocity.angular, place)
            for frame in (before, after)
        )
        np.testing.assert_allclose(gained, has - had, atol=1e-6)


def test_a_unit_that_is_turned_measures_the_same_in_its_own_axes():
    straight_on, _ = samples_of(PLACE)
    turned, _ = samples_of(PLACE, TURN)
    np.testing.assert_allclose(turned, straight_on, atol=1e-9)


def test_a_road_is_drawn_for_each_episode():
    heights = []
    for seed in (1, 1, 2):
        frames = drive(vehicle(smooth=True, seed=seed), [[0, 0]] * 20)
        heights.append([frame.truth.position[1] for frame in frames])
    assert heights[0] == heights[1]
    assert np.abs(np.subtract(heights[0], heights[2])).max() > 1e-3
    simulator = vehicle(smooth=True)
    phases = simulator.fleet.ride[0, -7:]
    assert len(set(phases.tolist())) == 7
    assert simulator.fleet.used[0, ODOMETRY] == 13  # seven phases, and six numbers of the first odometry


def test_a_slow_car_meets_the_same_road_later():
    """The road hangs on the place, not on the time."""
    fast, slow = (
        drive(vehicle(smooth=True, route=Route("even", np.full(120, speed), np.zeros(120))), [[0, 0]] * steps)
        for speed, steps in ((6.0, 20), (3.0, 40))
    )
    for one, other in zip(fast, slow[::2], strict=True):
        np.testing.assert_allclose(one.truth.position, other.truth.position, atol=1e-6)
        np.testing.assert_allclose(one.truth.R_wc, other.truth.R_wc, atol=1e-6)
