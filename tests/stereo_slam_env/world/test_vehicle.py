"""The bicycle model that an agent drives."""

import numpy as np
import pytest

from stereo_slam_env.world.routes import FRAME_PERIOD, straight
from stereo_slam_env.world.vehicle import AgentDriver, Car, advance


def drive(actions):
    driver = AgentDriver(Car(), straight())
    pose, velocity = driver.start()
    trace = [(pose, velocity)]
    for action in actions:
        velocity = driver.drive(pose, np.asarray(action, dtype=float))
        pose = advance(pose, velocity, FRAME_PERIOD)
        trace.append((pose, velocity))
    return driver, trace


def test_no_action_keeps_speed_and_direction():
    driver, trace = drive([[0, 0]] * 10)
    assert driver.speed == pytest.approx(4.9)
    np.testing.assert_allclose(trace[-1][0].position, [0, 0, 4.9], atol=1e-12)


def test_full_throttle_reaches_the_top_speed_and_brakes_to_a_stop_but_not_backwards():
    driver, _ = drive([[1, 0]] * 60)
    assert driver.speed == Car().max_speed
    driver, trace = drive([[-1, 0]] * 60)
    assert driver.speed == 0.0
    np.testing.assert_array_equal(trace[-1][1].linear, 0)


def test_positive_steering_turns_right():
    _, trace = drive([[0, 0.3]] * 10)
    assert trace[-1][0].position[0] > 0
    assert trace[-1][1].angular[1] > 0


def test_constant_steering_drives_the_circle_of_the_bicycle_model():
    driver, trace = drive([[0, 0.4]] * 80)
    car = Car()
    radius = car.wheelbase / np.tan(0.4 * car.max_steering)
    assert driver.steering == pytest.approx(0.4 * car.max_steering)
    rear = []
    for pose, _ in trace[10:]:
        _, y, _, w = pose.orientation
        heading = 2 * np.arctan2(y, w)
        rear.append(pose.position - car.camera_forward * np.array([np.sin(heading), 0, np.cos(heading)]))
    rear = np.array(rear)[:, [0, 2]]
    design = np.column_stack([2 * rear, np.ones(len(rear))])
    center_x, center_z, rest = np.linalg.lstsq(design, (rear**2).sum(axis=1), rcond=None)[0]
    assert np.sqrt(rest + center_x**2 + center_z**2) == pytest.approx(radius, rel=1e-6)


def test_the_camera_stays_level():
    _, trace = drive(np.random.default_rng(0).uniform(-1, 1, (50, 2)))
    assert all(pose.position[1] == 0 for pose, _ in trace)
    assert all(velocity.angular[0] == velocity.angular[2] == 0 for _, velocity in trace)
