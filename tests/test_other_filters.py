"""Another `filters` than ours on Python's path: one line that names it and says what to do (10 s)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("filters", "stereo_slam_env")
NEEDS = "ImportError: stereo_slam_env needs its own package filters, but Python finds {}: rename that or run from "
NEEDS += "another folder; if pip installed it, pip uninstall filters and install stereo-slam-env again"
USE = "import stereo_slam_env; from filters import make_filter; print(make_filter.__name__)"
COMMAND = "import sys; from stereo_slam_env.cli.app import main; sys.exit(main(['--version']))"


def python(*arguments, folder, path=ROOT):
    """Run Python in a folder with our packages on its path, as an installation has them: last."""
    environment = {**os.environ, "PYTHONPATH": str(path)}
    return subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True)


def last_line(done):
    assert done.returncode == 1, done.stdout
    return done.stderr.splitlines()[-1]


@pytest.fixture
def mine(tmp_path):
    """A folder with a program of the user's own that uses ours, and a file that is in the way."""
    (tmp_path / "program.py").write_text(USE)
    (tmp_path / "filters.py").write_text("raise SystemExit('must not be run')\n")
    return tmp_path


@pytest.mark.parametrize("start", [("-c", USE), ("-m", "program"), ("program.py",)])
def test_a_file_of_ones_own_is_named(mine, start):
    assert last_line(python(*start, folder=mine)) == NEEDS.format(mine / "filters.py")


def test_a_package_and_a_folder_without_code_are_named(tmp_path):
    (tmp_path / "filters").mkdir()
    (tmp_path / "filters" / "__init__.py").touch()
    assert last_line(python("-c", USE, folder=tmp_path)) == NEEDS.format(tmp_path / "filters" / "__init__.py")


def test_the_command_looks_in_its_own_folder_and_not_where_one_stands(mine, tmp_path_factory):
    """The first place of a script is the script's: a file in the folder where one stands is not in the way."""
    command = tmp_path_factory.mktemp("bin") / "stereo-slam"
    command.write_text(COMMAND)
    done = python(command, folder=mine)
    assert (done.returncode, done.stdout[:12]) == (0, "stereo-slam "), done.stderr
    (command.parent / "filters.py").touch()
    assert last_line(python(command, folder=mine)) == NEEDS.format(command.parent / "filters.py")


def test_a_package_that_was_installed_over_ours_is_named(tmp_path):
    site = tmp_path / "site"
    for package in PACKAGES:
        (site / package).mkdir(parents=True)
        for name in ("__init__.py", "interface.py"):
            if (ROOT / package / name).exists():
                (site / package / name).symlink_to(ROOT / package / name)
    theirs = site / "filters" / "__init__.py"
    theirs.unlink()
    theirs.write_text("from .base import *\n")
    (site / "stereo_slam_env" / "__init__.py").unlink()
    text = (ROOT / "stereo_slam_env" / "__init__.py").read_text(encoding="utf-8")
    (site / "stereo_slam_env" / "__init__.py").write_text(text, encoding="utf-8")
    assert last_line(python("-c", USE, folder=tmp_path, path=site)) == NEEDS.format(theirs)
    theirs.unlink()  # pip uninstall filters
    assert last_line(python("-c", USE, folder=tmp_path, path=site)) == NEEDS.format(theirs.parent)


def test_without_another_one_nothing_is_in_the_way(tmp_path):
    done = python("-c", USE, folder=tmp_path)
    assert (done.returncode, done.stdout) == (0, "make_filter\n"), done.stderr
