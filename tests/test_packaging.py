"""What a user installs: the archives hold what they should, and the wheel works on its own (about 45 s)."""

import json
import re
import shutil
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from .newcomer import install, make_environment, run

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("filters", "stereo_slam_env")
ALONGSIDE = ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md")
pytest.importorskip("build", reason="needs the extra dev")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Both archives, the wheel made of the source archive, from a copy: nothing of an earlier build is in them."""
    source = tmp_path_factory.mktemp("source")
    for folder in (*PACKAGES, "examples", "templates"):
        shutil.copytree(ROOT / folder, source / folder, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    for name in ALONGSIDE:
        shutil.copy(ROOT / name, source)
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", "dist", cwd=source)
    return source / "dist"


@pytest.fixture(scope="module")
def wheel(built):
    """The wheel."""
    (wheel,) = built.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def home(wheel, tmp_path_factory):
    """An empty environment with the wheel; only the dependencies are lent by the environment of the tests."""
    home = tmp_path_factory.mktemp("installed")
    make_environment(home, lent=[sysconfig.get_path("purelib")])
    install(home, wheel)
    return home


def test_the_wheel_holds_both_packages_whole_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        packed = {name for name in archive.namelist() if ".dist-info/" not in name}
    data = {".py", ".pyi", ".typed", ".json", ".html", ".jinja", ".css", ".js", ".toml", ".npz", ".csv"}
    wanted = {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.suffix in data and "__pycache__" not in path.parts
    }
    assert packed == wanted
    assert {"filters/py.typed", "stereo_slam_env/py.typed", "stereo_slam_env/report/page.html"} <= packed


def test_the_source_archive_holds_what_belongs_to_it(built):
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert set(ALONGSIDE) <= names
    assert "examples/write_a_filter.py" in names
    assert "templates/filter-package/src/my_slam_filter/my_filter.py" in names


def test_an_index_would_take_the_archives(built):
    pytest.importorskip("twine", reason="needs the extra dev")
    printed = run(sys.executable, "-m", "twine", "check", "--strict", *built.iterdir(), cwd=built)
    assert printed.count("PASSED") == 2


def test_the_citation_names_this_version():
    (version,) = re.findall(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n## {version} " in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_wheel_names_its_licence_and_its_command(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (archive.read(name).decode() for name in names if name.endswith(".dist-info/METADATA"))
        (commands,) = (archive.read(name).decode() for name in names if name.endswith("entry_points.txt"))
    assert "License-Expression: MIT" in metadata
    assert any(name.endswith("/licenses/LICENSE") for name in names)
    assert "stereo-slam = stereo_slam_env.__main__:main" in commands


MACHINES = {
    "Linux x86-64": {"sys_platform": "linux", "platform_machine": "x86_64"},
    "Linux ARM": {"sys_platform": "linux", "platform_machine": "aarch64"},
    "macOS ARM": {"sys_platform": "darwin", "platform_machine": "arm64"},
    "macOS Intel": {"sys_platform": "darwin", "platform_machine": "x86_64"},
    "Windows": {"sys_platform": "win32", "platform_machine": "AMD64"},
}


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13", "3.14"])
def test_pybullet_is_required_once_wherever_there_is_a_wheel(wheel, version, machine):
    """Both distributions own the module, so never both; nothing is built from source."""
    with zipfile.ZipFile(wheel) as archive:
        (metadata,) = (archive.read(name).decode() for name in archive.namelist() if name.endswith("/METADATA"))
    required = map(Requirement, re.findall(r"^Requires-Dist: (pybullet.*)$", metadata, re.MULTILINE))
    here = {"python_version": version, **MACHINES[machine]}
    own = machine == "Linux x86-64" and version == "3.11"
    no_wheel = machine == "Linux ARM" or version == "3.14" or (machine == "macOS Intel" and version == "3.13")
    expected = [] if no_wheel else ["pybullet" if own else "pybullet-arm64"]
    assert [r.name for r in required if r.marker.evaluate(here)] == expected


def test_the_installed_packages_are_those_of_the_wheel(home, tmp_path):
    show = "import filters, stereo_slam_env as env; print(filters.__file__); print(env.__file__)"
    for line in run(home / "bin" / "python", "-c", show, cwd=tmp_path).split():
        assert Path(line).is_relative_to(home)


def test_the_command_answers(home, tmp_path):
    assert "bench" in run(home / "bin" / "stereo-slam", "--help", cwd=tmp_path)
    assert "inverse-depth" in run(home / "bin" / "stereo-slam", "filters", "list", cwd=tmp_path)


@pytest.mark.timeout(900)  # all machine code is made here, by one process: three minutes on an idle core
def test_the_main_job_runs_from_the_wheel(home, tmp_path):
    command = (home / "bin" / "stereo-slam", "bench", "--preset", "turn", "--seeds", 1, "--frames", 6)
    printed = run(*command, "--jobs", 1, "--out", tmp_path / "out", cwd=tmp_path)
    assert "report" in printed
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert "inverse-depth" in json.dumps(summary)
