"""The schema of scenario files: that of the types, valid, true of all presets, and named in written files (3 s)."""

import json
import re
import tomllib
from pathlib import Path

import pytest

from stereo_slam_env.benchmark import load_study, preset_study, presets
from stereo_slam_env.benchmark.campaign import check_study
from stereo_slam_env.benchmark.scenarios.schema import KINDS, NAME, scenario_schema, write_scenario_file
from stereo_slam_env.benchmark.scenarios.study import preset_tables
from stereo_slam_env.sensing.corruptions import CORRUPTIONS

jsonschema = pytest.importorskip("jsonschema", reason="needs the extra dev")

ROOT = Path(__file__).parents[4]
KEPT = ROOT / "stereo_slam_env" / "benchmark" / "scenarios" / NAME
NEEDED = {"reference": {"name": "long_drive"}, "dataset": {"path": "drive"}, "factory": {"call": "mine:make"}}


@pytest.fixture(scope="module")
def schema():
    kept = json.loads(KEPT.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(kept)
    return jsonschema.Draft202012Validator(kept)


def complaints(schema, tables):
    return [error.message for error in schema.iter_errors(tables)]


def test_the_schema_that_is_shipped_is_that_of_the_types(schema):
    assert schema.schema == scenario_schema(), "python -m stereo_slam_env.benchmark.scenarios.schema writes it anew"


@pytest.mark.parametrize("name", presets())
def test_presets_are_as_the_schema_says(schema, name):
    assert complaints(schema, preset_tables(name)) == []


def test_the_files_of_the_manual_are_as_the_schema_says(schema):
    blocks = [
        tomllib.loads(block)
        for page in (ROOT / "docs").rglob("*.md")
        for block in re.findall(r"^```toml\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    ]
    scenarios = [tables for tables in blocks if "name" in tables and "kind" in tables]
    assert scenarios
    assert [complaints(schema, tables) for tables in scenarios] == [[]] * len(scenarios)


def test_every_field_says_what_it_is(schema):
    assert [key for key, about in schema.schema["properties"].items() if not about.get("description")] == []


@pytest.mark.parametrize("kind", [one.__struct_config__.tag for one in KINDS])
def test_every_kind_of_source_has_its_options(schema, kind):
    tables = {"name": "mine", "kind": kind, "options": NEEDED.get(kind, {})}
    assert complaints(schema, tables) == []
    for option in NEEDED.get(kind, {}):
        assert complaints(schema, {**tables, "options": {option: 3}}) != []


def test_every_corruption_is_known(schema):
    own = schema.schema["properties"]["corruptions"]["items"]["oneOf"]
    assert [one["title"] for one in own] == list(CORRUPTIONS)


WRONG = r"""
seed = 3
seeds = 0
seeds = [-1]
frames = 1
gate = 'much'
search = 'best'
metrics = ['speed']
divergence_percent = 0
filters = [{ label = 'no name' }]
filters = [{ name = 'inverse-depth', option = 3 }]
corruptions = [{ kind = 'outlier', share = 0.1 }]
corruptions = [{ kind = 'outliers' }]
corruptions = [{ kind = 'outliers', share = 0.1, size = 3 }]
cells = [{ frames = 10 }]
grid = { frames = 10 }
grid = { frame = [10] }
grid = { frames = [10] }\ncells = [{ name = 'a' }]
factorial = { landmark = ['inverse-depth', 'euclidean'] }
factorial = { filter = 'inverse-depth', landmark = ['euclidean'] }
kind = 3
options = 3
name = 3
""".strip().splitlines()


@pytest.mark.parametrize("line", WRONG)
def test_what_the_schema_refuses_bench_refuses_too(schema, tmp_path, line):
    line, head = line.replace(r"\n", "\n"), "" if line.startswith("name") else 'name = "mine"\n'
    assert complaints(schema, tomllib.loads(head + line)) != []
    (tmp_path / "mine.toml").write_text(head + line)
    with pytest.raises(ValueError, match=r"\w"):
        check_study(load_study(tmp_path / "mine.toml"))


@pytest.mark.parametrize("name", ["quick", "mismatch", "attribution", "gaze"])
def test_a_preset_is_written_as_a_file_that_names_its_schema_and_is_the_same_study(tmp_path, name):
    path = tmp_path / "mine.toml"
    write_scenario_file(path, name)
    first, _, rest = path.read_text(encoding="utf-8").partition("\n")
    assert first == f"#:schema {NAME}"
    assert (tmp_path / NAME).read_bytes() == KEPT.read_bytes()
    assert tomllib.loads(rest) == preset_tables(name)
    assert load_study(path) == preset_study(name)


def test_a_json_file_may_name_its_schema(tmp_path):
    path = tmp_path / "mine.json"
    path.write_text(json.dumps({"$schema": NAME, "kind": "street", "name": "mine", "frames": 20}))
    assert load_study(path).only_scenario().frames == 20


def test_no_file_is_overwritten(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("mine")
    with pytest.raises(ValueError, match="exists: choose another name"):
        write_scenario_file(path, "quick")
    assert path.read_text() == "mine"
