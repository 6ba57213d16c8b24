"""Solids of a URDF file and of OBJ files: the same rays and contacts by both kinds of physics (5 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env as sse
from filters.geometry import rotations
from stereo_slam_env.simulator import obstacles, touching, visible
from stereo_slam_env.world import surroundings
from stereo_slam_env.world.meshes import obj_mesh, urdf_solids
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.scene import Box, Cylinder, Ground, Material, Scene, Sphere, TriangleMesh
from stereo_slam_env.world.vehicle import Car

GREY = Material((0.5, 0.5, 0.5), "brick", (2.0, 2.0))
HALF = tuple(0.5 * side for side in Car().size)
OBJ = """# a pyramid with a square base
v 0 0 0
v 2 0 0
v 2 2 0
v 0 2 0
v 1 1 3
f 4 3 2 1
f 1/1 2/1 5/1
f 2 3 -1
f 3 4 5
f 4 1 5
"""
URDF = """<robot name="thing">
<link name="base"><collision><origin xyz="0 0 1" rpy="0 0 0.3"/><geometry><box size="1 2 2"/></geometry></collision>
<collision><origin xyz="3 0 1.5" rpy="0.5 0.2 0"/><geometry><box size="1 1 2"/></geometry></collision></link>
<link name="arm"><collision><origin xyz="0 0 1" rpy="0.4 0 0"/><geometry><cylinder radius="0.3" length="2"/></geometry>
</collision><collision><geometry><mesh filename="{mesh}" scale="1 1 0.5"/></geometry></collision></link>
<link name="top"><collision><geometry><sphere radius="0.6"/></geometry></collision></link>
<joint name="a" type="fixed"><parent link="base"/><child link="arm"/><origin xyz="0 3 0" rpy="0 0 1"/></joint>
<joint name="b" type="revolute"><parent link="arm"/><child link="top"/><origin xyz="0 0 4"/></joint>
</robot>"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "pyramid.obj").write_text(OBJ)
    (tmp_path / "thing.urdf").write_text(URDF.format(mesh="pyramid.obj"))
    return tmp_path


def scene_of(solids, points=None):
    points = np.zeros((0, 3)) if points is None else points
    return Scene(Ground((-50, -50), (50, 50), GREY), tuple(solids), (), points)


def test_the_shapes_of_a_urdf_are_where_its_joints_put_them(folder):
    base, slanted, pole, pyramid, ball = urdf_solids(folder / "thing.urdf", GREY, (10.0, 1.0, 0.0), 0.5)
    assert isinstance(base, Box)
    assert base.yaw == pytest.approx(0.8)
    assert isinstance(slanted, TriangleMesh)
    assert slanted.triangles.shape == (12, 3)
    assert isinstance(pole, Cylinder)
    assert np.linalg.norm(np.subtract(pole.end, pole.start)) == pytest.approx(2.0)
    assert isinstance(pyramid, TriangleMesh)
    assert pyramid.vertices[:, 2].max() == pytest.approx(1.5)
    assert isinstance(ball, Sphere)
    joint = np.array([10.0, 1.0, 0.0]) + rotations.exp([0, 0, 0.5]) @ [0.0, 3.0, 0.0]
    np.testing.assert_allclose(ball.center, [*joint[:2], 4.0], atol=1e-12)


@pytest.mark.parametrize("mesh", [False, True])
def test_triangles_point_outwards(folder, mesh):
    made = obj_mesh(folder / "pyramid.obj", GREY) if mesh else urdf_solids(folder / "thing.urdf", GREY)[1]
    corners = made.vertices[made.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = corners.mean(axis=1) - made.vertices.mean(axis=0)
    assert (np.einsum("ti,ti->t", normals, away) > 0).all()


def test_rays_and_contacts_are_those_of_pybullet(folder):
    solids = [*urdf_solids(folder / "thing.urdf", GREY), obj_mesh(folder / "pyramid.obj", GREY, (-4, -3, 0), 0.7, 1.5)]
    world, shapes, rng = PhysicsWorld(), obstacles(solids), np.random.default_rng(0)
    world.build(scene_of(solids), Car().size)
    different = number = hidden = 0
    for camera in rng.uniform((-10, -10, 0.5), (10, 10, 3), (40, 3)):
        points = rng.uniform((-10, -10, 0.2), (10, 10, 6), (500, 3))
        found = visible(shapes, camera[None], points)
        different += int((found != world.visible(camera[None], points)).sum())
        number, hidden = number + len(points), hidden + int((~found).sum())
    assert 0.02 < hidden / number < 0.9
    assert different <= 1e-3 * number
    at = rng.uniform((-7, -7, 0.6), (7, 7, 2), (1500, 3))
    turns = rotations.exp(rng.normal(size=(1500, 3)) * (0.1, 0.1, 3.0))
    expected = [world.ego_collides(*pose) for pose in zip(at, turns, strict=True)]
    world.close()
    found = touching(shapes, HALF, at, turns)
    assert 100 < sum(expected) < 1400
    assert (found != expected).sum() <= 2


@pytest.mark.parametrize("physics", ["exact", "bullet"])
def test_a_scene_of_own_bodies_is_driven_through_and_drawn(folder, physics, monkeypatch):
    monkeypatch.setattr(surroundings, "_SURROUNDINGS", dict(surroundings._SURROUNDINGS))
    monkeypatch.setattr(surroundings, "SURROUNDINGS", surroundings._SURROUNDINGS)

    def built(route, rng):
        solids = [*urdf_solids(folder / "thing.urdf", GREY, (12.0, 4.0, 0.0))]
        solids.append(obj_mesh(folder / "pyramid.obj", GREY, (25.0, -1.0, 0.0)))
        return scene_of(solids, np.column_stack([np.full(60, 11.4), rng.uniform(2, 8, 60), rng.uniform(0.5, 3, 60)]))

    sse.register_scene("own-bodies", built, description="test")
    arguments = {"surroundings": "own-bodies", "route": "straight", "rig": "qvga", "physics": physics}
    with gym.make("StereoSlam/Drive-v0", render_mode="rgb_array", **arguments) as env:
        observation, _ = env.reset(seed=0)
        assert observation["mask"].sum() > 5
        assert env.render().std() > 10
        collision = False
        for _ in range(60):
            *_, terminated, _, info = env.step(np.array([0.5, 0.0], dtype=np.float32))
            if terminated:
                collision = bool(info["collision"])
                break
    assert collision  # into the pyramid on the lane


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.urdf", "<robot", "is no URDF"),
        ("a.urdf", URDF.format(mesh="pyramid.stl"), "must be an OBJ file: convert it"),
        ("a.urdf", URDF.format(mesh="away.obj"), "away.obj"),
        ("a.urdf", URDF.replace("sphere", "capsule").format(mesh="pyramid.obj"), "has a capsule: shapes must be box"),
        ("a.urdf", URDF.replace('size="1 2 2"', 'size="1 2"').format(mesh="pyramid.obj"), "is no URDF: it lacks"),
        ("a.urdf", URDF.replace('parent link="base"', 'parent link="top"').format(mesh="pyramid.obj"), "lacks"),
        ("a.obj", "v 0 0 0\nf 1 2 3\n", "is no OBJ file with vertices and faces"),
        ("a.obj", "nothing", "is no OBJ file"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(folder, name, text, message):
    (folder / name).write_text(text)
    read = urdf_solids if name.endswith("urdf") else obj_mesh
    with pytest.raises(ValueError, match=message) as error:
        read(folder / name, GREY)
    assert "\n" not in str(error.value)
