"""The shape of the tree, as the design has it (< 1 s); the order of the rooms is checked by `make lint`."""

import ast
import re
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("filters", "stereo_slam_env")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
WORLD_SIDE = ("world", "rendering", "sensing", "simulator", "envs")
WITH_A_FILTER = {f"stereo_slam_env/envs/{name}.py" for name in ("filter_rows", "belief_observation", "belief_panorama")}
"""Wrappers that put a filter into the loop."""

MAX_LINES = 400
LONGER_FOR_A_REASON = {
    "filters/checks/conformance.py": "the contract of a filter as one list of checks, read from top to bottom",
    "filters/checks/part_checks.py": "the contracts of all kinds of parts as lists of checks",
    "stereo_slam_env/evaluation/figures.py": "the one table of figures, an entry each",
}


def name_of(path):
    return path.relative_to(ROOT).as_posix()


@cache
def imports(path):
    """Absolute names of all modules that a file imports, wherever in the file."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = list(package[: len(package) - node.level + 1]) if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {f"{module}.{alias.name}" for alias in node.names}
    return frozenset(found)


def imported_under(path, *prefixes):
    return sorted(name for name in imports(path) if any(f"{name}.".startswith(f"{p}.") for p in prefixes))


def modules_of(*folders):
    return [path for path in MODULES if any(name_of(path).startswith(f"{folder}/") for folder in folders)]


def test_the_packages_are_found():
    assert len(MODULES) > 30


@pytest.mark.parametrize("path", modules_of("filters"), ids=name_of)
def test_filters_know_only_numpy_and_scipy(path):
    allowed = {*sys.stdlib_module_names, "filters", "numpy", "scipy", "filterpy", "lazy_loader", "threadpoolctl"}
    if name_of(path).startswith("filters/kernels/"):  # imported on demand only
        allowed |= {"numba", "llvmlite"}
    if name_of(path) == "filters/checks/pytest_cases.py":  # for tests, imported when called
        allowed |= {"pytest"}
    assert {name.split(".")[0] for name in imports(path)} <= allowed


def test_only_physics_knows_pybullet():
    users = [name_of(path) for path in MODULES if imported_under(path, "pybullet", "pybullet_data", "pybullet_utils")]
    assert users == ["stereo_slam_env/world/physics.py"]


@pytest.mark.parametrize(
    "path",
    [
        path
        for path in modules_of(*(f"stereo_slam_env/{part}" for part in WORLD_SIDE))
        if name_of(path) not in WITH_A_FILTER
    ],
    ids=name_of,
)
def test_the_world_knows_no_filter_and_no_evaluation(path):
    evaluation = (f"stereo_slam_env.{part}" for part in ("benchmark", "report", "viewer", "cli"))
    concrete = ("inverse_depth_stereo", "dual_bearing", "euclidean_xyz", "engine", "catalogue", "checks")
    named = ("make_filter", "available_filters", "InverseDepthStereoEKF", "DualBearingEKF", "EuclideanEKF")
    forbidden = (*evaluation, *(f"filters.{part}" for part in (*concrete, *named)))
    # how machine code is made and kept, no estimation
    kept = {f"filters.kernels.compilation.{name}" for name in ("entry", "kernel")}
    assert [name for name in imported_under(path, *forbidden) if name not in kept] == []


def test_machine_code_is_kept_on_disk_with_the_digest_of_its_sources_only():
    users = [name_of(path) for path in MODULES if re.search(r'cache=True|"cache": _?[a-zT]', path.read_text("utf-8"))]
    assert users == ["filters/kernels/compilation.py"]


@pytest.mark.parametrize("path", modules_of("stereo_slam_env/report", "stereo_slam_env/viewer"), ids=name_of)
def test_figures_never_touch_the_global_state_of_pyplot(path):
    assert imported_under(path, "matplotlib.pyplot", "pylab") == []


def test_no_module_is_a_drawer_of_odds_and_ends():
    vague = {"utils", "util", "helpers", "helper", "common", "misc", "tools"}
    assert [name_of(path) for path in MODULES if vague & {path.stem, *path.parts}] == []


def test_a_file_name_is_used_once():
    """So that a name says which file is meant."""
    stems = Counter(path.stem for path in MODULES if not path.stem.startswith("__"))
    assert [stem for stem, count in stems.items() if count > 1] == []


def test_long_files_have_a_reason():
    long = {name_of(path) for path in MODULES if len(path.read_text(encoding="utf-8").splitlines()) > MAX_LINES}
    assert long == set(LONGER_FOR_A_REASON)


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_documentation_is_never_a_single_word(path):
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    texts = [node.value for node in nodes if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)]
    assert [f"line {text.lineno}" for text in texts if isinstance(text.value, str) and " " not in text.value] == []


MESSAGES_OF_LIBRARIES = {
    ("filters/catalogue/registry.py", "multiple values for keyword argument"),
    ("stereo_slam_env/benchmark/recordings/source.py", "Object missing"),
    ("stereo_slam_env/benchmark/recordings/source.py", "Object contains unknown"),
    ("stereo_slam_env/benchmark/recordings/source.py", "Invalid enum value"),
    ("stereo_slam_env/files/bags.py", "CREATE VIRTUAL"),
    ("stereo_slam_env/recording/archive.py", "independent truth"),
    ("stereo_slam_env/recording/archive.py", "odometry from the same images"),
}
"""Phrases that are looked for in what is not ours to change: errors of libraries, SQL, archives of before."""
_SEARCHES = {"startswith", "endswith", "removeprefix", "removesuffix", "find", "index", "replace", "count", "partition"}


def phrases_looked_for(path):
    """Words that a comparison or a search of a text hangs on: phrases, that is letters with a space between."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        sides = []
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") in _SEARCHES:
            sides = node.args
        elif isinstance(node, ast.Call) and getattr(getattr(node.func, "value", None), "id", "") == "re":
            sides = node.args[:1]
        inside = (part for side in sides if not isinstance(side, ast.Call) for part in ast.walk(side))
        texts = (
            part.value.strip() for part in inside if isinstance(part, ast.Constant) and isinstance(part.value, str)
        )
        yield from (text for text in texts if re.fullmatch(r"[A-Za-z]+( [A-Za-z']+)+", text))


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_nothing_decides_on_the_words_of_a_sentence(path):
    """Verdicts are values; sentences are written last. Half a sentence that is compared would tie both together."""
    assert {(name_of(path), phrase) for phrase in phrases_looked_for(path)} <= MESSAGES_OF_LIBRARIES


def test_a_decision_on_words_is_found(tmp_path):
    (tmp_path / "judge.py").write_text('if verdict.startswith("too tight") or re.match("is consistent", text): pass')
    assert list(phrases_looked_for(tmp_path / "judge.py")) == ["too tight", "is consistent"]
