"""Scenario files: what they may say, what becomes of it, and how they are refused (0.2 s)."""

import json

import pytest

from filters import StereoNoise
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.benchmark.scenarios.study import Study, load_study, study_from

BASE = {"name": "s", "kind": "reference", "options": {"name": "short_turn"}}


def written(tmp_path, text, name="s.toml"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


def test_one_scenario(tmp_path):
    text = """
        description = "what it is for"
        name = "mine"
        kind = "street"
        seeds = 3
        gate = false
        corruptions = [{ kind = "outliers", share = 0.1 }]
        metrics = ["map"]
        options = { route = "town", sigma = 2.0 }
        filters = [{ name = "inverse-depth", label = "paper", options = { error = "so3" } }]
    """
    study = load_study(written(tmp_path, text))
    assert not study.is_grid
    scenario = study.only_scenario()
    assert (scenario.name, scenario.seeds, scenario.gate, scenario.metrics) == ("mine", (0, 1, 2), None, ("map",))
    assert scenario.source.options == {"route": "town", "sigma": 2.0}
    assert scenario.filters == (FilterChoice("paper", "inverse-depth", {"error": "so3"}),)
    assert scenario.corruptions == ({"kind": "outliers", "share": 0.1},)


def test_json_says_the_same(tmp_path):
    path = written(tmp_path, json.dumps({**BASE, "seeds": [4, 5]}), "s.json")
    assert load_study(path).only_scenario().seeds == (4, 5)


def test_a_grid_has_a_cell_for_every_combination():
    study = study_from({**BASE, "grid": {"options.sigma": [0.5, 2.0], "noise": {"independent_pixels": [1.0, 3.0]}}})
    assert [dict(cell.factors) for cell in study.cells] == [
        {"options.sigma": sigma, "noise.independent_pixels": assumed} for sigma in (0.5, 2.0) for assumed in (1.0, 3.0)
    ]
    assert [cell.name for cell in study.cells][:2] == [f"sigma-0.5_independent_pixels-{n}" for n in (1.0, 3.0)]
    last = study.cells[-1].scenario
    assert last.source.options == {"name": "short_turn", "sigma": 2.0}
    assert last.assumed_noise(StereoNoise.independent_pixels(9.0)) == StereoNoise.independent_pixels(3.0)


def test_a_whole_noise_can_be_a_level():
    noises = [{"independent_pixels": 1.0}, {"diagonal": [1.0, 1.0, 2.0]}]
    study = study_from({**BASE, "noise": {"independent_pixels": 7.0}, "grid": {"noise": noises}})
    assert [cell.scenario.noise for cell in study.cells] == noises
    assert study.cells[1].factors == {"noise": '{"diagonal": [1.0, 1.0, 2.0]}'}


def test_any_field_can_be_a_factor():
    study = study_from({**BASE, "grid": {"frames": [5, 6], "gate": [False, 0.99], "motion.sigma_acceleration": [1.0]}})
    assert [(c.scenario.frames, c.scenario.gate) for c in study.cells] == [(5, None), (5, 0.99), (6, None), (6, 0.99)]
    assert study.cells[0].scenario.motion == {"sigma_acceleration": 1.0, "sigma_angular_acceleration": 0.6}


def test_cells_differ_in_what_they_say():
    study = study_from({**BASE, "cells": [{"name": "a", "frames": 5}, {"name": "b", "options": {"sigma": 3.0}}]})
    assert [cell.name for cell in study.cells] == ["a", "b"]
    assert study.cells[0].scenario.frames == 5
    assert study.cells[1].scenario.source.options == {"name": "short_turn", "sigma": 3.0}


def test_a_factorial_makes_the_filters():
    levels = {"measurement": ["joint", "left"], "iterations": [1, 2]}
    crossed = {"filter": "inverse-depth", "options": {"gate": 0.9}, **levels}
    study = study_from({**BASE, "factorial": crossed})
    assert study.factorial == {"measurement": ("joint", "left"), "iterations": (1, 2)}
    labels = [choice.label for choice in study.only_scenario().filters]
    assert labels == ["joint+1", "joint+2", "left+1", "left+2"]
    assert study.only_scenario().filters[3].options == {"gate": 0.9, "measurement": "left", "iterations": 2}


def test_recordings_that_are_not_there_are_left_out(tmp_path):
    (tmp_path / "one").mkdir()
    cells = [{"name": name, "options": {"path": f"{{data}}/{name}"}} for name in ("one", "two")]
    tables = {"name": "real", "kind": "dataset", "cells": cells}
    study = study_from(tables, data=tmp_path)
    assert [cell.name for cell in study.cells] == ["one"]
    assert study.cells[0].scenario.source.options["path"] == str(tmp_path / "one")
    with pytest.raises(ValueError, match=r"say which folder holds the recordings \(--data\)"):
        study_from(tables)
    with pytest.raises(ValueError, match="none of the recordings of real is in"):
        study_from(tables, data=tmp_path / "one")


def test_a_study_survives_json():
    crossed = {"filter": "inverse-depth", "iterations": [1, 2]}
    study = study_from({**BASE, "factorial": crossed, "grid": {"frames": [5]}})
    assert Study.from_dict(json.loads(json.dumps(study.as_dict()))) == study


def test_a_study_of_one_scenario_has_it():
    assert Study.of(Scenario("s")).only_scenario() == Scenario("s")
    with pytest.raises(ValueError, match="is a grid of 2 scenarios"):
        study_from({**BASE, "grid": {"frames": [5, 6]}}).only_scenario()


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"description": 3}, "description must be text, got 3"),
        ({"gird": {}}, "no key 'gird', did you mean 'grid'"),
        ({"grid": {"optoins.sigma": [1]}}, "grid has no key 'optoins', did you mean 'options'"),
        ({"grid": {"frames": 5}}, r"grid\.frames must be a list of values, got 5"),
        ({"grid": {"frames": []}}, r"grid\.frames must be a list"),
        ({"grid": [1]}, "grid must be a table"),
        ({"grid": {"frames": [5], "seeds": [[0]] * 10_001}}, "grid has 10001 points"),
        ({"grid": {"frames": [5, 1]}}, "frames must be a whole number >= 2, got 1"),
        ({"grid": {"frames": [5]}, "cells": []}, "exclude each other"),
        ({"cells": [{"frames": 5}]}, r"cells\[0\] must have a name"),
        ({"cells": [{"name": "a", "frame": 5}]}, r"cells\[0\] has no key 'frame', did you mean 'frames'"),
        ({"cells": [{"name": "a"}, {"name": "a"}]}, "'a' twice"),
        ({"cells": [{"name": "../a"}]}, r"name of a cell must be text of letters, .* got .\.\./a"),
        ({"factorial": {"iterations": [1, 2]}}, "factorial must name its filter"),
        ({"factorial": {"filter": "euclidean", "iterations": [1]}}, "two levels or more"),
        ({"factorial": {"filter": "euclidean"}}, "at least one option"),
        ({"factorial": {"filter": "euclidean", "iterations": [1, 2]}, "filters": []}, "exclude each other"),
        ({"name": "../x"}, "name of a scenario must be text of letters, digits and . _ .*, got .../x"),
        ({"name": 101 * "x"}, "name of a scenario must be text of length <= 100"),
        ({"name": 3}, "name of a scenario must be text, got 3"),
        ({"options": 3}, "options"),
        ({"seeds": "many"}, "seeds"),
        ({"metrics": ["maps"]}, r"metrics\[0\] must be one of map, bound, windows, got 'maps', did you mean 'map'"),
        ({"corruptions": ["outliers"]}, r"corruptions\[0\] must be a table, got 'outliers'"),
    ],
)
def test_wrong_files_are_refused_with_a_hint(tmp_path, changes, complaint):
    path = written(tmp_path, json.dumps({**BASE, **changes}), "s.json")
    with pytest.raises(ValueError, match=complaint) as refused:
        load_study(path)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize(
    ("name", "text", "complaint"),
    [
        ("s.toml", "", "s.toml: scenario must have a name, such as name = 'mine'$"),
        ("s.json", "{}", "s.json: scenario must have a name, such as name = 'mine'$"),
        ("s.toml", "name = ", "cannot be read as TOML"),
        ("s.json", "{", "cannot be read as JSON"),
        ("s.json", "[1]", "scenario must be a table, got"),
        ("s.json", "[" * 100_000, "cannot be read as JSON"),
        ("s.toml", "name = 'x'\x00", "cannot be read as TOML"),
    ],
)
def test_files_that_are_none_are_named(tmp_path, name, text, complaint):
    path = written(tmp_path, text, name)
    with pytest.raises(ValueError, match=complaint):
        load_study(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"nothing\.toml does not exist"):
        load_study(tmp_path / "nothing.toml")
