"""What is wrong is said before the work, and where it belongs: outputs, plug-ins, scenario files (10 s)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from stereo_slam_env.cli.app import main

ROOT = Path(__file__).resolve().parents[3]


def refused(capsys, *arguments):
    """The line of a command that is refused."""
    assert main([str(argument) for argument in arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    return lines[0]


# ---- outputs --------------------------------------------------------------------------------------------------------


@pytest.fixture
def nowhere(tmp_path):
    """A place below a file, where nobody can write, whoever he is."""
    (tmp_path / "file").write_text("x")
    return tmp_path / "file" / "out"


@pytest.mark.parametrize(
    ("arguments", "work"),
    [
        (["bench", "--out"], "stereo_slam_env.benchmark.preset_study"),
        (["replay", "gtsam", "--out"], "stereo_slam_env.benchmark.scenarios.streams.make_recording"),
        (["train", "--out"], "stereo_slam_env.policies.ppo.train"),
        (["report", "a", "b", "--out"], "stereo_slam_env.benchmark.compare"),
        (["scenes", "record", "straight", "--out"], "stereo_slam_env.envs.recorder.RenderedDrive"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_an_output_that_cannot_be_written_is_known_before_the_work(monkeypatch, capsys, nowhere, arguments, work):
    def begins(*args, **kwargs):
        raise AssertionError("the work has begun")

    monkeypatch.setattr(work, begins)
    line = refused(capsys, *arguments, nowhere)
    assert f"output {nowhere} cannot be written" in line
    assert "choose another directory" in line


@pytest.mark.parametrize("arguments", [["scenes", "render", "straight", "--out"], ["view", "run", "--still"]])
def test_so_is_that_of_a_picture(capsys, nowhere, arguments):
    assert f"output {nowhere} cannot be written" in refused(capsys, *arguments, nowhere / "picture.png")


def test_nothing_is_made_by_looking(capsys, tmp_path):
    refused(capsys, "bench", "--preset", "no-such-preset", "--out", tmp_path / "new" / "out")
    assert list(tmp_path.iterdir()) == []


# ---- plug-ins -------------------------------------------------------------------------------------------------------


@pytest.fixture
def broken(tmp_path):
    """The command where a plug-in is installed that cannot be imported; it leaves a file where that was tried."""
    site, tried = tmp_path / "site", tmp_path / "tried"
    (site / "broken_plugin-1.0.dist-info").mkdir(parents=True)
    (site / "broken_plugin.py").write_text(f"open({str(tried)!r}, 'w').close()\nimport no_such_module\n")
    about = site / "broken_plugin-1.0.dist-info"
    about.joinpath("METADATA").write_text("Metadata-Version: 2.1\nName: broken-plugin\nVersion: 1.0\n")
    about.joinpath("entry_points.txt").write_text("[stereo_slam.filters]\nbroken = broken_plugin:Filter\n")
    (tmp_path / "s.toml").write_text(
        'name = "s"\nkind = "reference"\nseeds = 1\nframes = 4\nmetrics = []\noptions = { name = "short_turn" }\n'
    )

    def run(*arguments):
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(site)])}
        command = [sys.executable, "-m", "stereo_slam_env", *arguments]
        done = subprocess.run(
            command, capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=240, check=False
        )
        return done, tried.exists()

    return run


WHY = "filter 'broken' (broken_plugin:Filter) cannot be loaded: ModuleNotFoundError"


def test_a_broken_plug_in_that_nobody_asked_for_is_not_even_imported(broken):
    done, tried = broken("bench", "--scenario", "s.toml", "--filters", "dead-reckoning", "--jobs", "1", "--out", "a")
    assert done.returncode == 0, done.stderr
    assert not tried
    assert "cannot be loaded" not in done.stdout + done.stderr


def test_it_is_reported_where_it_is_asked_for(broken):
    done, _ = broken("bench", "--scenario", "s.toml", "--filters", "broken", "--jobs", "1", "--out", "b")
    assert WHY in done.stderr
    done, _ = broken("filters", "check", "broken")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert WHY in done.stderr


def test_and_where_plug_ins_are_listed(broken):
    done, _ = broken("filters", "list")
    assert done.returncode == 0
    assert f"not available: {WHY}" in done.stdout
    assert done.stderr == ""


# ---- scenario files -------------------------------------------------------------------------------------------------


def test_a_scenario_file_without_a_kind_says_so(capsys, tmp_path):
    path = tmp_path / "s.toml"
    path.write_text('name = "s"\n[options]\nname = "short_turn"\n')
    assert "scenario 's' must say its kind, one of street, " in refused(capsys, "bench", "--scenario", path)


# ---- trajectories ---------------------------------------------------------------------------------------------------


def trajectory(path, times):
    rows = [f"{t} {k} 0 {k * k} 0 0 0 1" for k, t in enumerate(times)]
    path.write_text("\n".join(rows) + "\n")
    return path


def test_times_that_go_back_are_to_be_sorted(capsys, tmp_path):
    good = trajectory(tmp_path / "good.tum", [0.0, 0.1, 0.2, 0.3, 0.4])
    back = trajectory(tmp_path / "back.tum", [0.0, 0.2, 0.1, 0.3, 0.4])
    assert "row 2 is earlier than row 1: sort the rows by time" in refused(capsys, "evaluate", back, good)
