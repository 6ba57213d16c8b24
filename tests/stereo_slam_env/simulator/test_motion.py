"""How vehicles move: the car that is steered, the scripted drive, the head, and what the odometry says of it."""

from itertools import pairwise

import numpy as np
import pytest

from filters.geometry import rotations
from stereo_slam_env.simulator.motion import nearest_frames, routes_ahead
from stereo_slam_env.world.routes import FRAME_PERIOD, ROUTES, loop, straight, town
from stereo_slam_env.world.vehicle import Car, Head

from .vehicles import drive, scene_of, vehicle

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


def test_constant_steering_drives_the_circle_of_the_bicycle_model():
    (_, steering, *_), frames = steered([[0, 0.4]] * 80)
    car = Car()
    radius = car.wheelbase / np.tan(0.4 * car.max_steering)
    assert steering == pytest.approx(0.4 * car.max_steering)
    assert frames[10].truth.position[0] > 0
    assert frames[10].truth_velocity.angular[1] > 0
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


def test_the_sway_is_an_ornstein_uhlenbeck_process_that_a_pull_of_half_a_second_bounds():
    """Velocity less the nominal one and the pull, in the axes of the route and of the camera; over 4000 steps."""
    sways = []
    for seed in range(20):
        simulator, route = vehicle(perturbation=1.0, route=town(), seed=seed), town()
        frames = drive(simulator, [[0, 0]] * 200)
        for k, (before, after) in enumerate(pairwise(frames)):
            nominal, R = route.attitudes[k], before.truth.R_wc
            travel = route.travel[k]
            linear = travel.T @ (after.truth_velocity.linear + 0.5 * (before.truth.position - route.positions[k]))
            angular = after.truth_velocity.angular + 0.5 * rotations.log(nominal.T @ R)
            angular = angular - R.T @ [0.0, route.yaw_rates[k], 0.0]
            sways.append([*(linear - [0.0, 0.0, route.speeds[k]]), *angular])
    sways = np.reshape(sways, (20, 200, 6))
    sigmas, times = [0.08, 0.08, 0.15, 0.012, 0.008, 0.012], np.repeat([1.0, 0.5], 3)
    np.testing.assert_allclose(sways.std(axis=(0, 1)), sigmas, rtol=0.2)
    then, now = sways[:, :-1], sways[:, 1:]
    kept = (then * now).sum(axis=(0, 1)) / (then**2).sum(axis=(0, 1))
    np.testing.assert_allclose(kept, np.exp(-FRAME_PERIOD / times), atol=0.03)


def test_sway_and_odometry_take_the_numbers_of_their_generators_in_order():
    """Six a frame of each, the first frame included, over more frames than are drawn ahead."""
    simulator = vehicle(perturbation=1.0, odometry_sigmas=(0.1, 0.01), seed=4)
    motion, _, odometry, _ = np.random.default_rng(4).spawn(4)
    drawn, errors = motion.standard_normal((151, 6)), odometry.standard_normal((151, 6))
    sigmas = np.array([0.08, 0.08, 0.15, 0.012, 0.008, 0.012])
    kept = np.exp(-FRAME_PERIOD / np.repeat([1.0, 0.5], 3))
    sway = sigmas * drawn[0]
    np.testing.assert_allclose(simulator.fleet.sway[0], sway, atol=1e-15)
    before = simulator.frame(0).truth
    for k in range(1, 151):
        sway = kept * sway + np.sqrt(1.0 - kept**2) * sigmas * drawn[k]
        frame = drive(simulator, [[0, 0]])[-1]
        np.testing.assert_allclose(simulator.fleet.sway[0], sway, atol=1e-12)
        true = frame.truth_velocity
        halfway = before.R_wc @ rotations.exp(0.5 * FRAME_PERIOD * true.angular)
        expected = np.append(halfway.T @ true.linear, true.angular) + np.repeat([0.1, 0.01], 3) * errors[k]
        measured = np.append(frame.odometry.linear, frame.odometry.angular)
        np.testing.assert_allclose(measured, expected, atol=1e-12)
        before = frame.truth
    np.testing.assert_allclose(frame.odometry.covariance, np.diag(np.repeat([0.01, 0.0001], 3)))


def test_the_metres_of_a_drive_are_those_of_its_path():
    simulator = vehicle(steered=True)
    frames = drive(simulator, np.random.default_rng(2).uniform(-1, 1, (30, 2)))
    path = np.linalg.norm(np.diff([frame.truth.position for frame in frames], axis=0), axis=1).sum()
    assert simulator.fleet.distance[0] == pytest.approx(path)


def test_tyres_slide_above_six_metres_a_second_squared():
    simulator = vehicle(steered=True)
    frames = drive(simulator, [[1.0, 0.0]] * 30 + [[1.0, 0.3]] * 30)
    for frame in frames[-20:]:
        speed = np.linalg.norm(frame.truth_velocity.linear)
        assert 12.0 * abs(frame.truth_velocity.angular[1]) == pytest.approx(6.0, rel=1e-6)
        assert speed == pytest.approx(12.0, rel=0.01)


def test_the_steering_turns_a_radian_a_second_at_most():
    car, angles = vehicle(steered=True), []
    for command in [1.0] * 8 + [-1.0] * 13:
        drive(car, [[0.0, command]])
        angles.append(car.fleet.car[0, 1])
    up, down = np.minimum(0.1 * np.arange(1, 9), 0.55), np.maximum(0.55 - 0.1 * np.arange(1, 14), -0.55)
    np.testing.assert_allclose(angles, [*up, *down], atol=1e-12)


def test_what_is_shown_is_the_frame_in_single_precision():
    """Padding is id -1 and zeros; odometry is cut at 50 m/s and 10 rad/s."""
    rng = np.random.default_rng(0)
    scene = scene_of(points_w=rng.uniform([-30, -5, 5], [30, 1.6, 60], size=(60, 3)))
    simulator = vehicle(scene, steered=True, odometry_sigmas=(100.0, 30.0), noise="pixels", sigma=1.0)
    frame, shown = drive(simulator, [[0.5, 0.2]] * 5)[-1], simulator.show()
    count = len(frame.observation)
    assert 0 < count < 60
    for values, expected in (
        *((shown.uvd, frame.observation.uvd), (shown.v_right, frame.observation.v_right)),
        *((shown.ids, frame.observation.ids), (shown.mask, np.ones(count))),
    ):
        padding = -1 if values is shown.ids else 0
        np.testing.assert_allclose(values[0, :count], expected, rtol=1e-6)
        assert (values[0, count:] == padding).all()
        assert values.shape[1] == 90
    limits = np.repeat([50.0, 10.0], 3)
    measured = np.concatenate([frame.odometry.linear, frame.odometry.angular])
    np.testing.assert_allclose(shown.odometry[0], np.clip(measured, -limits, limits), rtol=1e-6)
    assert (np.abs(measured) > limits).any()
    np.testing.assert_array_equal(shown.position[0], frame.truth.position)
    np.testing.assert_array_equal(shown.orientation[0], frame.truth.orientation)
    np.testing.assert_array_equal(shown.linear_velocity[0], frame.truth_velocity.linear)
    np.testing.assert_array_equal(shown.angular_velocity[0], frame.truth_velocity.angular)
    np.testing.assert_allclose(shown.car[0], simulator.fleet.car[0, :2], rtol=1e-6)
    assert shown.car[0, 0] == pytest.approx(4.9 + 5 * 0.15)
    assert shown.time[0] == frame.timestamp == pytest.approx(0.5)
    route = straight()
    assert shown.progress[0, 0] == pytest.approx(simulator.fleet.farthest[0] / route.arc_length[-1])
    assert shown.progress[0, 0] > 0.0
    k = route.nearest(frame.truth.position, 0)
    points = route.points_at(route.arc_length[k] + np.array([2.0, 5.0, 10.0, 20.0, 30.0]))
    expected = (points - frame.truth.position) @ frame.truth.R_wc
    np.testing.assert_allclose(shown.route[0], expected[:, [0, 2]], rtol=1e-5, atol=1e-5)


def test_the_start_is_told_with_an_error_of_its_covariance():
    """1e-6 m and rad of the pose, 0.5 m/s and 0.05 rad/s of the velocity; over 200 episodes."""
    starts = [vehicle(seed=seed).start(0) for seed in range(200)]
    sigmas = np.repeat([1e-6, 1e-6, 0.5, 0.05], 3)
    np.testing.assert_allclose(starts[0].covariance, np.diag(sigmas**2))
    errors = [np.append(start.linear_velocity - [0.0, 0.0, 4.9], start.angular_velocity) for start in starts]
    np.testing.assert_allclose(np.std(errors, axis=0), sigmas[6:], rtol=0.2)
    np.testing.assert_allclose(np.mean(errors, axis=0), 0.0, atol=0.25 * sigmas[6:].max())
