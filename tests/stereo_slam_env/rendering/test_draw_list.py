"""Chunks of triangles: nothing in view is left out, most of the rest is."""

import numpy as np
import pytest

from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from stereo_slam_env.rendering.gl_resources import VERTEX, ViewVolume, draw_list
from stereo_slam_env.rendering.pinhole import FAR, NEAR
from stereo_slam_env.world.meshes import scene_meshes
from stereo_slam_env.world.routes import ROUTES
from stereo_slam_env.world.street import build_street

from .planes import FRAME

CAMERA = StereoCamera(300.0, 310.0, 190.0, 100.0, 0.5, 320, 240)


@pytest.fixture(scope="module")
def street():
    meshes = scene_meshes(build_street(ROUTES["right-turn"](), np.random.default_rng(0)))
    return meshes, draw_list(meshes, lambda material: 3)


def test_all_triangles_of_all_meshes_are_there(street):
    meshes, packed = street
    expected = np.concatenate([mesh.vertices[mesh.triangles].reshape(-1, 9) for mesh in meshes.values()])
    drawn = packed.vertices["position"][packed.triangles].reshape(-1, 9)
    expected, drawn = (corners[np.lexsort(corners.T)] for corners in (expected.astype(np.float32), drawn))
    np.testing.assert_array_equal(drawn, expected)
    assert (packed.vertices["texel"][:, 2] == 3).all()
    assert packed.vertices.dtype == VERTEX
    assert packed.starts[0] == 0
    assert packed.starts[-1] == len(packed.triangles)


def test_nothing_in_view_is_left_out_and_most_of_the_rest_is(street):
    _, packed = street
    rng = np.random.default_rng(1)
    route = ROUTES["right-turn"]()
    for _ in range(10):
        eye = FRAME.to_scene(route.positions[int(rng.integers(80))] + rng.normal(0.0, 0.3, 3))
        R_sc = FRAME.rotation_to_scene(rotations.exp(rng.normal(0.0, [0.3, 1.5, 0.3])))
        p_c = (packed.vertices["position"] - eye) @ R_sc
        in_view = np.zeros(len(p_c), dtype=bool)
        for right in (0.0, CAMERA.baseline):
            uv = CAMERA.project(p_c - [right, 0.0, 0.0])
            inside = (uv[:, :2] > -0.5).all(axis=1) & (uv[:, 0] < CAMERA.width - 0.5) & (uv[:, 1] < CAMERA.height - 0.5)
            in_view |= inside & (p_c[:, 2] > NEAR) & (p_c[:, 2] < FAR)
        drawn = packed.front_to_back(ViewVolume.of(CAMERA, eye, R_sc, NEAR, FAR))
        wanted = packed.triangles[in_view[packed.triangles].any(axis=1)]
        assert set(map(tuple, wanted.tolist())) <= set(map(tuple, drawn.tolist()))
        assert len(drawn) < 0.8 * len(packed.triangles)


def test_near_chunks_come_first(street):
    _, packed = street
    eye, R_sc = FRAME.to_scene(np.zeros(3)), FRAME.rotation_to_scene(np.eye(3))
    drawn = packed.front_to_back(ViewVolume.of(CAMERA, eye, R_sc, NEAR, FAR))
    distance = np.linalg.norm(packed.vertices["position"][drawn].mean(axis=1) - eye, axis=1)
    tenth = len(distance) // 10
    assert np.median(distance[:tenth]) < 0.3 * np.median(distance[-tenth:])


def test_with_nothing_in_view_nothing_is_drawn(street):
    _, packed = street
    high = ViewVolume.of(CAMERA, np.array([0.0, 0.0, 500.0]), FRAME.rotation_to_scene(np.eye(3)), NEAR, FAR)
    assert packed.front_to_back(high).shape == (0, 3)
