"""Machine code that is kept on disk is that of the present sources, in every process (2 min)."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
POINTS = """
import json, multiprocessing, sys
import numpy as np

def seen():
    from filters.engine.compiled.readout import relative_landmarks
    x = np.zeros((1, 13)); x[0, 6] = 1.0
    own, none = np.zeros((1, 1), dtype=np.int64), np.full((1, 1), -1)
    p_c, P_c, located = np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros(1, dtype=np.bool_)
    counts, offsets = np.array([[1, 1]]), np.array([0, 1])
    blocks = np.array([[[2.0, 3.0, 10.0]]])
    relative_landmarks(np.eye(15)[None], x, blocks, own, none, counts, 12, False, offsets, p_c, P_c, located)
    return p_c[0].tolist(), sum(relative_landmarks.stats.cache_hits.values())

if __name__ == "__main__":
    if sys.argv[1] == "here":
        told = seen()
    else:
        with multiprocessing.get_context(sys.argv[1]).Pool(1) as pool:
            told = pool.apply(seen)
    print(json.dumps(told))
"""


@pytest.fixture
def copy(tmp_path):
    """The filters elsewhere, without machine code, and a program that asks a kernel where a landmark is."""
    shutil.copytree(ROOT / "filters", tmp_path / "filters", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "points.py").write_text(POINTS)
    return tmp_path


def start(copy, process="here"):
    environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA")}
    environment |= {"PYTHONPATH": str(copy), "XDG_CACHE_HOME": str(copy / "home")}
    program = [sys.executable, "points.py", process]
    return subprocess.Popen(program, cwd=copy, env=environment, text=True, stdout=subprocess.PIPE)


def result(process):
    """p_c of the landmark, and how often its kernel came from the disk."""
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    return json.loads(out)


def edit_leaf(copy):
    """Another first component of the product that the kernel calls, in another module than its own."""
    (leaf,) = (path for path in copy.rglob("*.py") if "\ndef times(" in path.read_text())
    old = "return a[0] * x + a[1] * y + a[2] * z,"
    assert old in leaf.read_text()
    leaf.write_text(leaf.read_text().replace(old, "return 1.5 * (a[0] * x + a[1] * y + a[2] * z),", 1))


def kept(copy):
    """Files of the kernel's machine code: an index and one of code for each version."""
    return [path for path in copy.rglob("*.nb[ic]") if "relative_landmarks" in path.name]


@pytest.mark.parametrize("process", ["here", "spawn", "forkserver"])
def test_a_change_in_a_module_that_the_kernel_reaches_takes_effect(copy, process):
    assert result(start(copy)) == [[2.0, 3.0, 10.0], 0]
    edit_leaf(copy)
    assert result(start(copy, process)) == [[3.0, 3.0, 10.0], 0]


def test_what_did_not_change_comes_from_the_disk_and_old_code_leaves_it(copy):
    result(start(copy))
    assert result(start(copy)) == [[2.0, 3.0, 10.0], 1]
    before = kept(copy)
    edit_leaf(copy)
    result(start(copy))
    after = kept(copy)
    assert len(after) == len(before) == 2
    assert not set(after) & set(before)


def test_an_edit_elsewhere_compiles_nothing(copy):
    result(start(copy))
    (copy / "filters" / "catalogue" / "registry.py").write_text("")
    assert result(start(copy)) == [[2.0, 3.0, 10.0], 1]


def test_two_processes_at_once(copy):
    both = [start(copy), start(copy)]
    assert [result(process) for process in both] == [[[2.0, 3.0, 10.0], 0]] * 2
    assert result(start(copy)) == [[2.0, 3.0, 10.0], 1]


def test_where_the_package_cannot_be_written_to_the_cache_of_the_user_is_taken(copy):
    for folder in {path.parent for path in copy.glob("filters/**/*.py")}:
        (folder / "__pycache__").write_text("no folder")
    result(start(copy))
    edit_leaf(copy)
    assert result(start(copy)) == [[3.0, 3.0, 10.0], 0]
    assert {path.relative_to(copy).parts[0] for path in kept(copy)} == {"home"}


FIRST_ESTIMATE = """
from filters import StereoCamera, StereoNoise, StereoObservation, make_filter
camera = StereoCamera(721.5, 721.5, 672.0, 195.0, 0.571, 1344, 391)
slam = make_filter("inverse-depth", camera=camera, noise=StereoNoise.independent_pixels(1.0))
for u in (300.0, 301.0):
    slam.predict(0.1)
    slam.update(StereoObservation([1], [[u, 150.0, 20.0]]))
"""


def test_the_first_filter_compiles_what_it_needs_and_says_so_once(copy):
    environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA")}
    environment |= {"PYTHONPATH": str(copy)}
    program = [sys.executable, "-c", FIRST_ESTIMATE]
    first, second = (
        subprocess.run(program, cwd=copy, env=environment, text=True, capture_output=True, check=True, timeout=240)
        for _ in range(2)
    )
    assert first.stderr.count("compiling machine code") == len(first.stderr.splitlines()) == 1
    assert second.stderr == ""
    compiled = {path.name.partition(".")[2].partition("-")[0] for path in copy.rglob("*.nbi")}
    assert compiled == {
        "advance",
        "predict",
        "linearise_unit",
        "squared_distances",
        "correct",
        "retract",
        "enter",
    }
