"""The procedural street: what is in it, where the landmarks are, the same for the same seed. About 2 s."""

import numpy as np
import pytest

from stereo_slam_env.world.meshes import mesh, scene_meshes
from stereo_slam_env.world.routes import ROUTES
from stereo_slam_env.world.scene import Box, Cylinder, Material, Sphere
from stereo_slam_env.world.street import build_street
from stereo_slam_env.world.street_textures import TEXTURES, texture

from .surfaces import sample_surface

PLAIN = Material((1.0, 1.0, 1.0))
SHAPES = [
    Box((1.0, 2.0, 3.0), (4.0, 2.0, 1.0), 0.4, PLAIN),
    Cylinder((1.0, 1.0, 0.0), (1.0, 1.0, 5.0), 0.3, PLAIN),
    Cylinder((1.0, 1.0, 2.0), (2.0, 3.0, 2.5), 0.3, PLAIN),
    Sphere((0.0, 1.0, 2.0), 1.5, PLAIN),
]


@pytest.fixture(scope="module", params=sorted(ROUTES))
def route_and_scene(request):
    route = ROUTES[request.param]()
    return route, build_street(route, np.random.default_rng(7))


def test_the_lane_is_free_of_solids(route_and_scene):
    route, scene = route_and_scene
    lane = route.positions[:, [2, 0]] * [1.0, -1.0]
    for solid in scene.solids:
        center = np.mean([solid.start, solid.end], axis=0) if isinstance(solid, Cylinder) else np.array(solid.center)
        if isinstance(solid, Box) and max(solid.size) < 6:
            assert np.linalg.norm(lane - center[:2], axis=1).min() > 1.9
        elif isinstance(solid, Box):
            assert np.linalg.norm(lane - center[:2], axis=1).min() > 5.0


def test_landmark_density_is_that_of_the_reference_problem(route_and_scene):
    route, scene = route_and_scene
    lane = route.positions[:, [2, 0]] * [1.0, -1.0]
    distance = np.linalg.norm(scene.landmark_points[:, None, :2] - lane[None], axis=2).min(axis=1)
    along = route.length + 10
    assert (distance < 16).sum() / along > 3.0
    assert (distance < 16).sum() / along < 9.0
    assert (distance > 16).sum() / along > 0.5
    assert scene.landmark_points[:, 2].min() > 0


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_sampled_points_lie_on_the_surface_with_outward_normals(shape):
    points, normals = sample_surface(shape, 200, np.random.default_rng(0))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    if isinstance(shape, Sphere):
        distance = np.linalg.norm(points - shape.center, axis=1)
        np.testing.assert_allclose(distance, shape.radius)
        assert ((points - shape.center) * normals).sum(axis=1) == pytest.approx(shape.radius)
    elif isinstance(shape, Cylinder):
        start, end = np.array(shape.start), np.array(shape.end)
        axis = (end - start) / np.linalg.norm(end - start)
        offset = points - start
        radial = offset - np.outer(offset @ axis, axis)
        np.testing.assert_allclose(radial, shape.radius * normals, atol=1e-12)
        assert (offset @ axis >= 0).all()
        assert (offset @ axis <= np.linalg.norm(end - start)).all()
    else:
        cos, sin = np.cos(shape.yaw), np.sin(shape.yaw)
        local = (points - shape.center) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        relative = np.abs(local) / (0.5 * np.array(shape.size))
        np.testing.assert_allclose(relative[:, :2].max(axis=1), 1.0)
        assert ((points - shape.center) * normals).sum(axis=1).min() > 0


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_meshes_are_closed_and_wound_outwards(shape):
    m = mesh(shape)
    a, b, c = (m.vertices[m.triangles[:, i]] for i in range(3))
    facing = (np.cross(b - a, c - a) * m.normals[m.triangles].mean(axis=1)).sum(axis=1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    assert (facing[area > 1e-9] > 0).all()
    volume = (a * np.cross(b, c)).sum() / 6
    exact = {
        Box: lambda s: np.prod(s.size),
        Cylinder: lambda s: np.pi * s.radius**2 * np.linalg.norm(np.subtract(s.end, s.start)),
        Sphere: lambda s: 4 / 3 * np.pi * s.radius**3,
    }[type(shape)](shape)
    assert 0.85 * exact <= volume <= exact * (1 + 1e-9)
    assert m.uvs.min() >= 0


def test_scene_meshes_have_one_mesh_a_material(route_and_scene):
    _, scene = route_and_scene
    meshes = scene_meshes(scene)
    assert set(meshes) == {s.material for s in (scene.ground, *scene.ribbons, *scene.primitives)}
    for material, m in meshes.items():
        assert m.triangles.max() < len(m.vertices)
        assert material.texture is None or material.texture in TEXTURES


def test_an_unknown_texture_is_named():
    with pytest.raises(ValueError, match=r"texture must be one of .*asphalt.*got 'marble'"):
        texture("marble")
