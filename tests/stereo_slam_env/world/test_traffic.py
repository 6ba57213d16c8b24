"""Moving cars and pedestrians: in view, on their ways, never in the way. About 8 s."""

import numpy as np
import pytest

from stereo_slam_env.world import props
from stereo_slam_env.world.meshes import body_meshes
from stereo_slam_env.world.road import LANE_OFFSET, road_along, stations_of
from stereo_slam_env.world.routes import FRAME_PERIOD, KITTI_PERIOD, ROUTES, kitti_route
from stereo_slam_env.world.scene import MovingBody
from stereo_slam_env.world.surroundings import SURROUNDINGS, build_scene

from .driving import collisions, nominal_poses, swaying_poses
from .pose_files import there_and_back, write_poses


def busy(surroundings, route, cars=15, pedestrians=10, seed=1):
    return build_scene(surroundings, route, np.random.default_rng(seed), moving_cars=cars, pedestrians=pedestrians)


@pytest.fixture(scope="module", params=["town", "loop", "there-and-back"])
def route(request, tmp_path_factory):
    if request.param in ROUTES:
        return ROUTES[request.param]()
    path = tmp_path_factory.mktemp("poses") / "poses.txt"
    return kitti_route(write_poses(path, *there_and_back(KITTI_PERIOD)))


@pytest.fixture(scope="module")
def street(route):
    return busy("street", route)


def in_view(body, route):
    """Frames in which the middle of a body is up to 80 m ahead, within 40 degrees of the direction of view."""
    seen = []
    for frame, (p_w, yaw) in enumerate(zip(route.positions, route.headings, strict=True)):
        position, _ = body.pose_at(frame * FRAME_PERIOD)
        ahead = position - [p_w[2], -p_w[0], 0.0]
        forward = np.array([np.cos(yaw), -np.sin(yaw)])
        distance = np.linalg.norm(ahead)
        seen.append(distance < 80.0 and ahead[:2] @ forward > np.cos(np.radians(40)) * distance)
    return np.array(seen)


def test_the_drive_hits_nobody(route, street):
    assert collisions(street, nominal_poses(route)) == []


@pytest.mark.parametrize("surroundings", SURROUNDINGS)
def test_the_drive_hits_nobody_in_any_surroundings(surroundings):
    route = ROUTES["right-turn"]()
    scene = busy(surroundings, route)
    assert len(scene.moving) >= 8
    assert collisions(scene, nominal_poses(route)) == []


def test_nor_does_a_drive_that_sways():
    route = ROUTES["town"]()
    assert collisions(busy("street", route, cars=30), swaying_poses(route, 0)) == []


def test_as_many_as_asked_for_come_into_view(route, street):
    kinds = [body.kind for body in street.moving]
    assert kinds.count("car") >= 12
    assert kinds.count("pedestrian") >= 8
    for body in street.moving:
        assert in_view(body, route).sum() * FRAME_PERIOD > 1.9
    everything = np.array([in_view(body, route) for body in street.moving])
    assert everything.any(axis=0).mean() > 0.9
    assert np.median(everything.sum(axis=1)) * FRAME_PERIOD > 5.0


def test_cars_keep_to_their_lanes(route, street):
    road = road_along(route)
    for car in (body for body in street.moving if body.kind == "car"):
        there = car.positions[:, 2] == 0.0
        away = np.linalg.norm(car.positions[there][::10, None, :2] - road.points, axis=2).min(axis=1)
        assert away.max() < LANE_OFFSET + 0.1
        driving = there[1:] & there[:-1]
        forward = np.stack([np.cos(car.yaws), np.sin(car.yaws)], axis=1)[:-1]
        ahead = (np.diff(car.positions[:, :2], axis=0) * forward).sum(axis=1)[driving]
        assert ahead.min() > -1e-3
        assert ahead.max() < 15.0 * FRAME_PERIOD
        assert np.abs(np.diff(car.yaws)).max() < 0.3


def test_some_cars_lead_and_some_come(route, street):
    road = road_along(route)
    start = stations_of(route, road)
    heading = road.yaws
    turns = []
    for car in (body for body in street.moving if body.kind == "car"):
        k = int(np.flatnonzero(car.positions[:, 2] == 0.0)[0])
        nearest = np.abs(road.stations - start[min(k, len(start) - 1)]) < 160.0
        index = np.flatnonzero(nearest)[np.linalg.norm(road.points[nearest] - car.positions[k, :2], axis=1).argmin()]
        turns.append(np.cos(car.yaws[k] - heading[index]))
    assert min(turns) < -0.9
    assert max(turns) > 0.9


def test_bodies_keep_clear_of_each_other(street):
    middles = np.array([body.positions for body in street.moving])
    middles[middles[:, :, 2] < 0] = np.nan
    cars = np.array([body.kind == "car" for body in street.moving])
    for i in range(len(middles)):
        others = np.delete(middles, i, axis=0)
        nearest = np.nanmin(np.linalg.norm(others - middles[i], axis=2), initial=np.inf)
        assert nearest > (1.6 if cars[i] else 0.7)


def test_pedestrians_walk_and_some_cross_the_road():
    route = ROUTES["town"]()
    people = [b for b in busy("street", route, cars=0, pedestrians=20).moving if b.kind == "pedestrian"]
    road = road_along(route)
    crossed = 0
    for person in people:
        steps = np.linalg.norm(np.diff(person.positions[person.positions[:, 2] == 0.0], axis=0)[:, :2], axis=1)
        assert steps.max() < 2.5 * FRAME_PERIOD
        assert steps.max() > 0.5 * FRAME_PERIOD
        away = np.linalg.norm(person.positions[::5, None, :2] - road.points, axis=2).min(axis=1)
        crossed += away.min() < 1.0
    assert 2 < crossed < 0.7 * len(people)


def test_asking_for_more_keeps_the_first_ones():
    route = ROUTES["right-turn"]()
    few, many = (busy("street", route, cars=n, pedestrians=0).moving for n in (2, 5))
    assert len(few) == 2
    for one, other in zip(few, many, strict=False):
        assert one.parts == other.parts
        np.testing.assert_array_equal(one.positions, other.positions)


def test_a_full_road_takes_no_more(caplog):
    with caplog.at_level("INFO"):
        crowd = busy("street", ROUTES["right-turn"](), cars=40, pedestrians=0).moving
    assert 5 < len(crowd) < 40
    assert "no room for another car" in caplog.text


@pytest.mark.parametrize("make", [props.vehicle, props.pedestrian])
def test_bodies_stand_on_the_ground_and_have_detail(make):
    for seed in range(8):
        parts = make(np.random.default_rng(seed))
        meshes = body_meshes(body_of(parts))
        vertices = np.concatenate([m.vertices for m in meshes.values()])
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        assert low[2] == pytest.approx(0.0, abs=0.05)
        assert (high - low)[:2].max() < 8.2
        assert 1.4 < high[2] < 3.4
        assert any(material.texture is not None for material in meshes)
        assert any(part.solid for part in parts)


def body_of(parts):
    return MovingBody("any", parts, np.zeros(1), np.zeros((1, 3)), np.zeros(1))
