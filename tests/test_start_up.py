"""What is loaded when little is asked for: the quick start of imports and of `stereo-slam --help` (10 s)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import filters

ROOT = Path(__file__).resolve().parent.parent
HEAVY = {"cv2", "distributed", "filterpy", "joblib", "matplotlib", "numba", "pybullet", "scipy", "torch"}
HEAVY |= {"jinja2", "vl_convert"}
HELP = "from stereo_slam_env.cli import app; app.main(['--help'])"


def loaded_by(code):
    """Names of the packages in memory after `code`, and the CPU time of the process in seconds."""
    ask = f"{code}; import resource, sys; used = resource.getrusage(resource.RUSAGE_SELF); "
    ask += "print(used.ru_utime + used.ru_stime, *{name.partition('.')[0] for name in sys.modules})"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, env=environment, check=True)
    seconds, *names = done.stdout.splitlines()[-1].split()
    return set(names), float(seconds)


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        ("import filters", HEAVY | {"numpy", "stereo_slam_env"}),
        ("from filters import StereoCamera, StereoNoise", HEAVY | {"stereo_slam_env"}),
        ("from filters import make_filter", HEAVY - {"scipy"} | {"stereo_slam_env"}),
        ("import stereo_slam_env", HEAVY),
        (HELP, HEAVY | {"filters"}),
    ],
)
def test_nothing_heavy_is_loaded_before_it_is_needed(code, heavy):
    assert loaded_by(code)[0] & heavy == set()


def test_importing_filters_takes_no_time():
    assert any(loaded_by("import filters")[1] < 0.3 for _ in range(3))


def test_help_takes_no_time():
    assert any(loaded_by(HELP)[1] < 0.5 for _ in range(5))


def test_every_name_of_filters_can_be_had():
    assert all(getattr(filters, name).__name__.rpartition(".")[2] == name for name in filters.__all__)
    assert set(filters.__all__) <= set(dir(filters))
    with pytest.raises(AttributeError, match="StereoFiltre"):
        _ = filters.StereoFiltre


READ_ONLY = """
import numba.core.caching as caching

def refuse(self):
    raise OSError("read-only file system")

caching._CacheLocator.ensure_cache_path = refuse
import filters.kernels.compilation as compilation
from numba import config
print(compilation.KEPT["cache"], config.CACHE_DIR)
"""


@pytest.mark.parametrize(("mode", "kept"), [(None, True), (0o700, True), (0o777, False)])
def test_where_nothing_can_be_written_machine_code_goes_to_a_folder_of_this_user_alone(tmp_path, mode, kept):
    """A read-only container without a home; what others could write there would be run."""
    folder = tmp_path / f"stereo-slam-{os.getuid()}"
    if mode is not None:
        folder.mkdir()
        folder.chmod(mode)
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", READ_ONLY], env=environment, text=True, capture_output=True, timeout=120, check=True
    )
    assert done.stdout.split() == ([str(kept), str(folder)] if kept else ["False"])
    assert done.stderr.count("\n") == 1
    assert ("kept in" in done.stderr, "made anew" in done.stderr) == (kept, not kept)
