"""Surroundings along any route: what is where, and that nothing stands in the way. About 15 s."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from filters.geometry import rotations
from stereo_slam_env.rendering import pinhole
from stereo_slam_env.sensing.rigs import RIGS
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.road import road_along
from stereo_slam_env.world.routes import KITTI_PERIOD, ROUTES, kitti_route
from stereo_slam_env.world.scene import Box
from stereo_slam_env.world.surroundings import SURROUNDINGS, build_scene

from .driving import collisions, nominal_poses
from .pose_files import figure_eight, there_and_back, write_poses
from .surfaces import sample_surface


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module", params=[*ROUTES, "figure-eight", "there-and-back"])
def route(request, tmp_path_factory):
    if request.param in ROUTES:
        return ROUTES[request.param]()
    poses = {"figure-eight": figure_eight, "there-and-back": there_and_back}[request.param](KITTI_PERIOD)
    return kitti_route(write_poses(tmp_path_factory.mktemp("poses") / "poses.txt", *poses))


@pytest.mark.parametrize("surroundings", SURROUNDINGS)
def test_the_nominal_drive_hits_nothing(surroundings, route):
    assert collisions(build_scene(surroundings, route, rng()), nominal_poses(route)) == []


@pytest.mark.parametrize("surroundings", SURROUNDINGS)
def test_landmarks_lie_on_what_stands_there(surroundings):
    route = ROUTES["right-turn"]()
    scene = build_scene(surroundings, route, rng())
    assert len(scene.landmark_points) > (50 if surroundings in ("groves", "copses") else 300)
    standing = scene.landmark_points[scene.landmark_points[:, 2] > 0.1]
    for point in standing[:: len(standing) // 25]:
        assert min(distance_to(shape, point) for shape in scene.primitives) < 1e-6


def distance_to(shape, point):
    """From a point to the surface of a shape, m; roughly for all but boxes, whose sides carry most landmarks."""
    if isinstance(shape, Box):
        cos, sin = np.cos(shape.yaw), np.sin(shape.yaw)
        local = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) @ (point - shape.center)
        return abs(float((np.abs(local) - 0.5 * np.array(shape.size)).max()))
    if hasattr(shape, "center"):
        return abs(float(np.linalg.norm(point - shape.center)) - shape.radius)
    axis = np.subtract(shape.end, shape.start)
    along = float(np.clip((point - shape.start) @ axis / (axis @ axis), 0.0, 1.0))
    return abs(float(np.linalg.norm(point - shape.start - along * axis)) - shape.radius)


@pytest.mark.parametrize("surroundings", SURROUNDINGS)
def test_the_same_seed_builds_the_same_scene(surroundings):
    route = ROUTES["right-turn"]()
    full = {"moving_cars": 4, "pedestrians": 4, "randomise": True}
    one, two = (build_scene(surroundings, route, rng(3), **full) for _ in range(2))
    assert one.primitives == two.primitives
    assert one.look == two.look
    assert [body.parts for body in one.moving] == [body.parts for body in two.moving]
    for left, right in zip(one.moving, two.moving, strict=True):
        np.testing.assert_array_equal(left.positions, right.positions)
    np.testing.assert_array_equal(one.landmark_points, two.landmark_points)
    assert build_scene(surroundings, route, rng(4)).primitives != build_scene(surroundings, route, rng(3)).primitives


@pytest.mark.parametrize("surroundings", SURROUNDINGS)
def test_traffic_and_another_look_leave_the_layout_as_it_is(surroundings):
    route = ROUTES["right-turn"]()
    plain = build_scene(surroundings, route, rng())
    full = build_scene(surroundings, route, rng(), moving_cars=5, pedestrians=5, randomise=True)
    np.testing.assert_array_equal(plain.landmark_points, full.landmark_points)
    bare = [replace(p, material=None) for p in plain.primitives]
    assert bare == [replace(p, material=None) for p in full.primitives]
    assert {p.material for p in plain.primitives} != {p.material for p in full.primitives}
    assert len(full.moving) > len(plain.moving) == 0


def test_in_the_field_nothing_solid_is_near(route):
    scene = build_scene("field", route, rng())
    lane = route.positions[:, [2, 0]] * [1.0, -1.0]
    surface = np.concatenate([sample_surface(p, 60, rng())[0] for p in scene.solids])
    above = surface[surface[:, 2] >= 0, :2]
    assert cKDTree(lane).query(above)[0].min() > 60
    assert cKDTree(road_along(route).points).query(above)[0].max() < 320
    assert len(scene.primitives) > 500


def test_coinciding_roads_are_paved_once(route):
    """Equal heights in one place would flicker: pieces of the same strip differ in height or keep clear."""
    scene = build_scene("street", route, rng())
    heights = {}
    for ribbon in scene.ribbons:
        heights.setdefault(ribbon.material, []).append(float(ribbon.left[0, 2]))
    for levels in heights.values():
        assert min(levels) > 0.0
        assert len(set(np.round(levels, 5))) == len(levels)
    asphalt, paving = (np.array(levels) for levels in heights.values())
    assert asphalt.min() > paving.max()


def corners(scene, route, frames):
    """Corners above a fixed contrast in pictures from the route."""
    world, camera = PhysicsWorld(), RIGS["qvga"]
    projection = pinhole.projection_matrix(camera, 0.5, 300.0, pinhole.TINY_OFFSET)
    try:
        world.build(scene, (4.0, 1.8, 1.0))
        world.dress(scene)
        count = 0
        for pose in (nominal_poses(route)[k] for k in frames):
            frame = WorldFrame(1.65)
            R_sc = frame.rotation_to_scene(rotations.matrix(pose.orientation))
            view = pinhole.view_matrix(frame.to_scene(pose.position), R_sc)
            rgb, depth = world.camera_image(view, projection, camera.width, camera.height, scene.look.sun)
            strength = cv2.cornerMinEigenVal(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), 3)
            peak = (strength == cv2.dilate(strength, np.ones((5, 5)))) & (strength > 2e-3)
            count += int((peak & (depth < 0.99999)).sum())
        return count / len(frames)
    finally:
        world.close()


def test_the_corridor_shows_few_corners_and_the_street_many():
    route, frames = ROUTES["right-turn"](), (0, 30, 60)
    street, corridor = (corners(build_scene(name, route, rng()), route, frames) for name in ("street", "corridor"))
    assert street > 300
    assert 5 < corridor < 0.15 * street


def test_nothing_in_the_corridor_is_seen_beyond_the_next_bend():
    route = ROUTES["town"]()
    scene, road = build_scene("corridor", route, rng()), road_along(route)
    world = PhysicsWorld()
    try:
        world.build(scene, (4.0, 1.8, 1.0))
        eye = np.array([[*road.points[80], 1.65]])
        beyond = scene.landmark_points[np.linalg.norm(scene.landmark_points[:, :2] - eye[0, :2], axis=1) > 170.0]
        assert len(beyond) > 100
        assert not world.visible(eye, beyond).any()
    finally:
        world.close()


def test_wrong_arguments_get_one_clear_line():
    route = ROUTES["right-turn"]()
    with pytest.raises(ValueError, match=r"surroundings must be one of 'street'.*got 'feild', did you mean 'field'\?"):
        build_scene("feild", route, rng())
    with pytest.raises(ValueError, match="moving_cars must not be negative, got -1"):
        build_scene("field", route, rng(), moving_cars=-1)
