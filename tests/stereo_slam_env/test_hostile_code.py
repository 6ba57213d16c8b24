"""Nothing that is read is executed: no pickles, no evaluation, no module that a file names without consent."""

from __future__ import annotations

import ast
import json
import re
import sys
from pathlib import Path

import pytest
from rich.table import Table

from stereo_slam_env.benchmark.campaign import as_study
from stereo_slam_env.benchmark.recordings.reference_problem import short_turn
from stereo_slam_env.benchmark.recordings.sources import FactorySource, ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.benchmark.scenarios.study import MOST_TRIALS, Study, load_study
from stereo_slam_env.benchmark.storage.result_tables import write_results
from stereo_slam_env.benchmark.storage.run_files import load_run, packed_run
from stereo_slam_env.benchmark.storage.store import prepared_study, read_study
from stereo_slam_env.cli.app import main
from stereo_slam_env.cli.shared_options import console
from stereo_slam_env.evaluation.filter_run import run_filter

ROOT = Path(__file__).resolve().parents[2]
MODULES = sorted(
    path
    for folder in ("filters", "stereo_slam_env", "examples", "benchmarks")
    for path in (ROOT / folder).rglob("*.py")
)
FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "yaml", "jsonpickle"}
MAY_IMPORT = {
    # Work and answers between a process and the children of its own server.
    "stereo_slam_env/benchmark/running/isolation.py": {"pickle", "cloudpickle"},
    "stereo_slam_env/benchmark/running/process_server.py": {"pickle", "cloudpickle"},
    "stereo_slam_env/files/yaml_files.py": {"yaml"},  # a safe loader, which makes plain data only
}
FORBIDDEN_CALLS = {
    *("eval", "exec", "__import__", "os.system", "os.popen", "joblib.load", "pd.read_pickle", "np.load"),
    *("yaml.load", "yaml.load_all", "yaml.full_load", "yaml.unsafe_load"),
}
FORBIDDEN_ARGUMENTS = {"shell": True, "allow_pickle": True, "weights_only": False}
LOADS_MODULES = {  # by name; and where that name comes from
    "stereo_slam_env/benchmark/running/process_server.py": "a table in the module",
    "stereo_slam_env/evaluation/results.py": "a literal",
    "stereo_slam_env/benchmark/recordings/sources.py": "typed, or a 'factory' that load_study refuses without consent",
    "stereo_slam_env/rendering/gl_resources.py": "a literal",
    "stereo_slam_env/viewer/rerun_view.py": "a literal",
    "stereo_slam_env/cli/train.py": "what is typed before an id, as gymnasium.make takes it",
}


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def imported(tree: ast.AST) -> set[str]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.partition(".")[0])
    return found


def dangers(source: str, *, may_import: frozenset[str] = frozenset()) -> list[str]:
    tree = ast.parse(source)
    found = [f"imports {name}" for name in sorted(imported(tree) & FORBIDDEN_MODULES - may_import)]
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = ast.unparse(call.func).replace("numpy.", "np.")
        given = {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords}
        if name == "np.load" and given.get("allow_pickle") != "False":
            found.append(f"line {call.lineno}: np.load without allow_pickle=False")
        elif name in FORBIDDEN_CALLS - {"np.load"}:
            found.append(f"line {call.lineno}: {name}")
        elif name == "torch.load" and given.get("weights_only") != "True":
            found.append(f"line {call.lineno}: torch.load without weights_only=True")
        found += [
            f"line {call.lineno}: {key}={value}"
            for key, value in FORBIDDEN_ARGUMENTS.items()
            if given.get(key) == str(value)
        ]
    return found


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_no_module_reads_pickles_or_evaluates_text(path):
    may_import = frozenset(MAY_IMPORT.get(name_of(path), ()))
    assert dangers(path.read_text(encoding="utf-8"), may_import=may_import) == []


@pytest.mark.parametrize(
    "source",
    [
        *("import pickle", "from yaml import load", "np.load(p)", "numpy.load(p, allow_pickle=True)", "torch.load(p)"),
        *(
            "eval(text)",
            "yaml.load(text, Loader=kind)",
            "os.system(text)",
            "subprocess.run(text, shell=True)",
            "torch.load(p, weights_only=False)",
        ),
    ],
)
def test_the_search_sees(source):
    assert dangers(source)


def test_modules_are_loaded_by_name_only_where_the_name_is_known():
    loading = {
        name_of(path)
        for path in MODULES
        if name_of(path).startswith(("filters/", "stereo_slam_env/"))
        and re.search(r"import_module\(|pkgutil\.resolve_name\(", path.read_text("utf-8"))
    }
    assert loading == set(LOADS_MODULES)


# --- scenario files --------------------------------------------------------------------------------------------------

FACTORY = 'name = "evil"\nkind = "factory"\nfilters = ["euclidean"]\n[options]\ncall = "evil_module:make"\n'


@pytest.fixture
def evil(tmp_path, monkeypatch):
    """A scenario file that names a module beside it, which leaves a mark when it is imported."""
    (tmp_path / "evil_module.py").write_text("from pathlib import Path\nPath(__file__).with_name('mark').touch()\n")
    (tmp_path / "evil.toml").write_text(FACTORY)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path / "evil.toml"
    sys.modules.pop("evil_module", None)


def test_a_scenario_file_runs_code_only_with_consent(evil):
    with pytest.raises(ValueError, match=r"runs code, 'evil_module:make': if you trust it, allow it with --allow-code"):
        load_study(evil)
    assert load_study(evil, allow_code=True).only_scenario().source.kind == "factory"
    assert not (evil.parent / "mark").exists()


def test_the_command_asks_for_consent(evil, capsys):
    out = evil.parent / "out"
    assert main(["bench", "--scenario", str(evil), "--out", str(out)]) == 2
    assert "--allow-code" in capsys.readouterr().err
    assert not out.exists()
    assert not (evil.parent / "mark").exists()


@pytest.mark.parametrize(
    "table",
    [
        '[options]\nname = "short_turn"\ncall = "evil_module:make"\n[grid]\nkind = ["reference", "factory"]',
        '[[cells]]\nname = "a"\nkind = "factory"\noptions = { call = "evil_module:make" }',
    ],
)
def test_nor_does_a_cell_of_a_grid(table, tmp_path):
    (tmp_path / "grid.toml").write_text(f'name = "grid"\nkind = "reference"\nfilters = ["euclidean"]\n{table}\n')
    with pytest.raises(ValueError, match="--allow-code"):
        as_study(tmp_path / "grid.toml")


@pytest.mark.parametrize("name", ["evil_module:Env-v0", "evil_module:StereoSlam/Gaze-v0"])
def test_an_environment_is_no_module(name, evil, capsys):
    text = f'name = "gaze"\nkind = "gaze"\npolicies = ["sweep"]\n[options]\nenvironment = "{name}"\n'
    (evil.parent / "gaze.toml").write_text(text)
    assert main(["bench", "--scenario", str(evil.parent / "gaze.toml"), "--out", str(evil.parent / "out")]) == 2
    assert "environment must be one of" in capsys.readouterr().err
    assert not (evil.parent / "mark").exists()


@pytest.mark.parametrize("key", ["filters", "policies"])
def test_a_filter_or_policy_is_no_module(key, evil, capsys):
    policies = 'policies = ["sweep"]\n' if key == "filters" else ""
    text = f'name = "named"\nkind = "gaze"\n{policies}{key} = [{{ name = "evil_module:make", label = "x" }}]\n'
    (evil.parent / "named.toml").write_text(text)
    assert main(["bench", "--scenario", str(evil.parent / "named.toml"), "--out", str(evil.parent / "out")]) == 2
    assert not (evil.parent / "mark").exists()


def test_the_folder_of_recordings_is_not_left(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "far.toml").write_text('name = "far"\nkind = "dataset"\n[options]\npath = "{data}/../secret"\n')
    with pytest.raises(ValueError, match="out of"):
        load_study(tmp_path / "far.toml", data=tmp_path / "data")


@pytest.mark.parametrize(
    "text",
    [
        "seeds = 1000000000000",
        f"seeds = {MOST_TRIALS}\nfilters = ['inverse-depth', 'euclidean']",
        "[factorial]\nfilter = 'inverse-depth'\n" + "".join(f"x{k} = [1, 2]\n" for k in range(40)),
        "[grid]\n" + "".join(f"'options.x{k}' = [1, 2]\n" for k in range(40)),
    ],
    ids=["seeds", "trials", "factorial", "grid"],
)
def test_a_small_file_cannot_ask_for_the_world(text, tmp_path):
    (tmp_path / "huge.toml").write_text(
        f"name = 'huge'\nkind = 'reference'\noptions = {{ name = 'short_turn' }}\n{text}\n"
    )
    with pytest.raises(ValueError, match=r"at most|more than"):
        load_study(tmp_path / "huge.toml")


def test_control_characters_of_a_file_do_not_reach_the_terminal(tmp_path, capsys):
    (tmp_path / "odd.toml").write_text('name = "odd"\nkind = "\\u001b]0;owned\\u0007"\n')
    assert main(["bench", "--scenario", str(tmp_path / "odd.toml")]) == 2
    assert "\x1b" not in capsys.readouterr().err


def test_nor_do_those_of_a_name_that_is_shown(capsys):
    shown = console()
    table = Table("a\x1b[2Jb")
    table.add_row("c\x1b]0;owned\x07d")
    shown.print("e\x9b31mf", table, "[bold]g[/bold]")
    out = capsys.readouterr().out
    assert not set(out) & set("\x1b\x07\x9b")
    assert "a\\x1b[2Jb" in out
    assert "c\\x1b]0;owned\\x07d" in out


# --- results ---------------------------------------------------------------------------------------------------------


def test_results_do_not_name_files_outside_their_folder(tmp_path):
    scenario = Scenario("one", ReferenceSource("short_turn"), (FilterChoice("paper", "inverse-depth"),))
    (directory,) = prepared_study(tmp_path / "run", Study.of(scenario)).write_settings().cells
    run = run_filter(short_turn(seed=0, frames=3), "inverse-depth", label="../../../evil", seed=0)
    directory.save_trial(0, scenario.filters[0], packed_run(run, {"recording": {}, "code": "none"}))
    assert load_run(directory.trial_path(0, scenario.filters[0])).run.filter_name == "../../../evil"
    with pytest.raises(ValueError, match="holds a run of"):
        write_results(read_study(tmp_path / "run"))
    written = {"run", "study.json", "settings.json", "trials", "seed-0000", "paper.npz"}
    assert {path.name for path in tmp_path.rglob("*")} == written


@pytest.mark.parametrize("name", ["../../evil", "/tmp/evil", "a/b", ".."])
def test_nor_do_cells(name, tmp_path):
    scenario = Scenario("one", ReferenceSource("short_turn")).as_dict()
    cells = [{"name": cell, "factors": {"x": cell}, "scenario": scenario} for cell in ("good", name)]
    (tmp_path / "study.json").write_text(json.dumps({"name": "s", "cells": cells, "factorial": None}))
    with pytest.raises(ValueError, match="name of a cell must be"):
        read_study(tmp_path)


@pytest.mark.parametrize("label", ["../evil", "a/b", "", "<script>"])
def test_nor_do_filters(label, tmp_path):
    scenario = Scenario("one", ReferenceSource("short_turn")).as_dict()
    scenario["filters"] = [{"name": "euclidean", "label": label, "options": {}}]
    (tmp_path / "settings.json").write_text(json.dumps({"scenario": scenario}))
    with pytest.raises(ValueError, match=r"filters\[0\].label must be text of letters"):
        read_study(tmp_path)


def test_reading_the_results_of_a_factory_calls_nothing(evil):
    scenario = Scenario("x", FactorySource("evil_module:make"), (FilterChoice("paper", "euclidean"),))
    (directory,) = prepared_study(evil.parent / "run", Study.of(scenario)).write_settings().cells
    run = run_filter(short_turn(seed=0, frames=3), "euclidean", label="paper", seed=0)
    provenance = {"recording": {"name": "x", "stream_sha256": "0"}, "code": "none"}
    directory.save_trial(0, scenario.filters[0], packed_run(run, provenance))
    assert main(["report", str(evil.parent / "run")]) == 0
    assert not (evil.parent / "mark").exists()
