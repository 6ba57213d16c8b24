"""Another look: everything but the shapes changes, within what makes sense. About 1 s."""

import numpy as np
import pytest

from stereo_slam_env.world.routes import ROUTES
from stereo_slam_env.world.street_textures import TEXTURES, VARIANTS, texture
from stereo_slam_env.world.surroundings import build_scene, with_other_look


@pytest.fixture(scope="module")
def street():
    return build_scene("street", ROUTES["right-turn"](), np.random.default_rng(0), moving_cars=3)


def test_light_and_air_differ_from_seed_to_seed_and_stay_daylight(street):
    looks = [with_other_look(street, np.random.default_rng(seed)).look for seed in range(20)]
    assert len({look.sun for look in looks}) == 20
    assert len({look.horizon for look in looks}) > 2
    for look in looks:
        assert np.linalg.norm(look.sun) == pytest.approx(1.0)
        assert look.sun[2] > 0.3
        assert 0.6 < look.ambient + look.diffuse <= 1.3
        assert 100 < look.haze_range < 700


def test_equal_materials_stay_equal_and_colours_legal(street):
    other = with_other_look(street, np.random.default_rng(1))
    pairs = {(p.material, q.material) for p, q in zip(street.primitives, other.primitives, strict=True)}
    assert len(pairs) == len({p.material for p in street.primitives})
    assert all(0.0 <= channel <= 1.0 for _, material in pairs for channel in material.color)
    assert {material.variant for _, material in pairs} == set(range(VARIANTS))
    assert all(p.texture == q.texture and p.tile == q.tile for p, q in pairs)


@pytest.mark.parametrize("name", TEXTURES)
def test_variants_of_a_texture_differ_but_resemble_it(name):
    images = [texture(name, variant) for variant in range(VARIANTS)]
    assert texture(name) is texture(name, 0) or np.array_equal(texture(name), texture(name, 0))
    for i, image in enumerate(images):
        assert image.shape == images[0].shape
        assert image.dtype == np.uint8
        assert not any(np.array_equal(image, other) for other in images[:i])
        assert abs(image.mean() - images[0].mean()) < 60


def test_an_unknown_variant_is_named():
    with pytest.raises(ValueError, match="variant must be from 0 to 3, got 4"):
        texture("brick", 4)
