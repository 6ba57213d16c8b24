"""How vehicles move: the car that is steered, the scripted drive, the head, and what the odometry says of it."""

from itertools import pairwise

import numpy as np
import pytest

from filters.geometry import rotations
from stereo_slam_env.simulator.motion import nearest_frames, routes_ahead
from stereo_slam_env.world.routes import FRAME_PERIOD, ROUTES, loop, straight, town
from stereo_slam_env.world.vehicle import Car, Head

from .vehicles import drive, vehicle

HEAD = Head(0.571, max_angles=(2.0, 0.4), max_rates=(1.5, 1.0))


def steered(actions):
    simulator = vehicle(steered=True)
    return simulator.fleet.car[0], drive(simulator, actions)


def test_no_action_keeps_speed_and_direction():
    (speed, *_), frames = steered([[0, 0]] * 10)
    assert speed == pytest.approx(4.9)
    np.testing.assert_allclose(frames[-1].truth.position, [0, 0, 4.9], atol=1e-12)


def test_full_throttle_reaches_the_top_speed_and_brakes_to_a_stop_but_not_backwards():
    assert steered([[1, 0]] * 60)[0][0] == Car().max_speed
    (speed, *_), frames = steered([[-1, 0]] * 60)
    assert speed == 0.0
    np.testing.assert_array_equal(frames[-1].truth_velocity.linear, 0)


def test_positive_steering_turns_right():
    _, frames = steered([[0, 0.3]] * 10)
    assert frames[-1].truth.position[0] > 0
    assert frames[-1].truth_velocity.angular[1] > 0


def test_constant_steering_drives_the_circle_of_the_bicycle_model():
    (_, steering, _), frames = steered([[0, 0.4]] * 80)
    car = Car()
    radius = car.wheelbase / np.tan(0.4 * car.max_steering)
    assert steering == pytest.approx(0.4 * car.max_steering)
    rear = []
    for frame in frames[10:]:
        _, y, _, w = frame.truth.orientation
        heading = 2 * np.arctan2(y, w)
        rear.append(frame.truth.position - car.camera_forward * np.array([np.sin(heading), 0, np.cos(heading)]))
    rear = np.array(rear)[:, [0, 2]]
    design = np.column_stack([2 * rear, np.ones(len(rear))])
    center_x, center_z, rest = np.linalg.lstsq(design, (rear**2).sum(axis=1), rcond=None)[0]
    assert np.sqrt(rest + center_x**2 + center_z**2) == pytest.approx(radius, rel=1e-6)


def test_the_camera_of_a_steered_car_stays_level():
    _, frames = steered(np.random.default_rng(0).uniform(-1, 1, (50, 2)))
    assert all(frame.truth.position[1] == 0 for frame in frames)
    assert all(frame.truth_velocity.angular[0] == frame.truth_velocity.angular[2] == 0 for frame in frames)


@pytest.mark.parametrize("name", ROUTES)
def test_without_perturbation_a_scripted_drive_follows_the_nominal_poses(name):
    route = ROUTES[name]()
    simulator = vehicle(route=route)
    frames = drive(simulator, [[0, 0]] * (route.frames - 1))
    np.testing.assert_allclose([frame.truth.position for frame in frames], route.positions, atol=1e-9)
    np.testing.assert_allclose(frames[-1].truth.R_wc, rotations.exp([0, route.headings[-1], 0]), atol=1e-9)
    assert simulator.sensed.success[0]


def test_perturbations_are_there_and_stay_bounded():
    route = town()
    for seed in range(5):
        frames = drive(vehicle(route=route, seed=seed, perturbation=1.0), [[0, 0]] * (route.frames - 1))[1:]
        offsets = np.array([frame.truth.position for frame in frames]) - route.positions[1:]
        tilts = [rotations.log(R.T @ frame.truth.R_wc) for R, frame in zip(route.attitudes[1:], frames, strict=True)]
        speeds = np.array([np.linalg.norm(frame.truth_velocity.linear) for frame in frames]) - route.speeds
        assert np.abs(offsets).max() < 1.0
        assert np.abs(tilts).max() < 0.06
        assert np.std(offsets, axis=0).min() > 0.02
        assert np.std(tilts, axis=0).min() > 0.002
        assert np.std(speeds) == pytest.approx(0.15, rel=0.5)


def test_a_car_at_the_start_of_the_loop_has_not_arrived():
    simulator = vehicle(route=loop(), steered=True)
    for _ in range(45):
        drive(simulator, [[0, 0]])
        assert not simulator.sensed.success[0]


def test_the_head_turns_as_it_says_and_the_camera_with_it():
    simulator = vehicle(head=HEAD)
    commands = np.random.default_rng(0).uniform(-1.2, 1.2, (40, 2)).clip(-1, 1)
    angles, frames = np.zeros(2), drive(simulator, commands)
    for command, (before, after) in zip(commands, pairwise(frames), strict=True):
        angles = HEAD.turned(angles, command, FRAME_PERIOD)
        np.testing.assert_allclose(after.head, angles, atol=1e-14)
        there = after.truth_velocity.linear * FRAME_PERIOD
        np.testing.assert_allclose(before.truth.position + there, after.truth.position, atol=1e-12)
        turn = rotations.exp(after.truth_velocity.angular * FRAME_PERIOD)
        np.testing.assert_allclose(before.truth.R_wc @ turn, after.truth.R_wc, atol=1e-12)
    seen = HEAD.camera_pose(simulator.body(0), simulator.fleet.angles[0])
    np.testing.assert_allclose(seen.position, simulator.pose(0).position, atol=1e-12)
    np.testing.assert_allclose(seen.R_wc, simulator.pose(0).R_wc, atol=1e-12)


def test_odometry_is_the_mean_velocity_in_the_middle_of_the_step():
    frames = drive(vehicle(head=HEAD, perturbation=1.0), [[0.7, -0.4]] * 20)
    assert frames[0].odometry is None
    for before, after in pairwise(frames):
        R_middle = before.truth.R_wc @ rotations.exp(0.5 * FRAME_PERIOD * after.odometry.angular)
        there = before.truth.position + FRAME_PERIOD * R_middle @ after.odometry.linear
        np.testing.assert_allclose(there, after.truth.position, atol=1e-12)
        np.testing.assert_allclose(after.odometry.angular, after.truth_velocity.angular, atol=1e-15)


def test_the_noise_of_the_odometry_is_white_with_the_declared_covariance():
    simulator = vehicle(odometry_sigmas=(0.1, 0.01), route=loop())
    frames = drive(simulator, [[0, 0]] * 700)[1:]
    exact = drive(vehicle(route=loop()), [[0, 0]] * 700)[1:]
    measured, true = (
        np.array([np.concatenate([f.odometry.linear, f.odometry.angular]) for f in each]) for each in (frames, exact)
    )
    errors = (measured - true) / np.repeat([0.1, 0.01], 3)
    np.testing.assert_allclose(errors.std(axis=0), 1.0, rtol=4 / np.sqrt(2 * len(errors)))
    assert np.abs((errors[1:] * errors[:-1]).mean(axis=0)).max() < 4 / np.sqrt(len(errors))
    np.testing.assert_allclose(frames[0].odometry.covariance, np.diag(np.repeat([0.01, 0.0001], 3)))


@pytest.mark.parametrize("name", ROUTES)
def test_the_nearest_frame_is_that_of_the_route(name):
    route, rng = ROUTES[name](), np.random.default_rng(0)
    around = rng.integers(route.frames, size=200)
    places = route.positions[around] + rng.uniform(-5, 5, (200, 3)) * [1, 0, 1]
    found = nearest_frames(route.positions, route.arc_length, places, around)
    assert found.tolist() == [route.nearest(place, int(k)) for place, k in zip(places, around, strict=True)]


def test_the_route_ahead_is_as_the_camera_has_it():
    route, rng = town(), np.random.default_rng(1)
    nearest = rng.integers(route.frames, size=50)
    q = rotations.exp_quaternion(rng.normal(size=(50, 3)) * 0.3)
    poses = np.column_stack([route.positions[nearest] + rng.uniform(-3, 3, (50, 3)), q])
    ahead = routes_ahead(route.positions, route.arc_length, nearest, poses, 60.0)
    for pose, k, points in zip(poses, nearest, ahead, strict=True):
        points_w = route.points_at(route.arc_length[k] + np.array([2.0, 5.0, 10.0, 20.0, 30.0]))
        expected = (points_w - pose[:3]) @ rotations.matrix(pose[3:])
        np.testing.assert_allclose(points, expected[:, [0, 2]], rtol=1e-5, atol=1e-5)


def test_the_end_of_a_straight_route_is_arrived_at_by_a_steered_car():
    simulator = vehicle(steered=True)
    drive(simulator, [[0, 0]] * (straight().frames - 2))
    assert not simulator.sensed.success[0]
    drive(simulator, [[0, 0]])
    assert simulator.sensed.success[0]
