"""Machine code that is kept on disk is that of the present sources, in every process (1 min)."""

import json
import os
import re
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
    from filters.kernels.entries import relative_landmarks
    x = np.zeros((1, 13)); x[0, 6] = 1.0
    own, none = np.zeros((1, 1), dtype=np.int64), np.full((1, 1), -1)
    p_c, P_c, located = np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros(1, dtype=np.bool_)
    counts, offsets = np.array([[1, 1]]), np.array([0, 1])
    blocks = np.array([[[2.0, 3.0, 10.0]]])
    points, J = np.array([[2.0, 3.0, 10.0, 1.0]]), np.eye(4, 3)[None]
    state = np.eye(15)[None], x, blocks, own, none, counts, 12, False, False
    relative_landmarks(*state, points, J, offsets, p_c, P_c, located)
    return p_c[0].tolist(), sum(relative_landmarks.stats.cache_hits.values())

if __name__ == "__main__":
    if sys.argv[1] == "here":
        told = seen()
    else:
        with multiprocessing.get_context(sys.argv[1]).Pool(1) as pool:
            told = pool.apply(seen)
    print(json.dumps(told))
"""


def environment(*paths):
    """As a user has it: only these folders on the path, a home of its own, no setting of Numba."""
    kept_here = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA")}
    return kept_here | {"PYTHONPATH": os.pathsep.join(map(str, paths)), "XDG_CACHE_HOME": str(paths[0] / "home")}


@pytest.fixture
def copy(tmp_path):
    """The filters elsewhere, without machine code, and a program that asks a kernel where a landmark is."""
    return copied(tmp_path)


def copied(folder):
    shutil.copytree(ROOT / "filters", folder / "filters", ignore=shutil.ignore_patterns("*.nb[ic]"))
    (folder / "points.py").write_text(POINTS)
    return folder


@pytest.fixture(scope="module")
def compiled_once(tmp_path_factory):
    """A copy in which a process has compiled the kernel."""
    folder = copied(tmp_path_factory.mktemp("compiled"))
    assert result(start(folder)) == [[2.0, 3.0, 10.0], 0]
    return folder


@pytest.fixture
def compiled(compiled_once, tmp_path):
    """A copy of one's own, with the machine code of the kernel."""
    return shutil.copytree(compiled_once, tmp_path / "copy")


@pytest.fixture(scope="module")
def first_filter(tmp_path_factory):
    """A copy in which the first filter has been compiled at a terminal, and what was written there."""
    folder = copied(tmp_path_factory.mktemp("first"))
    return folder, shown(folder, FIRST_ESTIMATE, terminal=True)


def start(copy, process="here"):
    program = [sys.executable, "points.py", process]
    return subprocess.Popen(program, cwd=copy, env=environment(copy), text=True, stdout=subprocess.PIPE)


def result(process):
    """p_c of the landmark, and how often its kernel came from the disk."""
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    return json.loads(out)


def edit_leaf(copy):
    """Another first component of the product that the kernel calls, in another module than its own."""
    (leaf,) = (path for path in copy.rglob("*.py") if "\ndef times(" in path.read_text())
    old = "return a[0] * x + a[1] * y + a[2] * z,"
    before = leaf.read_text()
    assert old in before
    leaf.write_text(before.replace(old, "return 1.5 * (a[0] * x + a[1] * y + a[2] * z),", 1))
    return leaf, before


def kept(copy):
    """Files of the kernel's machine code: an index and one of code for each version."""
    return [path for path in copy.rglob("*.nb[ic]") if "relative_landmarks" in path.name]


@pytest.mark.parametrize("process", ["here", "spawn", "forkserver"])
def test_a_change_in_a_module_that_the_kernel_reaches_takes_effect(compiled, process):
    edit_leaf(compiled)
    assert result(start(compiled, process)) == [[3.0, 3.0, 10.0], 0]


STRANGER = """
from dataclasses import dataclass
from filters import ConstantVelocity, StereoCamera, StereoEKF, StereoNoise
from strangers.speed import step

@dataclass(frozen=True)
class Scaled(ConstantVelocity):
    step = step

camera = StereoCamera(721.5, 721.5, 672.0, 195.0, 0.571, 1344, 391)
slam = StereoEKF(camera, StereoNoise.independent_pixels(1.0), motion=Scaled())
slam.predict(1.0)
print(slam.pose.position.tolist())
"""
SPEED = """
from numba import njit

@njit
def far():
    return 2.0

def step(self, x, dt, n):
    return (x.position[0], x.position[1], far() + n[2]), *x[1:]
"""


def test_a_kernel_of_a_third_party_is_that_of_its_present_sources(first_filter, tmp_path):
    """Its package is one of those whose sources the stamp covers, those beside the kernel's file included."""
    copy = shutil.copytree(first_filter[0], tmp_path / "copy")
    (copy / "strangers").mkdir()
    helper, kernel = SPEED.split("def step")
    sources = {"distance": helper, "speed": "from .distance import far\n\n\ndef step" + kernel, "drive": STRANGER}
    for name, text in {"__init__": "", **sources}.items():
        (copy / "strangers" / f"{name}.py").write_text(text)

    def driven() -> str:
        program = [sys.executable, "-m", "strangers.drive"]
        done = subprocess.run(program, cwd=copy, env=environment(copy), text=True, capture_output=True, timeout=240)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert driven() == driven() == "[0.0, 0.0, 2.0]\n"
    assert any(".by_noise." in path.name for path in copy.rglob("*.nbc"))
    (copy / "strangers" / "distance.py").write_text(helper.replace("2.0", "3.0"))
    assert driven() == "[0.0, 0.0, 3.0]\n"


def test_what_did_not_change_comes_from_the_disk_also_after_an_edit_is_undone(compiled):
    assert result(start(compiled)) == [[2.0, 3.0, 10.0], 1]
    (leaf, before), made = edit_leaf(compiled), kept(compiled)
    assert result(start(compiled)) == [[3.0, 3.0, 10.0], 0]
    leaf.write_text(before)
    assert result(start(compiled)) == [[2.0, 3.0, 10.0], 1]
    assert len(kept(compiled)) == 2 * len(made) == 4


def test_an_edit_elsewhere_compiles_nothing(compiled):
    (compiled / "filters" / "catalogue" / "registry.py").write_text("")
    assert result(start(compiled)) == [[2.0, 3.0, 10.0], 1]


def test_two_processes_at_once(copy):
    both = [start(copy), start(copy)]
    assert [result(process) for process in both] == [[[2.0, 3.0, 10.0], 0]] * 2
    assert result(start(copy)) == [[2.0, 3.0, 10.0], 1]


def test_where_the_package_cannot_be_written_to_the_cache_of_the_user_is_taken(copy):
    for folder in {path.parent for path in copy.glob("filters/**/*.py")}:
        shutil.rmtree(folder / "__pycache__", ignore_errors=True)
        (folder / "__pycache__").write_text("no folder")
    result(start(copy))
    edit_leaf(copy)
    assert result(start(copy)) == [[3.0, 3.0, 10.0], 0]
    assert {path.relative_to(copy).parts[0] for path in kept(copy)} == {"home"}


BELIEFS = """
import hashlib, sys
from tests.filters.engine.combinations import combinations, figures, run_case

for case in list(combinations())[::11][:: int(sys.argv[1])]:
    print(case.name, hashlib.sha256(figures(*run_case(case), case.clones).tobytes()).hexdigest())
"""


def beliefs(folder, order=1):
    """What filters of many parts and options believe, to the last bit, by a process that has its machine code there."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(folder)}
    program, limit = [sys.executable, "-c", BELIEFS, str(order)], 280
    ran = subprocess.run(program, cwd=ROOT, env=environment, text=True, capture_output=True, check=True, timeout=limit)
    return dict(line.rsplit(" ", 1) for line in ran.stdout.splitlines()), "compiling machine code" in ran.stderr


@pytest.mark.slow
@pytest.mark.timeout(590)
def test_every_process_has_the_same_bits_whether_it_compiles_or_loads_and_in_any_order(tmp_path):
    compiled, loaded, backwards = (beliefs(tmp_path / place, order) for place, order in (("a", 1), ("a", 1), ("b", -1)))
    assert [compiles for _, compiles in (compiled, loaded, backwards)] == [True, False, True]
    assert len(compiled[0]) > 100
    assert loaded[0] == compiled[0] == backwards[0]


FIRST_ESTIMATE = """
from filters import StereoCamera, StereoNoise, StereoObservation, make_filter
camera = StereoCamera(721.5, 721.5, 672.0, 195.0, 0.571, 1344, 391)
slam = make_filter("inverse-depth", camera=camera, noise=StereoNoise.independent_pixels(1.0))
for u in (300.0, 301.0):
    slam.predict(0.1)
    slam.update(StereoObservation([1], [[u, 150.0, 20.0]]))
"""


COUNTED = """
import logging
from numba import njit
from filters.kernels.compilation import include

@njit
def double(x):
    return 2.0 * x

include("__main__")
{setting}
double(1.0)
"""
IN_TERMINAL = "import pty, sys; sys.exit(pty.spawn(sys.argv[1:]))"
COUNT = re.compile(r"\rcompiling machine code, once: (\d+) functions, \d+ s")


def shown(folder, program, *, terminal=False):
    """What a program writes to stderr, or to the terminal that it is called from, with the filters there or ours."""
    command = [*([sys.executable, "-c", IN_TERMINAL] if terminal else []), sys.executable, "-c", program]
    done = subprocess.run(
        command, cwd=folder, env=environment(folder, ROOT), capture_output=True, stdin=subprocess.DEVNULL, check=True,
        timeout=280,
    )  # fmt: skip
    written = (done.stdout if terminal else done.stderr).decode()
    return written.replace("\r\n", "\n").removesuffix("\x1b[0m")  # colours off: Numba's colorama at the end


def test_at_a_terminal_a_count_shows_while_the_first_filter_compiles_no_more_than_it_needs(first_filter):
    copy, first = first_filter
    second = shown(copy, FIRST_ESTIMATE, terminal=True)
    counts = [int(number) for number in COUNT.findall(first)]
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[-1] > 50
    assert COUNT.sub("", first).replace("\r\x1b[K", "") == ""  # the line goes when it is done
    assert first.endswith("\r\x1b[K")
    assert second == ""
    compiled = {path.name.partition("-")[0].split(".")[-2] for path in copy.rglob("*.nbi")}
    of_the_frame = "run_frames predict linearise squared_distances correct retract initialise augment drop_unseen"
    assert compiled == {*of_the_frame.split(), *["point_kernel", "start_kernel", "predict", "backproject", "by_noise"]}


QUIET = "logging.getLogger('filters').setLevel(logging.ERROR)"
RECORD = "logging.basicConfig(format='%(levelname)s %(name)s %(message)s')"
BACKGROUND = "import subprocess, sys; subprocess.run([sys.executable, '-c', {!r}], start_new_session=True, check=True)"
LINE = "compiling machine code, once: half a minute for the first filter"


@pytest.mark.parametrize(
    ("program", "terminal", "said"),
    [
        (COUNTED.format(setting=""), False, LINE),
        (COUNTED.format(setting=QUIET), False, None),
        (COUNTED.format(setting=QUIET), True, None),
        (COUNTED.format(setting=RECORD), True, f"WARNING filters.kernels.compilation {LINE}"),
        (BACKGROUND.format(COUNTED.format(setting="")), True, LINE),
    ],
    ids=["no terminal", "quiet", "quiet terminal", "logging", "session of its own, as of a benchmark's processes"],
)
def test_where_nobody_sees_a_count_one_line_says_it_unless_logging_is_silent(tmp_path, program, terminal, said):
    told = shown(tmp_path, program, terminal=terminal)
    assert told.startswith(said or "")
    assert (told.count("\n"), "\r" in told) == (int(said is not None), False)
    assert bool(told) == (said is not None)


def test_a_unit_that_is_called_with_other_arguments_than_its_signature_is_refused(tmp_path):
    """A tuple of the wrong length was a crash without a word."""
    program = """
import sys
import numpy as np
from filters.kernels.blas import entry
from filters.kernels.calls import call, read_calls

@entry
def wrong(calls_at, P):
    {body}

for P in (np.zeros((2, 2)), np.zeros((2, 2))[::-1]):
    try:
        wrong(0, P)
    except Exception as error:
        print([line for line in str(error).splitlines() if "must be called with" in line][0], file=sys.stderr)
"""
    for body in ("call(read_calls(calls_at).shear, (P, 2))", "call(read_calls(calls_at).shear, (P, 2, P))"):
        (tmp_path / "wrong.py").write_text(program.format(body=body))
        told = shown(tmp_path, "import wrong")
        assert told.count("shear must be called with") == 2
