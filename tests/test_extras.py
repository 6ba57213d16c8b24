"""How to install what an option needs: every hint leaves the installation as it is (20 s)."""

import re
import shlex
import shutil
import sys
import sysconfig
import tomllib
from pathlib import Path

import pytest

from filters.contract.extras import DISTRIBUTION, install_command

from .newcomer import install, make_environment, run

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
READ = [
    path
    for folder in (".", "docs", "examples", "fuzz", "templates", "filters", "stereo_slam_env", "benchmarks")
    for path in ((ROOT / folder).rglob("*") if folder != "." else ROOT.glob("*.md"))
    if path.suffix in (".md", ".py", ".html", ".js")
]
COMMAND = re.compile(r"(?:install_command\(|require_module\(['\"]\w+['\"], )['\"](\w+)['\"]\)")
HINT = re.compile(r"(?:pip install|PIP\))[^\n`]*\[[a-z,]+\][^\n`]{,2}")
KEEPS = re.compile(rf'pip install "{DISTRIBUTION}\[([a-z]+)\]"|pip install --editable ')


def test_every_hint_names_an_extra_of_the_installed_distribution():
    """A path, as in `pip install ".[gl]"`, would put a copy in the place of an editable installation."""
    hints = {hint: path for path in READ for hint in HINT.findall(path.read_text(encoding="utf-8"))}
    assert len(hints) > 5
    extras = PROJECT["optional-dependencies"]
    for hint, path in hints.items():
        keeps = KEEPS.match(hint)
        assert keeps, f"{path}: {hint}"
        assert keeps[1] is None or keeps[1] in extras, f"{path}: {hint}"


def test_every_message_has_the_command_from_one_place():
    ours = [path for path in READ if path.suffix == ".py" and path.relative_to(ROOT).parts[0] in PROJECT_PACKAGES]
    messages = {path.name: COMMAND.findall(path.read_text(encoding="utf-8")) for path in ours}
    named = [extra for found in messages.values() for extra in found]
    assert len(named) >= 6
    assert set(named) <= set(PROJECT["optional-dependencies"])
    assert [path.name for path in ours if re.search(r"pip install[^\n]*\[", path.read_text())] == ["extras.py"]


PROJECT_PACKAGES = ("filters", "stereo_slam_env")


def test_the_distribution_is_ours():
    assert PROJECT["name"] == DISTRIBUTION


@pytest.mark.slow
def test_the_command_leaves_an_editable_installation_editable(tmp_path):
    source, home = tmp_path / "source", tmp_path / "home"
    for package in PROJECT_PACKAGES:
        shutil.copytree(ROOT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    make_environment(home, lent=[sysconfig.get_path("purelib")])
    install(home, source, "--no-build-isolation", "--editable")
    python = home / "bin" / "python"

    ask = "from filters.contract.extras import install_command as c; print(c('gl'))"
    command = run(python, "-c", ask, cwd=tmp_path)
    printed = run(*shlex.split(command), "--no-index", cwd=source)  # in the checkout: where people stand
    assert f"Requirement already satisfied: {DISTRIBUTION}[gl]" in printed
    for package in PROJECT_PACKAGES:
        found = run(python, "-c", f"import {package}; print({package}.__file__)", cwd=tmp_path)
        assert Path(found.strip()) == source / package / "__init__.py"


def test_the_command_is_for_the_python_that_runs():
    assert install_command("gl") == f'{sys.executable} -m pip install "stereo-slam-env[gl]"'
