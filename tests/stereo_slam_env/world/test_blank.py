"""A scene without texture keeps its shapes. Under 1 s."""

import numpy as np
import pytest

from stereo_slam_env.world.routes import ROUTES
from stereo_slam_env.world.scene import Material
from stereo_slam_env.world.surroundings import BLANK, SURROUNDINGS, build_scene, without_texture


@pytest.fixture(scope="module", params=sorted(SURROUNDINGS))
def scene(request):
    return build_scene(request.param, ROUTES["right-turn"](), np.random.default_rng(0), moving_cars=1)


def materials(scene):
    """Of everything, in a fixed order."""
    parts = [scene.ground, *scene.ribbons, *scene.primitives, *(p for body in scene.moving for p in body.parts)]
    return [part.material for part in parts]


def test_everything_is_of_one_plain_colour(scene):
    assert any(material.texture for material in materials(scene))
    assert set(materials(without_texture(scene))) == {BLANK}
    assert BLANK.texture is None


def test_shapes_landmarks_and_light_stay(scene):
    blank = without_texture(scene)
    assert blank.repainted(lambda material: material).primitives == blank.primitives
    for before, after in zip(scene.primitives, blank.primitives, strict=True):
        assert {**vars(after), "material": before.material} == vars(before)
    for before, after in zip(scene.ribbons, blank.ribbons, strict=True):
        assert after.left is before.left
        assert after.right is before.right
    assert blank.landmark_points is scene.landmark_points
    assert [(body.kind, len(body.parts)) for body in blank.moving] == [(b.kind, len(b.parts)) for b in scene.moving]
    assert (blank.look, blank.ground.low, blank.ground.high) == (scene.look, scene.ground.low, scene.ground.high)


def test_equal_materials_are_repainted_alike_and_once(scene):
    asked = []

    def paint(material):
        asked.append(material)
        return Material((0.01 * (len(asked) % 100), 0.5, 0.5), variant=len(asked) // 100)

    repainted = dict(zip(materials(scene), materials(scene.repainted(paint)), strict=True))
    assert len(asked) == len(set(asked)) == len(set(repainted.values()))
