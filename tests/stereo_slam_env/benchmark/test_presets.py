"""The ready-made scenarios (0.1 s)."""

import pytest

from stereo_slam_env.benchmark.campaign import check_filters
from stereo_slam_env.benchmark.presets import PRESETS, preset


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_a_scenario_of_its_name_with_filters_that_exist(name):
    scenario = preset(name)
    assert scenario.name == name
    check_filters(scenario)


@pytest.mark.parametrize("name", PRESETS)
def test_what_is_assumed_is_said(name):
    scenario = preset(name)
    assert scenario.noise == {"independent_pixels": 1.0}
    assert {choice.name for choice in scenario.filters} == {"inverse-depth", "dual-bearing", "euclidean"}


def test_an_unknown_preset_is_answered_with_the_known_ones():
    with pytest.raises(ValueError, match=r"preset must be one of quick, .*, got 'quik', did you mean 'quick'"):
        preset("quik")
