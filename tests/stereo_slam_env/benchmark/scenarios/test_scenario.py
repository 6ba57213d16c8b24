"""Scenarios are plain data, checked when made (0.1 s)."""

import json

import numpy as np
import pytest

from filters import ColouredNoise, LandmarkDrift, StereoNoise
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario, filter_choice


def test_a_scenario_survives_json():
    scenario = Scenario("s", ReferenceSource("short_turn"), seeds=(3, 4), noise={"diagonal": [1, 1, 2]}, gate=None)
    assert Scenario.from_dict(json.loads(json.dumps(scenario.as_dict()))) == scenario


def test_the_search_in_images_survives_json_and_older_files_have_none():
    data = Scenario("s", search="forecast").as_dict()
    assert Scenario.from_dict(json.loads(json.dumps(data))).search == "forecast"
    del data["search"]
    assert Scenario.from_dict(data) == Scenario("s", search="flow")


def test_the_euclidean_filter_has_its_guard_as_a_visible_option():
    assert filter_choice("euclidean").options == {"min_disparity": 4.0}
    assert filter_choice("somebody-elses") == FilterChoice("somebody-elses", "somebody-elses")


def test_filters_can_be_named_or_spelt_out():
    spelt_out = {"name": "inverse-depth", "label": "tight", "options": {"gate": 0.5}}
    scenario = Scenario.from_dict({"name": "s", "kind": "street", "filters": ["euclidean", spelt_out]})
    assert scenario.filters == (filter_choice("euclidean"), FilterChoice("tight", "inverse-depth", {"gate": 0.5}))


def test_the_assumed_noise_is_that_of_the_recording_unless_said_otherwise():
    of_recording = StereoNoise.independent_pixels(2.0)
    assert Scenario("s").assumed_noise(of_recording) is of_recording
    pixels = Scenario("s", noise={"independent_pixels": 3.0}).assumed_noise(of_recording)
    assert pixels == StereoNoise.independent_pixels(3.0)
    diagonal = Scenario("s", noise={"diagonal": [1.0, 2.0, 3.0]}).assumed_noise(of_recording)
    assert diagonal == StereoNoise.diagonal(1.0, 2.0, 3.0)


def test_errors_that_last_do_so_with_any_assumed_noise():
    of_recording = ColouredNoise(np.eye(3), 0.1 * np.eye(3), LandmarkDrift(0.3), 0.004)
    assumed = Scenario("s", noise={"diagonal": [1.0, 2.0, 3.0]}).assumed_noise(of_recording)
    assert assumed == ColouredNoise(np.diag([1.0, 4.0, 9.0]), None, LandmarkDrift(0.3), 0.004)


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        ({"name": "s", "sede": [1]}, "no key 'sede', did you mean 'seeds'"),
        ({}, "must have a name"),
        ({"name": "s", "kind": "streat"}, "did you mean 'street'"),
        ({"name": "s", "gate": 1.5}, r"gate must be a probability between 0 and 1, or None for no gate, got 1\.5"),
        ({"name": "s", "gate": "none"}, "gate must be a probability between 0 and 1, or None for no gate, got 'none'"),
        ({"name": "s", "seeds": []}, "seeds must be a list of length >= 1"),
        ({"name": "s", "seeds": [1, 1]}, "seeds must be different"),
        ({"name": "s", "frames": 1}, "frames must be a whole number >= 2, got 1"),
        ({"name": "s", "noise": {"pixels": 1}}, "noise has no key 'pixels'"),
        ({"name": "s", "noise": {"independent_pixels": -1}}, "must be a finite number > 0"),
        ({"name": "s", "motion": {"sigma_accelaration": 1}}, "did you mean 'sigma_acceleration'"),
        (
            {"name": "s", "motion": {"sigma_acceleration": -1}},
            "^motion.sigma_acceleration must be a number >= 0.0, got -1$",
        ),
        ({"name": "s", "filters": 3}, "^filters must be a list, got 3$"),
        ({"name": "s", "filters": ["euclidean", 3]}, r"^filters\[1\] must be a table, got 3$"),
        ({"name": "s", "filters": ["euclidean", {"label": "x"}]}, r"^filters\[1\] must have name$"),
        ({"name": "s", "filters": [{"name": "euclidean", "policy": None}]}, "^filters has no key 'policy'"),
        ({"name": "s", "policies": [{"name": 3}]}, r"^policies\[0\].name must be text, got 3$"),
        ({"name": "s", "filters": []}, "filters must name at least one filter"),
        ({"name": "s", "filters": ["euclidean", "euclidean"]}, "different labels"),
        ({"name": "s", "filters": [{"name": "euclidean", "option": {}}]}, "did you mean 'options'"),
        (
            {"name": "s", "filters": [{"name": "euclidean", "label": "../x"}]},
            r"^filters\[0\].label must be .* got '../x'$",
        ),
        ({"name": "s", "options": {"x": float("nan")}}, "must consist of JSON values"),
        ({"name": "s", "search": "forecas"}, "search must be one of flow, .*did you mean 'forecast'"),
        ({"name": "s", "search": None}, "search must be text, got None"),
        ({"name": "s", "divergence_percent": 0}, "divergence_percent must be"),
    ],
)
def test_wrong_scenarios_are_refused_with_a_hint(data, complaint):
    with pytest.raises(ValueError, match=complaint):
        Scenario.from_dict({"kind": "street", **data})


def test_a_scenario_without_a_kind_says_so_in_one_line():
    """Not what the options of another kind lack."""
    with pytest.raises(ValueError, match=r"^scenario 's' must say its kind, one of street, gaze, .*") as raised:
        Scenario.from_dict({"name": "s", "options": {"sigma": 1.0}})
    assert "\n" not in str(raised.value)
