"""Small servers and CI jobs: what works without the simulator, OpenCV, charts and Numba, and what the rest says (30 s).

The imports are refused in a process of its own, by a finder in front of all others.
"""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import gymnasium as gym
import pytest

import stereo_slam_env as sse
from filters.contract.extras import CORE, install_command
from stereo_slam_env.cli.app import main

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SIMULATOR_AND_CHARTS = "pybullet pybullet_data cv2 vl_convert matplotlib jinja2 markupsafe PIL joblib filterpy"
EVERYTHING_HEAVY = f"{SIMULATOR_AND_CHARTS} numba llvmlite"
REFUSE = """
import sys

class Refused:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {absent!r}.split():
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Refused())
"""


def without(absent, code):
    """Exit code, stdout and stderr of `code` where these packages cannot be imported."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "160"}
    command = [sys.executable, "-c", REFUSE.format(absent=absent) + code]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=200)
    return done.returncode, done.stdout, done.stderr


def command_without(absent, *arguments):
    return without(absent, f"from stereo_slam_env.cli.app import main; sys.exit(main({[*map(str, arguments)]!r}))")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A trajectory with covariances, and its reference."""
    folder = tmp_path_factory.mktemp("trajectories")
    run = sse.evaluate("inverse-depth", sse.make_recording("reference-turn", 0)).series
    estimate = sse.Trajectory(run.positions, run.orientations, run.timestamps, run.pose_covariances)
    sse.save_trajectory(folder / "estimate.square", estimate)
    truth = sse.Trajectory(run.true_positions, run.true_orientations, run.timestamps)
    sse.save_trajectory(folder / "truth.square", truth)
    return folder / "estimate.square", folder / "truth.square"


# What works.


@pytest.mark.parametrize("package", ["filters", "stereo_slam_env"])
def test_the_packages_are_imported(package):
    assert without(EVERYTHING_HEAVY, f"import {package}") == (0, "", "")


def test_a_trajectory_is_judged(files):
    code, out, error = command_without(EVERYTHING_HEAVY, "evaluate", *files, "--json")
    assert (code, error) == (0, "")
    (score,) = json.loads(out)["scores"]
    assert score == json.loads(json.dumps(sse.evaluate_trajectory(*files).as_dict()))


def test_a_covariance_is_learned_and_claimed(files, tmp_path):
    """The model and the trajectory are those where everything is there, to the last byte."""
    estimate, truth = files
    for folder, command in (("without", command_without), ("with", lambda absent, *a: (main([*map(str, a)]), "", ""))):
        (tmp_path / folder).mkdir()
        model, claimed = tmp_path / folder / "model.json", tmp_path / folder / "claimed.square"
        learned = command(EVERYTHING_HEAVY, "calibrate", estimate, estimate, "--truth", truth, "--out", model)
        assert (learned[0], learned[2]) == (0, "")
        assert command(EVERYTHING_HEAVY, "claim", estimate, model, "--out", claimed)[0] == 0
    for name in ("model.json", "claimed.square"):
        assert (tmp_path / "without" / name).read_bytes() == (tmp_path / "with" / name).read_bytes()


def test_filters_run_and_pass_their_checks():
    sse.evaluate("inverse-depth", sse.make_recording("reference-turn", 0))  # lest machine code is made, and said so
    code, out, error = command_without(SIMULATOR_AND_CHARTS, "filters", "check", "inverse-depth")
    assert code == 0
    assert [line for line in error.splitlines() if not line.startswith("compiling machine code")] == []
    assert re.search(r"inverse-depth: \d+ checks passed, 0 failed", out)


def test_every_name_of_filters_is_there():
    every = "import filters; print(*(name for name in filters.__all__ if getattr(filters, name) is None))"
    assert without(SIMULATOR_AND_CHARTS, every) == (0, "\n", "")


def test_a_filter_is_evaluated_on_a_recording(tmp_path):
    recording = sse.make_recording("reference-turn", 0)
    sse.save_recording(tmp_path / "drive.npz", recording)
    code, out, _ = without(
        SIMULATOR_AND_CHARTS,
        "import stereo_slam_env as sse\n"
        f"recording = sse.load_recording({str(tmp_path / 'drive.npz')!r})\n"
        "print(sse.evaluate('inverse-depth', recording).figures.position_rmse_m)",
    )
    assert code == 0
    assert float(out) == pytest.approx(sse.evaluate("inverse-depth", recording).figures.position_rmse_m, rel=1e-6)


WINDOWS = """
import os, signal
for module, names in {os: "fork forkpty killpg setsid getuid getpgrp tcgetpgrp O_NONBLOCK O_NOFOLLOW mkfifo",
                      signal: "SIGHUP SIGKILL SIGALRM setitimer"}.items():
    for name in names.split():
        delattr(module, name)
"""


def test_judge_and_environments_work_without_what_windows_lacks(files, tmp_path):
    """Processes without fork, POSIX modules and signals; runs of `bench` are not tried."""
    estimate, truth = map(str, files)
    model, claimed = str(tmp_path / "model.json"), str(tmp_path / "claimed.square")
    code, _, error = without(
        "resource fcntl pwd grp termios",
        f"{WINDOWS}\n"
        "from stereo_slam_env.cli.app import main\n"
        f"assert main(['evaluate', {estimate!r}, {truth!r}, '--out', {str(tmp_path / 'out')!r}]) == 0\n"
        f"assert main(['calibrate', {estimate!r}, {estimate!r}, '--truth', {truth!r}, '--out', {model!r}]) == 0\n"
        f"assert main(['claim', {estimate!r}, {model!r}, '--out', {claimed!r}]) == 0\n"
        "import gymnasium, stereo_slam_env\n"
        "env = gymnasium.make('StereoSlam/ActiveGaze-v0')\n"
        "env.reset(seed=0)\n"
        "env.step(env.action_space.sample())\n",
    )
    assert code == 0, error


def test_worlds_and_tasks_need_no_pybullet():
    """Landmarks are measured, and rays and contacts decided, without it: it only draws, and checks by `physics`."""
    ids = [name for name in gym.registry if name.startswith("StereoSlam/")]
    code = (
        "import gymnasium, stereo_slam_env\n"
        f"for id in {ids!r}:\n"
        "    env = gymnasium.make(id)\n"
        "    env.reset(seed=0)\n"
        "    env.step(env.action_space.sample())\n"
        "    env.close()\n"
    )
    assert without("pybullet pybullet_data", code)[0] == 0


# What says how to get what it needs.

RIG = "from filters import *; camera = StereoCamera(500.0, 500.0, 320.0, 240.0, 0.1, 640, 480)"
SAYS = [
    ("cv2", "import stereo_slam_env as sse; sse.load"),
    ("cv2", "from stereo_slam_env.frontend import StereoTracker"),
    ("cv2", "import gymnasium, stereo_slam_env; gymnasium.make('StereoSlam/Gaze-v0')"),
    ("pybullet", "import gymnasium, stereo_slam_env; gymnasium.make('StereoSlam/Gaze-v0', physics='bullet')"),
    ("pybullet", "import gymnasium, stereo_slam_env; gymnasium.make('StereoSlam/Drive-v0', sensor='images')"),
    ("pybullet", "import gymnasium, stereo_slam_env; gymnasium.make('StereoSlam/Drive-v0', render_mode='rgb_array')"),
    ("numba", "import filters; filters.FilterBatch"),
    ("numba", f"{RIG}; make_filter('inverse-depth', camera=camera, noise=StereoNoise.independent_pixels(1.0))"),
    ("numba", "import gymnasium, stereo_slam_env; gymnasium.make_vec('StereoSlam/Drive-v0', num_envs=2)"),
    ("filterpy", "import filters; filters.Unscented()"),
    ("vl_convert", "import stereo_slam_env as sse; sse.write_report_of"),
    ("jinja2", "from stereo_slam_env.report import html_page"),
]


@pytest.mark.parametrize(("module", "code"), SAYS)
def test_a_name_that_needs_an_absent_package_says_how_to_install_it(module, code):
    exit_code, _, error = without(module, code)
    assert exit_code == 1
    last = error.splitlines()[-1]
    assert last == f'ModuleNotFoundError: {module} is missing: {sys.executable} -m pip install "{CORE[module]}"'


@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("cv2", ["bench", "--preset", "turn", "--seeds", "1"]),
        ("pybullet", ["scenes", "render", "right-turn", "--out", "a.png"]),
    ],
)
def test_a_command_that_needs_an_absent_package_is_refused_in_one_line(module, arguments, tmp_path):
    code, _, error = command_without(module, *arguments)
    assert code == 2
    assert error == f'error: {module} is missing: {sys.executable} -m pip install "{CORE[module]}"\n'


def test_a_page_of_a_score_needs_the_charts_and_keeps_the_figures(files, tmp_path):
    code, _, error = command_without("vl_convert", "evaluate", *files, "--out", tmp_path)
    assert code == 2
    assert error == f'error: vl_convert is missing: {sys.executable} -m pip install "{CORE["vl_convert"]}"\n'
    assert (tmp_path / "score.json").is_file()


def test_a_bag_names_its_extra(tmp_path):
    (tmp_path / "drive.mcap").touch()
    code, _, error = command_without("rosbags", "evaluate", tmp_path / "drive.mcap", tmp_path / "drive.mcap")
    assert (code, error) == (2, f"error: rosbags is missing: {install_command('bags')}\n")


def test_pictures_of_a_drive_name_their_extra():
    _, _, error = without("matplotlib", "from stereo_slam_env.viewer import save_still")
    assert error.splitlines()[-1] == f"ImportError: matplotlib is missing: {install_command('pictures')}"


def test_the_messages_name_what_the_distribution_requires():
    required = {re.match(r"[\w-]+", line)[0]: line for line in PROJECT["dependencies"]}
    for module, requirement in CORE.items():
        name, _, bound = requirement.partition("<")
        assert name == PROJECT["name"] or name in required, module
        assert not bound or f"<{bound}" in required[name], module
