"""Which changes of the code make kept results void, and what it costs to know (5 s)."""

import os
import shutil
import subprocess
import sys
from functools import partial

import pytest

from stereo_slam_env.benchmark.storage import store
from stereo_slam_env.benchmark.storage.code_identity import ROOT, code_digest

from .test_store import fill

KERNELS = "filters/kernels/gating.py"


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """Both packages, without what Python keeps."""
    root = tmp_path_factory.mktemp("known")
    for package in ("filters", "stereo_slam_env"):
        shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
    return root


@pytest.fixture
def copy(known, tmp_path):
    """Both packages, to be edited."""
    return shutil.copytree(known, tmp_path / "copy")


def digest(root):
    return code_digest.__wrapped__(root)


def edit(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_a_copy_elsewhere_is_the_same_code(copy):
    assert digest(copy) == code_digest()


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("stereo_slam_env/world/physics.py", "_SURFACE_GAP = 0.05", "_SURFACE_GAP = 0.06"),
        ("filters/catalogue/presets.py", '="shared-anchor"', '="inverse-depth"'),
        (KERNELS, '"""', '"""Edited. '),
        ("stereo_slam_env/report/page.css", "{", "{ "),
        ("stereo_slam_env/viewer/watched_drive.py", '"""', '"""Edited. '),
        ("stereo_slam_env/benchmark/campaign.py", '"""', '"""Edited. '),
    ],
)
def test_whatever_is_edited_changes_it(copy, file, old, new):
    """There is no list of what "makes no result": such a list can only be wrong in favour of a stale one."""
    before = digest(copy)
    edit(copy / file, old, new)
    assert digest(copy) != before


def test_a_new_module_and_a_trained_network_count(copy):
    digests = [digest(copy)]
    (copy / "filters" / "another.py").write_text("x = 1\n")
    digests.append(digest(copy))
    (network,) = (copy / "stereo_slam_env").rglob("*.npz")
    network.write_bytes(network.read_bytes() + b"\0")
    assert len({*digests, digest(copy)}) == 3


def test_what_python_and_editors_keep_does_not_count(copy):
    before = digest(copy)
    for name in ("__pycache__/frame.cpython-311.pyc", "engine/__pycache__/frame.nbi", ".frame.py.swp"):
        path = copy / "filters" / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"x")
    assert digest(copy) == before


def test_a_run_is_kept_as_long_as_its_code_is(copy, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "code_digest", partial(digest, copy))
    finished = fill(tmp_path / "out")
    assert finished.missing() == []
    edit(copy / "stereo_slam_env/world/physics.py", "_SURFACE_GAP = 0.05", "_SURFACE_GAP = 0.06")
    assert len(finished.missing()) == 2


def test_a_run_reads_the_code_once_and_its_workers_never(copy, tmp_path):
    counted = tmp_path / "counted.txt"
    (tmp_path / "sitecustomize.py").write_text(
        "import os, pathlib\n"
        "read = pathlib.Path.read_bytes\n"
        "def counting(path):\n"
        "    if path.name == 'page.css':\n"
        f"        with open({str(counted)!r}, 'a') as file:\n"
        "            file.write(f'{os.getpid()}\\n')\n"
        "    return read(path)\n"
        "pathlib.Path.read_bytes = counting\n"
    )
    (tmp_path / "run.py").write_text(
        "from stereo_slam_env.benchmark import Scenario, run_benchmark\n"
        "from stereo_slam_env.benchmark.recordings.sources import ReferenceSource\n"
        "if __name__ == '__main__':\n"
        "    scenario = Scenario('small', ReferenceSource('short_turn'), frames=4, seeds=(0, 1), metrics=())\n"
        f"    run_benchmark(scenario, {str(tmp_path / 'out')!r}, filters=['dead-reckoning'], jobs=2)\n"
    )
    paths = {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(copy)]), "PYTHONDONTWRITEBYTECODE": "1"}
    environment = {**os.environ, **paths, "NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, str(tmp_path / "run.py")], env=environment, timeout=240, check=True)
    assert len(counted.read_text().split()) == 1
