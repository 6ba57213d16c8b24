"""Fog hides what is far and leaves the rest of the scene as it is. Under 1 s."""

from dataclasses import replace

import numpy as np
import pytest

from stereo_slam_env.world.routes import ROUTES
from stereo_slam_env.world.surroundings import build_scene, in_fog, with_other_look


@pytest.fixture(scope="module")
def scene():
    return build_scene("groves", ROUTES["right-turn"](), np.random.default_rng(0), moving_cars=1)


@pytest.mark.parametrize("visibility", [10.0, 30.0, 150.0])
def test_a_twentieth_of_the_contrast_is_left_at_the_visibility(scene, visibility):
    look = in_fog(scene, visibility).look
    assert np.exp(-visibility / look.haze_range) == pytest.approx(0.05, abs=0.001)


def test_only_air_and_sky_change(scene):
    foggy = in_fog(scene, 30.0)
    assert replace(foggy, look=scene.look).__dict__ == scene.__dict__
    look = replace(foggy.look, horizon=scene.look.horizon, zenith=scene.look.zenith, haze_range=scene.look.haze_range)
    assert look == scene.look
    assert in_fog(in_fog(scene, 20.0), 100.0).look.haze_range == pytest.approx(20.0 / 3.0)  # it is hazier already
    other = with_other_look(scene, np.random.default_rng(3))
    assert in_fog(other, 30.0).primitives == other.primitives


def test_the_sky_is_the_grey_of_the_horizon_and_less_so_in_thin_fog(scene):
    thick, thin = in_fog(scene, 30.0).look, in_fog(scene, 150.0).look
    assert np.ptp([*thick.horizon, *thick.zenith]) < 1.0
    assert np.mean(thick.horizon) == pytest.approx(np.mean(scene.look.horizon))
    blue = [look.zenith[2] - look.zenith[0] for look in (thick, thin, scene.look)]
    assert blue == sorted(blue)
    assert blue[1] > 10.0


@pytest.mark.parametrize("visibility", [0.0, -1.0, np.nan])
def test_a_visibility_that_is_none_is_refused(scene, visibility):
    with pytest.raises(ValueError, match="visibility must be"):
        in_fog(scene, visibility)
