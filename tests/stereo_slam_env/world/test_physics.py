"""Rays, collisions and life cycle of the physics engine."""

import os
import resource
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stereo_slam_env.rendering import pinhole
from stereo_slam_env.sensing.rigs import RIGS
from stereo_slam_env.world import physics
from stereo_slam_env.world.frames import R_SW
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.scene import Box, Cylinder, Ground, Material, MovingBody, Scene, Sphere

GREY = Material((0.5, 0.5, 0.5))
EGO = (4.0, 1.8, 1.0)


def scene_of(*solids):
    ground = Ground((-50.3, -50.3), (50.3, 50.3), GREY)
    return Scene(ground, solids, (), np.zeros((0, 3)))


WALL = Box((10.0, 0.0, 2.0), (0.2, 4.0, 4.0), 0.0, GREY)
SLANTED_POLE = Cylinder((10.0, 6.0, 0.0), (12.0, 8.0, 5.0), 0.3, GREY)
BALL = Sphere((10.0, -6.0, 2.0), 1.0, GREY)


@pytest.fixture
def world():
    world = PhysicsWorld()
    yield world
    world.close()


def test_a_wall_hides_what_is_behind_it_and_not_itself(world):
    world.build(scene_of(WALL), EGO)
    eye = np.array([[0.0, 0.0, 1.6]])
    points = np.array([[20.0, 0.0, 1.6], [20.0, 12.0, 1.6], [9.9, 0.0, 1.6], [5.0, 0.0, 1.0], [20.0, 0.0, 9.0]])
    assert world.visible(eye, points).tolist() == [False, True, True, True, True]
    world.ego_collides(np.array([5.0, 0.0, 1.6]), np.eye(3))  # nor does the car hide anything
    assert world.visible(eye, points).tolist() == [False, True, True, True, True]
    assert world.visible(np.zeros((2, 3)), np.zeros((0, 3))).shape == (0,)


@pytest.mark.parametrize(
    ("surface", "behind"),
    [([10.6667, 6.6667 - 0.25, 2.0], [22.0, 14.0, 2.6]), ([9.0, -6.0, 2.0], [20.0, -12.0, 2.4])],
    ids=["pole", "ball"],
)
def test_round_solids_are_where_they_should_be(world, surface, behind):
    world.build(scene_of(SLANTED_POLE, BALL), EGO)
    eye = np.array([[0.0, 0.0, 1.6]])
    assert world.visible(eye, np.array([surface, behind])).tolist() == [True, False]


def test_a_point_must_be_seen_by_both_eyes(world):
    world.build(scene_of(Box((5.0, 0.0, 2.0), (0.1, 0.4, 4.0), 0.0, GREY)), EGO)
    point = np.array([[10.0, 0.0, 2.0]])
    straight, aside = np.array([[0.0, 0.0, 2.0]]), np.array([[0.0, 1.0, 2.0]])
    assert not world.visible(straight, point)[0]
    assert world.visible(aside, point)[0]
    assert not world.visible(np.concatenate([straight, aside]), point)[0]


def test_the_car_collides_with_solids_but_not_with_the_road(world):
    world.build(scene_of(WALL), EGO)
    level = np.eye(3)
    assert not world.ego_collides(np.array([0.0, 0.0, 0.6]), level)
    assert not world.ego_collides(np.array([7.8, 0.0, 0.6]), level)
    assert world.ego_collides(np.array([8.1, 0.0, 0.6]), level)
    assert not world.ego_collides(np.array([8.1, 3.2, 0.6]), level)
    assert not world.ego_collides(np.array([0.0, 0.0, 0.6]), level)


def test_a_car_low_on_its_springs_touches_the_road_and_collides_with_solids_only(world):
    world.build(scene_of(WALL), EGO)
    low = 0.5 * EGO[2] - 0.1
    assert not world.ego_collides(np.array([0.0, 0.0, low]), np.eye(3))
    assert world.ego_collides(np.array([8.1, 0.0, low]), np.eye(3))


def test_close_unused_and_twice_and_build_again():
    world = PhysicsWorld()
    world.close()
    world.build(scene_of(WALL), EGO)
    world.close()
    world.close()
    with pytest.raises(RuntimeError, match="not built"):
        world.visible(np.zeros((1, 3)), np.ones((1, 3)))
    world.build(scene_of(), EGO)
    assert world.visible(np.zeros((1, 3)) + 1.0, np.array([[20.0, 0.0, 1.6]]))[0]
    world.close()


def test_pictures_need_a_drawn_world(world):
    world.build(scene_of(WALL), EGO)
    with pytest.raises(RuntimeError, match="call dress"):
        world.camera_image(np.eye(4), np.eye(4), 8, 8, (0, 0, 1))


# --- what moves -------------------------------------------------------------------------------------------------------

RED = Material((1.0, 0.0, 0.0))
CAR = MovingBody(
    "car",
    (Box((0.0, 0.0, 0.8), (4.0, 2.0, 1.6), 0.0, RED), Box((0.0, 0.0, 1.65), (1.0, 1.0, 0.1), 0.0, RED, solid=False)),
    np.array([0.0, 10.0]),
    np.array([[12.0, 0.0, 0.0], [112.0, 0.0, 0.0]]),
    np.array([0.0, 0.0]),
)
"""Drives ahead from 12 m with 10 m/s."""


def with_car(*solids):
    return replace(scene_of(*solids), moving=(CAR,))


def test_rays_meet_a_moving_car_where_it_is_at_that_time(world):
    world.build(with_car(), EGO)
    eye, points = np.array([[0.0, 0.0, 1.0]]), np.array([[9.9, 0.0, 1.0], [30.0, 0.0, 1.1], [60.0, 0.0, 1.1]])
    assert world.visible(eye, points).tolist() == [True, False, False]
    for time, seen in ((1.5, [True, False, False]), (3.5, [True, True, False]), (6.0, [True, True, True])):
        world.set_time(time)
        assert world.visible(eye, points).tolist() == seen
    world.set_time(0.0)
    assert world.visible(eye, points).tolist() == [True, False, False]


def test_the_ego_car_collides_with_a_moving_car_where_it_is(world):
    world.build(with_car(WALL), EGO)
    level = np.eye(3)
    for time in (1.0, 4.0, 2.0):
        world.set_time(time)
        middle = 12.0 + 10.0 * time
        assert world.ego_collides(np.array([middle - 3.9, 0.0, 0.8]), level)
        assert not world.ego_collides(np.array([middle - 4.2, 0.0, 0.8]), level)


def red_depth(world):
    """Median depth z of what is red straight ahead, m, and how many pixels it covers."""
    camera = RIGS["qvga"]
    projection = pinhole.projection_matrix(camera, 0.5, 300.0, pinhole.TINY_OFFSET)
    view = pinhole.view_matrix(np.array([0.0, 0.0, 1.65]), R_SW)
    rgb, buffer = world.camera_image(view, projection, camera.width, camera.height, (0.3, 0.4, 0.9))
    red = (rgb[..., 0] > 60) & (rgb[..., 1] < 20)
    return float(np.median(pinhole.metric_depth(buffer, 0.5, 300.0)[red])), int(red.sum())


def test_a_moving_car_is_drawn_where_it_is(world):
    scene = with_car()
    world.build(scene, EGO)
    world.set_time(1.0)
    world.dress(scene)
    sizes = []
    for time in (1.0, 3.0):
        world.set_time(time)
        depth, size = red_depth(world)
        sizes.append(size)
        assert depth == pytest.approx(12.0 + 10.0 * time - 2.0, abs=0.01)
    assert sizes[0] > 3 * sizes[1]


def test_textures_tint_and_variants_are_drawn(world):
    def picture(material):
        scene = scene_of(Box((10.0, 0.0, 2.0), (0.2, 14.0, 4.0), 0.0, material))
        world.build(scene, EGO)
        world.dress(scene)
        view = pinhole.view_matrix(np.array([0.0, 0.0, 1.65]), R_SW)
        projection = pinhole.projection_matrix(RIGS["qvga"], 0.5, 300.0, pinhole.TINY_OFFSET)
        return world.camera_image(view, projection, 320, 240, (-0.5, 0.0, 0.9))[0][90:140].astype(float)

    plain, red, other = (
        picture(Material(color, "brick", (4.0, 4.0), variant))
        for color, variant in (((1.0, 1.0, 1.0), 0), ((1.0, 0.3, 0.3), 0), ((1.0, 1.0, 1.0), 1))
    )
    assert plain.std() > 20
    np.testing.assert_allclose(red[..., 0], plain[..., 0], atol=1)
    np.testing.assert_allclose(red[..., 1], 0.3 * plain[..., 1], atol=2)
    assert np.abs(other - plain).mean() > 3


@pytest.mark.parametrize("form", [np.ndarray.tolist, lambda flat: tuple(flat.tolist()), np.array])
def test_pictures_are_the_same_arrays_from_a_pybullet_with_and_without_numpy(world, monkeypatch, form):
    """Without NumPy, PyBullet gives flat tuples."""
    scene = with_car(WALL)
    world.build(scene, EGO)
    world.dress(scene)
    draw = physics.pybullet.getCameraImage
    view = pinhole.view_matrix(np.array([0.0, 0.0, 1.65]), R_SW)
    projection = pinhole.projection_matrix(RIGS["qvga"], 0.5, 300.0, pinhole.TINY_OFFSET)
    rgb, depth = world.camera_image(view, projection, 320, 240, (-0.5, 0.0, 0.9))

    def other_form(*arguments, **options):
        width, height, rgba, buffer, segmentation = draw(*arguments, **options)
        pixels, depths = np.ravel(np.asarray(rgba, np.uint8)), np.ravel(np.asarray(buffer, np.float32))
        return width, height, form(pixels), form(depths), segmentation

    monkeypatch.setattr(physics.pybullet, "getCameraImage", other_form)
    again = world.camera_image(view, projection, 320, 240, (-0.5, 0.0, 0.9))
    for array, other in zip((rgb, depth), again, strict=True):
        assert (other.shape[:2], other.dtype) == ((240, 320), array.dtype)
        np.testing.assert_array_equal(other, array)
    assert rgb.std() > 10


def test_memory_is_flat_over_dressed_worlds():
    """Each cycle writes and reads meshes of everything; a leak of them would be 0.5 MB a cycle."""
    textured = replace(WALL, material=Material((1.0, 1.0, 1.0), "office", (4.0, 4.0)))
    many = tuple(replace(BALL, center=(10.0 + k, 5.0, 2.0)) for k in range(40))
    scene = with_car(textured, *many)
    one = PhysicsWorld()

    def cycle(world):
        world.build(scene, EGO)
        world.dress(scene)
        world.set_time(1.0)

    for _ in range(20):
        cycle(one)
    before = resident()
    for _ in range(100):
        cycle(one)
    for _ in range(10):
        cycle(one)
        one.close()
    assert resident() - before < 4.0


ENDS_AT_ONCE = """
import os, sys, tempfile
import numpy as np
from stereo_slam_env.world.open_country import build_groves
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.routes import named_route

world, scene = PhysicsWorld(), build_groves(named_route("straight"), np.random.default_rng(0))
world.build(scene, (4.2, 1.8, 1.1))
if "dressed" in sys.argv:
    world.dress(scene)
assert tempfile.gettempdir() == os.environ["TMPDIR"]
os._exit(0)
"""


@pytest.mark.parametrize("how", ["bare", "dressed"])
def test_a_process_that_ends_without_exit_handlers_leaves_no_files(tmp_path, how):
    """As the workers of benchmarks and tests do."""
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", ENDS_AT_ONCE, how], env=environment, timeout=120, check=True)
    assert list(tmp_path.iterdir()) == []


def resident():
    """Memory of this process, MB."""
    statm = Path("/proc/self/statm")
    if not statm.exists():
        pytest.skip("needs /proc")
    return int(statm.read_text().split()[1]) * resource.getpagesize() / 2**20
