"""Edited code of a stranger's filter, policy or recording makes kept results void (30 s)."""

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import types
from functools import partial
from pathlib import Path

import pytest

from filters import InverseDepthStereoEKF
from stereo_slam_env.benchmark import compare
from stereo_slam_env.benchmark.recordings.sources import FactorySource, ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, PolicyChoice, Scenario
from stereo_slam_env.benchmark.scenarios.study import Study
from stereo_slam_env.benchmark.storage.code_identity import (
    code_digest,
    digest_of_choice,
    digest_of_source,
    plugin_digest,
)
from stereo_slam_env.benchmark.storage.store import RunDirectory

ROOT = Path(__file__).resolve().parents[4]

FILTER = '''"""A stranger's filter."""
from filters import InverseDepthStereoEKF
from lab_filter.tuning import scaled


class LabFilter(InverseDepthStereoEKF):
    """Inverse depth with another noise."""

    def __init__(self, camera, noise, **options):
        super().__init__(camera, scaled(noise), **options)

    def predict(self, dt, odometry=None):
        super().predict(dt, odometry)
'''
TUNING = '''"""Settings."""
from filters import StereoNoise
from lab_numbers import FACTOR


def scaled(noise):
    return StereoNoise(FACTOR * noise.R)
'''
SCENARIO = """
name = "lab"
kind = "reference"
filters = ["lab", "inverse-depth"]
seeds = 1
frames = 12
metrics = []
[options]
name = "short_turn"
"""


def install(folder, entry_points, **modules):
    """A distribution in a folder, as pip leaves it: modules by dotted name, and entry points by group."""
    for name, text in modules.items():
        path = folder / (name.replace(".", "/") + ".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    about = folder / "lab_filter-1.0.dist-info"
    about.mkdir(exist_ok=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-filter\nVersion: 1.0\n")
    lines = [f"[{group}]\n{line}\n" for group, line in entry_points.items()]
    (about / "entry_points.txt").write_text("\n".join(lines))
    return folder


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A filter in a package of its own, which needs a module beside it."""
    folder = tmp_path / "project"
    modules = {"lab_filter.__init__": "", "lab_filter.slam": FILTER, "lab_filter.tuning": TUNING}
    modules |= {"lab_filter.unused": "x = 1\n", "lab_numbers": "FACTOR = 1.0\n", "bystander": "x = 1\n"}
    install(folder, {"stereo_slam.filters": "lab = lab_filter.slam:LabFilter"}, **modules)
    monkeypatch.syspath_prepend(str(folder))
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] in ("lab_filter", "lab_numbers", "bystander")]:
        del sys.modules[name]


def edit(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def counts(digest, path, old, new):
    """Whether there is a digest, and an edited file changes it."""
    before = digest()
    assert before is not None
    edit(path, old, new)
    return digest() != before


LAB = FilterChoice("lab", "lab")


def of_lab():
    return digest_of_choice(LAB)


# ---- the command ----------------------------------------------------------------------------------------------------


def in_process(project, *arguments):
    """What Python says to these arguments, in a process of its own in which the project is installed."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(project)]), "COLUMNS": "200"}
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, env=environment, timeout=240, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def bench(project, out):
    """The summary of a run without a report, which would take three times as long."""
    scenario = project.parent / "lab.toml"
    scenario.write_text(SCENARIO)
    run = "from stereo_slam_env.benchmark import run_benchmark"
    in_process(project, "-c", f"{run}; run_benchmark({str(scenario)!r}, {str(out)!r}, jobs=1)")
    return json.loads((out / "summary.json").read_text())["filters"]


def test_a_filter_that_now_raises_does_not_return_its_old_result(project, tmp_path):
    """In the same folder; only its own trial is run again, and `report` says that its code differs."""
    before = bench(project, tmp_path / "a")
    assert before["lab"]["failures"] == []
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    of_ours = tmp_path / "b" / "trials" / "seed-0000" / "inverse-depth.npz"
    written = of_ours.stat().st_mtime_ns
    raising = 'raise RuntimeError("edited")\n        super().predict(dt'
    edit(project / "lab_filter" / "slam.py", "super().predict(dt", raising)
    after = bench(project, tmp_path / "b")
    assert after["lab"]["failures"] == ["seed 0, frame 1: RuntimeError: edited"]
    assert of_ours.stat().st_mtime_ns == written
    said = in_process(project, "-m", "stereo_slam_env", "report", str(tmp_path / "a"), str(tmp_path / "b"))
    assert re.search(r"The code of lab differs\s+between\s+the\s+two\s+runs", said)
    assert "The code of stereo-slam-env differs" not in said
    edit(tmp_path / "b" / "settings.json", f'"code": "{code_digest()}"', '"code": "another"')
    warnings = compare(tmp_path / "a", tmp_path / "b").warnings
    assert f"The code of stereo-slam-env ({code_digest()} and another) differs between the two runs." in warnings


# ---- a project ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("lab_filter/slam.py", "scaled(noise)", "noise"),
        ("lab_filter/tuning.py", "FACTOR * noise.R", "2 * FACTOR * noise.R"),
        ("lab_filter/unused.py", "x = 1", "x = 2"),
        ("lab_numbers.py", "FACTOR = 1.0", "FACTOR = 2.0"),
    ],
)
def test_the_package_of_a_filter_counts_and_what_it_imports_from_beside_it(project, file, old, new):
    assert counts(of_lab, project / file, old, new)


def test_what_it_does_not_import_makes_no_difference_and_an_import_within_a_line_does(project):
    assert not counts(of_lab, project / "bystander.py", "x = 1", "x = 2")
    with (project / "lab_filter" / "slam.py").open("a") as stream:
        stream.write("\nif True: x = 1; import bystander\n")
    assert counts(of_lab, project / "bystander.py", "x = 2", "x = 3")


def test_a_filter_that_cannot_be_loaded_is_another_one_as_soon_as_it_can(project):
    """Also where the reason is not in its own code."""
    working = of_lab()
    (project / "lab_numbers.py").rename(project / "elsewhere.py")
    broken = of_lab()
    (project / "elsewhere.py").rename(project / "lab_numbers.py")
    for name in ("lab_numbers", "lab_filter.tuning", "lab_filter.slam"):
        sys.modules.pop(name, None)
    importlib.invalidate_caches()
    assert len({working, broken, None}) == 3
    assert digest_of_choice(LAB) == working


def test_a_broken_file_counts_too(project):
    edit(project / "lab_filter" / "unused.py", "x = 1", "x = (")
    assert counts(of_lab, project / "lab_filter" / "unused.py", "x = (", "x = ((")


def test_ours_have_no_code_of_their_own():
    sweep = FilterChoice("sweep", "inverse-depth", policy=PolicyChoice("sweep", "sweep"))
    for choice in (FilterChoice("a", "inverse-depth"), FilterChoice("b", "dead-reckoning"), sweep):
        assert digest_of_choice(choice) is None
    assert plugin_digest(InverseDepthStereoEKF) is None
    assert digest_of_source(ReferenceSource("short_turn")) is None


# ---- whatever a scenario names --------------------------------------------------------------------------------------


PART = """class Part:
    \"\"\"A part.\"\"\"
    LEVEL = 1.0
"""
NAMED = {
    **{f"stereo_slam.{slot}": {slot: "mine"} for slot in ("landmarks", "measurements", "motions", "errors", "updates")},
    "stereo_slam.filters": {"of": {"filter": "mine"}},
    "stereo_slam.policies": {"list": [1, {"deep": ["mine"]}]},
}


@pytest.fixture
def named(tmp_path, monkeypatch):
    """A package that is named by an entry point of any group, and can be named with its module."""

    def installed(group):
        install(tmp_path / "site", {group: "mine = lab_filter.part:Part"}, **{"lab_filter.part": PART})
        monkeypatch.syspath_prepend(str(tmp_path / "site"))
        return tmp_path / "site" / "lab_filter" / "part.py"

    yield installed
    for name in [name for name in sys.modules if name.partition(".")[0] == "lab_filter"]:
        del sys.modules[name]


@pytest.mark.parametrize("group", NAMED)
def test_a_part_that_an_option_names_counts(named, group):
    file, choice = named(group), FilterChoice("a", "inverse-depth", NAMED[group])
    assert counts(lambda: digest_of_choice(choice), file, "1.0", "2.0")
    of_policy = FilterChoice("a", "inverse-depth", policy=PolicyChoice("sweep", "sweep", NAMED[group]))
    assert digest_of_choice(of_policy) is not None
    assert digest_of_choice(FilterChoice("a", "inverse-depth", {"landmark": "euclidean"})) is None


@pytest.mark.parametrize(
    ("group", "options", "corruptions"),
    [
        ("stereo_slam.front_ends", {"front_end": {"name": "mine"}}, ()),
        ("stereo_slam.sources", {"of": "mine"}, ()),
        ("stereo_slam.anything", {}, ({"kind": "mine"},)),
        ("stereo_slam.recordings", {}, ()),
        ("stereo_slam.scenes", {}, ()),
    ],
)
def test_what_makes_a_recording_counts(named, group, options, corruptions):
    file, source = named(group), FactorySource("os:getcwd", options)
    assert counts(lambda: digest_of_source(source, corruptions), file, "1.0", "2.0")


@pytest.mark.parametrize("text", ["lab_filter.part:Part", "lab_filter:Env-v0"])
def test_a_module_that_is_named_counts_and_is_not_imported(named, text):
    file = named("other.group")
    edit(file, "class", "raise SystemExit(3)\n\n\nclass")
    choice = FilterChoice("a", "inverse-depth", {"of": {"call": text}})
    assert counts(lambda: digest_of_choice(choice), file, "1.0", "2.0")
    assert counts(lambda: digest_of_source(FactorySource(text)), file, "2.0", "3.0")
    deep = FactorySource("os:getcwd", {"deep": [text]})
    assert counts(lambda: digest_of_source(deep), file, "3.0", "4.0")


def test_a_registered_environment_counts(named):
    import gymnasium

    file = named("other.group")
    gymnasium.register("Lab/Mine-v0", "lab_filter.part:Part")
    try:
        source = FactorySource("os:getcwd", {"environment": "Lab/Mine-v0"})
        assert counts(lambda: digest_of_source(source), file, "1.0", "2.0")
    finally:
        del gymnasium.registry["Lab/Mine-v0"]


def test_an_edited_part_and_front_end_leave_no_result_in_the_folder(named, tmp_path):
    filters = (FilterChoice("a", "inverse-depth", {"landmark": "mine"}),)
    scenario = Scenario("one", FactorySource("os:getcwd", {"front_end": "mine"}), filters)
    file = named("stereo_slam.landmarks")
    directory = RunDirectory(tmp_path / "run", Study.of(scenario).cells[0], tmp_path / "run")
    plugins = dict(directory._plugins)
    edit(file, "1.0", "2.0")
    directory = RunDirectory(tmp_path / "run", Study.of(scenario).cells[0], tmp_path / "run")
    assert directory._plugins["a"] != plugins["a"]
    assert directory._plugins[None] != plugins[None]


# ---- other places of code --------------------------------------------------------------------------------------------


def test_a_script_counts_with_what_it_imports(tmp_path, monkeypatch):
    (tmp_path / "lone_filter.py").write_text(
        "import lone_math\n\n\ndef make(camera, noise):\n    return lone_math.f()\n"
    )
    (tmp_path / "lone_math.py").write_text("def f():\n    return 1\n")
    (tmp_path / "lone_other.py").write_text("x = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    make = importlib.import_module("lone_filter").make
    assert counts(lambda: plugin_digest(make), tmp_path / "lone_math.py", "return 1", "return 2")
    assert counts(lambda: plugin_digest(make), tmp_path / "lone_filter.py", "lone_math.f()", "2 * lone_math.f()")
    digest = plugin_digest(make)
    edit(tmp_path / "lone_other.py", "x = 1", "x = 2")
    assert plugin_digest(partial(make, camera=None)) == digest


def test_a_base_class_of_another_project_counts(project, tmp_path, monkeypatch):
    (tmp_path / "heirs.py").write_text("from lab_filter.slam import LabFilter\n\n\nclass Heir(LabFilter):\n    pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    heir = importlib.import_module("heirs").Heir
    assert counts(lambda: plugin_digest(heir), project / "lab_numbers.py", "FACTOR = 1.0", "FACTOR = 2.0")


def test_an_installed_distribution_counts_with_its_data(project, monkeypatch):
    """Its record has the digests of all its files, weights included."""
    monkeypatch.setattr("stereo_slam_env.benchmark.storage.code_identity._INSTALLED", (project.resolve(),))
    record = project / "lab_filter-1.0.dist-info" / "RECORD"
    record.write_text("lab_filter/weights.bin,sha256=aaa,3\n")
    assert counts(of_lab, record, "aaa", "bbb")
    assert counts(of_lab, project / "lab_filter" / "slam.py", "scaled(noise)", "noise")  # by hand, where it lies
    assert counts(of_lab, record.with_name("METADATA"), "Version: 1.0", "Version: 1.1")


NOTEBOOK = """
from filters import InverseDepthStereoEKF

SIGMA = 1.0

def scaled(noise):
    return SIGMA * noise.R

class Mine(InverseDepthStereoEKF):
    gain = 0.5

    @property
    def state_size(self):
        return [scaled(x) for x in (1, 2)]
"""


def from_notebook(text):
    """The class of a module that has no file."""
    module = types.ModuleType("notebook_cells")
    exec(compile(text, "<cell 1>", "exec"), vars(module))
    return module.Mine


@pytest.mark.parametrize(
    ("old", "new"),
    [("SIGMA = 1.0", "SIGMA = 2.0"), ("noise.R", "noise.R + 1"), ("gain = 0.5", "gain = 0.6"), ("(1, 2)", "(1, 3)")],
)
def test_a_class_of_a_notebook_counts_with_what_it_refers_to(old, new):
    before = plugin_digest(from_notebook(NOTEBOOK))
    assert before is not None
    assert plugin_digest(from_notebook(NOTEBOOK)) == before
    assert plugin_digest(from_notebook(f"# a remark\n\n{NOTEBOOK}")) == before
    assert old in NOTEBOOK
    assert plugin_digest(from_notebook(NOTEBOOK.replace(old, new))) != before


def test_a_class_of_a_notebook_has_the_same_digest_in_every_process():
    code = (
        "import types; from stereo_slam_env.benchmark.storage.code_identity import plugin_digest; "
        f"exec(compile({NOTEBOOK!r}, '<cell 1>', 'exec')); print(plugin_digest(Mine))"
    )
    said = set()
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": seed}
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=120
        )
        said.add(done.stdout or done.stderr)
    assert len(said) == 1
    assert re.fullmatch(r"[0-9a-f]{16}\n", said.pop())


def test_a_function_that_makes_recordings_counts(tmp_path, monkeypatch):
    (tmp_path / "lone_source.py").write_text("raise SystemExit(3)\n\ndef make(seed):\n    return seed\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    source = FactorySource("lone_source:make")
    assert counts(lambda: digest_of_source(source), tmp_path / "lone_source.py", "return seed", "return seed + 1")
