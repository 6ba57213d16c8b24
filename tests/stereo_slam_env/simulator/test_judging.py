"""What a step earns and when an episode is over, term by term, from the true poses (2 s)."""

import numpy as np
import pytest

from stereo_slam_env.sensing.corruptions import IndependentPixels
from stereo_slam_env.simulator import Simulator
from stereo_slam_env.simulator.scene_arrays import scene_arrays
from stereo_slam_env.world.routes import Route, right_turn, straight
from stereo_slam_env.world.scene import Box
from stereo_slam_env.world.vehicle import Head

from .vehicles import GREY, ONE, drive, scene_of, vehicle

HEAD = Head(0.571, max_angles=(2.0, 0.4), max_rates=(1.5, 1.0))
SWERVING = [[0.4, 0.5]] * 6 + [[0.3, -0.6]] * 9 + [[-0.5, 0.1]] * 5
LANE = 2.0


def rewards(simulator, commands):
    """Reward of each step, and the pose and number of landmarks after it."""
    told = []
    for command in commands:
        frame = drive(simulator, [command])[-1]
        told.append((float(simulator.sensed.reward[0]), frame.truth.position, len(frame.observation)))
    earned, places, counts = zip(*told, strict=True)
    return np.array(earned), np.array(places), np.array(counts)


def progress_of(route, places):
    """Metres of the route that each place is farther than all before, and distances beside it."""
    nearest = [int(np.linalg.norm((route.positions - place)[:, [0, 2]], axis=1).argmin()) for place in places]
    farthest = np.maximum.accumulate([0.0, *route.arc_length[nearest]])
    beside = [
        abs((place - route.positions[k]) @ route.attitudes[k][:, 0]) for k, place in zip(nearest, places, strict=True)
    ]
    return np.diff(farthest), np.array(beside)


@pytest.mark.parametrize("route", [straight(), right_turn()], ids=lambda route: route.name)
def test_progress_is_paid_less_beside_the_route_and_tracking_by_the_share_of_landmarks(route):
    points = np.random.default_rng(0).uniform([-30, -5, -20], [30, 1.6, 170], size=(600, 3))
    arguments = {"steered": True, "lane": LANE, "policy": {"max_landmarks": 80, "refill_below": 60}}
    for weights, of_number in (({"progress": 2.0}, False), ({"tracking": 3.0}, True)):
        simulator = vehicle(scene_of(points_w=points), route, weights=weights, **arguments)
        earned, places, counts = rewards(simulator, SWERVING)
        advanced, beside = progress_of(route, places)
        paid = advanced * np.maximum(1.0 - (beside / LANE) ** 2, 0.0)
        expected = 3.0 * paid * counts / 80.0 if of_number else 2.0 * paid
        np.testing.assert_allclose(earned, expected, atol=1e-9)
        assert beside.max() > 0.2
        assert simulator.sensed.beside[0] == pytest.approx(beside[-1], abs=1e-9)
        np.testing.assert_allclose(simulator.fleet.farthest[0], advanced.sum())


def test_the_way_back_is_not_paid_twice():
    """Round in a circle: what was passed already earns nothing."""
    simulator = vehicle(weights={"progress": 1.0}, steered=True, lane=100.0)
    earned, places, _ = rewards(simulator, [[0.0, 1.0]] * 80)
    assert abs(earned.sum() - places[:, 2].max()) < 0.25  # frames are 0.49 m apart
    assert (earned[30:] == 0.0).any()
    assert (earned >= 0.0).all()


def test_a_car_beside_its_lane_has_failed_and_one_at_its_edge_has_not():
    simulator = vehicle(weights={"collision": 5.0}, steered=True, lane=LANE)
    for _ in range(60):
        drive(simulator, [[0.0, 0.3]])
        beside = abs(simulator.pose(0).position[0])
        failed = bool(simulator.sensed.failed[0])
        assert failed == (beside > LANE)
        assert simulator.sensed.reward[0] == (-5.0 if failed else 0.0)
        assert not simulator.sensed.collision[0]
    assert failed


def test_a_scripted_drive_has_no_lane_and_ends_with_its_route():
    route = Route("short", np.full(9, 4.0), np.zeros(9))
    simulator = vehicle(route=route, weights={"goal": 7.0, "progress": 1.0})
    earned, *_ = rewards(simulator, [[0, 0]] * 9)
    np.testing.assert_allclose(earned, [0.4] * 8 + [7.4])
    assert simulator.sensed.success[0]
    assert simulator.sensed.beside[0] == 0.0


def test_time_costs_its_seconds_and_the_first_frame_nothing():
    simulator = vehicle(weights={"time": 2.0})
    assert simulator.sensed.reward[0] == 0.0
    earned, *_ = rewards(simulator, [[0, 0]] * 3)
    np.testing.assert_allclose(earned, -0.2)
    simulator.begin(ONE)
    assert simulator.sensed.reward[0] == 0.0
    assert not simulator.sensed.terms.any()


@pytest.mark.parametrize(
    ("command", "shares"), [([1, 0], (1, 0)), ([0, -1], (0, 1)), ([1, 1], (1, 1)), ([0, 0], (0, 0))]
)
def test_turning_the_head_costs_the_square_of_its_share_of_the_largest_rate(command, shares):
    simulator = vehicle(head=HEAD, weights={"effort": 4.0})
    earned, *_ = rewards(simulator, [command])
    assert earned[0] == pytest.approx(-2.0 * (shares[0] + shares[1]))


def test_a_head_that_has_arrived_costs_nothing():
    simulator = vehicle(head=HEAD, weights={"effort": 1.0})
    earned, *_ = rewards(simulator, [[0.05, 0.0]] * 2)
    assert earned.tolist() == pytest.approx([-0.5 * (0.1 / 0.15) ** 2, 0.0])


@pytest.mark.parametrize("beyond", [-0.01, 0.01])
@pytest.mark.parametrize("side", ["ahead", "behind", "left", "right", "above"])
def test_the_body_of_the_car_is_touched_at_its_faces(side, beyond):
    """4.2 m x 1.8 m x 1.1 m, its middle 0.25 m behind and 0.8 m below the camera at 1.65 m."""
    faces = {"ahead": (1.85, 0), "behind": (-2.35, 0), "left": (0.9, 1), "right": (-0.9, 1), "above": (1.4, 2)}
    (face, axis), half = faces[side], np.array([0.3, 0.3, 0.2])
    at = np.array([-0.25, 0.0, 0.85])
    at[axis] = face + np.sign(face if axis < 2 else 1.0) * (half[axis] - beyond)
    at[0] += 0.49  # after a step
    simulator = vehicle(scene_of(Box(tuple(at), tuple(2 * half), 0.0, GREY)), steered=True)
    drive(simulator, [[0, 0]])
    assert simulator.sensed.collision[0] == (beyond > 0.0)


def test_who_leaves_the_arena_has_failed():
    """60 m from the route, without a lane."""
    simulator = vehicle(steered=True, weights={"collision": 1.0})
    away = []
    for _ in range(140):
        drive(simulator, [[1.0, 0.25]] if len(away) < 12 else [[1.0, 0.0]])
        position = simulator.pose(0).position
        away.append(np.linalg.norm(straight().positions - position, axis=1).min())
        assert simulator.sensed.failed[0] == (away[-1] > 60.0)
    assert away[-1] > 60.0


def test_a_row_has_room_for_a_larger_scene_and_forgets_the_one_before():
    points = np.random.default_rng(0).uniform([-30, -5, -20], [30, 1.6, 170], size=(700, 3))
    walls = [Box((15.0 + 2.0 * k, 3.0, 1.0), (1.0, 1.0, 2.0), 0.0, GREY) for k in range(20)]
    large, small = scene_of(*walls, points_w=points), scene_of(*walls[:1], points_w=points[:40])
    alone = {name: drive(vehicle(scene, route), [[0, 0]] * 5) for name, scene, route in
             (("large", large, right_turn()), ("small", small, straight()))}  # fmt: skip
    simulator = vehicle(small, straight())
    for name, scene, route in (
        ("large", large, right_turn()),
        ("small", small, straight()),
        ("large", large, right_turn()),
    ):
        simulator.put(0, scene_arrays(scene, route), np.random.default_rng(1).spawn(4))
        simulator.begin(ONE)
        for one, expected in zip(drive(simulator, [[0, 0]] * 5), alone[name], strict=True):
            np.testing.assert_array_equal(one.observation.ids, expected.observation.ids)
            np.testing.assert_array_equal(one.observation.uvd, expected.observation.uvd)
            np.testing.assert_array_equal(one.truth.position, expected.truth.position)


def test_a_state_is_a_copy_that_can_be_gone_back_to_again_and_again():
    points = np.random.default_rng(0).uniform([-30, -5, -20], [30, 1.6, 170], size=(300, 3))
    simulator = vehicle(scene_of(points_w=points), noise="heavy-tailed", sigma=1.0, odometry_sigmas=(0.1, 0.01))
    drive(simulator, [[0, 0]] * 20)
    state, before = simulator.snapshot(), simulator.frame(0)
    first, *rest = [drive(simulator, [[0, 0]] * 30)[1:] for _ in range(3) if simulator.restore(state) is None]
    for again in rest:
        for one, other in zip(first, again, strict=True):
            np.testing.assert_array_equal(one.observation.uvd, other.observation.uvd)
            np.testing.assert_array_equal(one.odometry.linear, other.odometry.linear)
    simulator.restore(state)
    np.testing.assert_array_equal(simulator.frame(0).observation.uvd, before.observation.uvd)
    assert simulator.frame(0).timestamp == before.timestamp == pytest.approx(2.0)


def test_rows_wait_while_others_go_on_and_have_the_bits_of_one_alone():
    """Whatever the number of rows and of threads."""
    points = np.random.default_rng(0).uniform([-30, -5, -20], [30, 1.6, 170], size=(300, 3))
    scene = scene_arrays(scene_of(points_w=points), straight())
    alone = drive(vehicle(scene_of(points_w=points), noise="pixels", sigma=1.0, seed=2, perturbation=1.0), [[0, 0]] * 6)
    one = vehicle(scene_of(points_w=points), noise="pixels", sigma=1.0, perturbation=1.0)
    for threads in (1, 2, 3):
        many = Simulator(one.rules, 3, IndependentPixels(1.0), threads)
        for b in range(3):
            many.put(b, scene, np.random.default_rng(b + 1).spawn(4))
        many.begin(np.ones(3, dtype=bool))
        for k in range(6):
            waiting = [many.frame(0), many.frame(2)]
            many.step(np.zeros((3, 4)), np.array([False, True, k % 2 == 0]))
            for b, before in zip((0, 2), waiting, strict=True):
                if b == 0 or k % 2:
                    assert many.frame(b).timestamp == before.timestamp
                    np.testing.assert_array_equal(many.frame(b).observation.uvd, before.observation.uvd)
            np.testing.assert_array_equal(many.frame(1).observation.uvd, alone[k + 1].observation.uvd)
            np.testing.assert_array_equal(many.frame(1).truth.position, alone[k + 1].truth.position)
        many.close()
