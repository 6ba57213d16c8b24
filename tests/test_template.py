"""The template of a filter package, used as its README says: installed, checked, compared (about 15 s)."""

import json
import re
import shutil
import sysconfig
from pathlib import Path

import pytest

from filters.checks.conformance import CHECKS

from .newcomer import install, make_environment, run

ROOT = Path(__file__).resolve().parent.parent
TEMPLATE = ROOT / "templates" / "filter-package"
pytest.importorskip("setuptools", minversion="77", reason="needs the extra dev")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """An environment with the package made from the template; this checkout and the dependencies are lent to it."""
    home = tmp_path_factory.mktemp("installed")
    make_environment(home, lent=(ROOT, sysconfig.get_path("purelib")))
    source = shutil.copytree(TEMPLATE, home / "source", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    install(home, source, "--no-build-isolation")
    return home


def slam(home, *arguments):
    """The command `stereo-slam` of that environment."""
    return run(home / "bin" / "python", "-m", "stereo_slam_env", *arguments, cwd=home)


def test_the_filter_is_known_by_its_entry_point(home):
    assert "my-filter" in slam(home, "filters", "list")


def test_it_keeps_the_contract(home):
    assert "failed" not in slam(home, "filters", "check", "my-filter").replace("0 failed", "")


def test_a_benchmark_has_a_row_for_it(home, tmp_path):
    names = ("--filters", "inverse-depth,my-filter")
    study = ("--preset", "reference-turn", "--seeds", 1, "--frames", 6, "--jobs", 1)
    slam(home, "bench", *study, *names, "--out", tmp_path / "out")
    filters = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))["filters"]
    assert set(filters) == {"inverse-depth", "my-filter"}
    assert filters["my-filter"]["diverged"] == 0
    assert filters["my-filter"]["position_rmse_m"] < 0.2


def test_its_own_tests_pass(home):
    """All but the comparison, which takes twenty drives: that of `examples/test_my_filter.py` is the same."""
    command = (home / "bin" / "python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "not papers")
    printed = run(*command, home / "source" / "tests", cwd=home)
    assert f"{len(CHECKS) + 1} passed, 1 deselected" in printed


def test_it_asks_for_this_version():
    (version,) = re.findall(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    major, minor, _ = map(int, version.split("."))
    wanted = f'"stereo-slam-env>={major}.{minor},<{major + 1}"'
    assert wanted in (TEMPLATE / "pyproject.toml").read_text(encoding="utf-8")
