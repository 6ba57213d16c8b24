"""A run that is interrupted, terminated or killed leaves nothing running, and says what is kept (1 min; slow: 1)."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[4]
MARK = "STEREO_SLAM_TEST_OF"
LIMIT = 240.0  # the first run on a machine compiles

pytestmark = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="processes are found in /proc")


class Run:
    """A bench of two jobs, and all its processes."""

    def __init__(self, out: Path, *, seeds: int = 40) -> None:
        self.out, self.mark = out, f"{MARK}={out}"
        self.process = subprocess.Popen(
            [sys.executable, "-m", "stereo_slam_env", "bench", "--preset", "reference-turn", "--jobs", "2",
             "--seeds", str(seeds), "--out", str(out)],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT), MARK: str(out)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )  # fmt: skip

    def wait_for_trials(self) -> None:
        until = time.monotonic() + LIMIT
        while not list(self.out.glob("trials/*/*.npz")):
            assert self.process.poll() is None, self.process.communicate()[1]
            assert time.monotonic() < until, "no trial was done in time"
            time.sleep(0.02)

    def end_by(self, by: signal.Signals, *, group: bool = False) -> str:
        (os.killpg if group else os.kill)(self.process.pid, by)
        return self.process.communicate(timeout=LIMIT)[1]

    def left(self) -> list[int]:
        """Its processes that are still there after some seconds."""
        for _ in range(50):
            if not (found := list(self._processes())):
                break
            time.sleep(0.1)
        return found

    def _processes(self):
        for place in Path("/proc").glob("[0-9]*"):
            try:
                if self.mark.encode() in (place / "environ").read_bytes().split(b"\0"):
                    yield int(place.name)
            except OSError:  # it has ended, or is somebody else's
                continue

    def shared_memory(self) -> list[str]:
        """Names that joblib, loky and multiprocessing make of the id of the process."""
        names = os.listdir("/dev/shm") if os.path.isdir("/dev/shm") else []
        return [name for name in names if any(f"{a}{self.process.pid}{b}" in name for a, b in ("--", "__", "-_"))]


@pytest.fixture
def run(tmp_path):
    started = Run(tmp_path / "run")
    yield started
    for process in (started.process.pid, *started.left()):
        try:
            os.kill(process, signal.SIGKILL)
        except ProcessLookupError:
            continue
    started.process.wait(LIMIT)


@pytest.mark.parametrize("group", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_killed_run_leaves_nothing(run, group):
    run.wait_for_trials()
    run.end_by(signal.SIGKILL, group=group)
    assert run.left() == []
    assert run.shared_memory() == []


@pytest.mark.parametrize("by", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_a_terminated_run_says_what_is_kept_as_an_interrupted_one_does(run, by):
    run.wait_for_trials()
    told = run.end_by(by, group=by == signal.SIGINT)
    kept = len(list(run.out.glob("trials/*/*.npz")))
    assert run.process.returncode == 130, told
    assert f"interrupted: {kept} finished trials are kept in {run.out}" in told
    assert "to go on: stereo-slam bench --preset reference-turn" in told
    assert "Traceback" not in told
    assert run.left() == []
    assert run.shared_memory() == []


@pytest.mark.parametrize(
    "seconds", [pytest.param(2.5, marks=pytest.mark.slow), pytest.param(3.5, marks=pytest.mark.slow), 5.0]
)
def test_an_early_interruption_shows_no_traceback(run, seconds):
    """While the command is imported, and while the processes start."""
    time.sleep(seconds)
    told = run.end_by(signal.SIGINT, group=True)
    assert run.process.returncode in (130, -signal.SIGINT), told  # the latter before the interpreter listens
    assert "Traceback" not in told
    assert run.left() == []
