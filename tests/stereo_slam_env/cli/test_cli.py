"""The command, as a user meets it: in this process where possible (30 s, most of it starting processes)."""

import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import stereo_slam_env as sse
from filters import available_filters
from filters.catalogue.registry import filter_factory
from stereo_slam_env.benchmark import presets
from stereo_slam_env.benchmark.scenarios.schema import setting_keys
from stereo_slam_env.benchmark.storage.store import RunDirectory
from stereo_slam_env.cli import app as cli
from stereo_slam_env.cli.shared_options import FILTER_GROUPS, PRESET_GROUPS
from stereo_slam_env.recording.archive import save_recording
from stereo_slam_env.recording.recording import GIVEN_TRUTH, SIMULATION, Reference

from ..benchmark.small_recordings import small_recording
from ..datasets.small_folders import kitti00, kitti07

ROOT = Path(__file__).resolve().parents[3]
BENCH = ("bench", "--preset", "reference-turn", "--seeds", "2", "--frames", "4", "--jobs", "1")


@pytest.fixture
def command(full_command, monkeypatch):
    """Run the command with a report that costs no time."""
    make_no_report(monkeypatch)
    return full_command


def make_no_report(monkeypatch):
    def write_report(out, *_, **__):
        (out / "report.html").write_text("a report")
        return out / "report.html"

    monkeypatch.setattr("stereo_slam_env.report.benchmark_report.write_report", write_report)


@pytest.fixture
def full_command(capsys, monkeypatch):
    """Run the command: exit code, stdout, stderr."""
    monkeypatch.setenv("COLUMNS", "160")

    def run(*arguments):
        code = cli.main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


# Whoever starts the tests in the background has SIGINT ignored, and the processes of the tests inherit that.
INTERRUPTIBLE = """
import runpy, signal
signal.signal(signal.SIGINT, signal.default_int_handler)
runpy.run_module("stereo_slam_env", run_name="__main__", alter_sys=True)
"""


def process(*arguments, folders=(ROOT,), **options):
    path = os.pathsep.join(map(str, folders))
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", INTERRUPTIBLE, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        **options,
    )


def test_bench_compares_and_says_where_everything_is(full_command, tmp_path):
    code, out, _ = full_command(*BENCH, "--out", tmp_path / "run", "--filters", "inverse-depth,euclidean")
    assert code == 0
    for said in (
        "ATE",
        "ms a frame",
        "inverse-depth",
        "euclidean",
        "min_disparity",
        "independent_pixels",
        "gate  none",
    ):
        assert said in out, said
    assert str(tmp_path / "run" / "report.html") in out
    assert (tmp_path / "run" / "report.html").is_file()
    filters = json.loads((tmp_path / "run" / "summary.json").read_text())["filters"]
    assert list(filters) == ["inverse-depth", "euclidean"]
    assert filters["euclidean"]["frames"] == 2 * 3


def test_options_of_the_command_line_are_stored(command, tmp_path):
    code, out, _ = command(
        *BENCH, "--out", tmp_path / "run", "--set", "noise.independent_pixels=2.5", "--set", "gate=0.95", "--odometry"
    )
    assert code == 0
    assert "0.95 per landmark" in out
    scenario = json.loads((tmp_path / "run" / "settings.json").read_text())["scenario"]
    assert scenario["noise"] == {"independent_pixels": 2.5}
    assert scenario["gate"] == 0.95
    assert scenario["use_odometry"] is True


def test_a_scenario_of_your_own(command, tmp_path):
    spelt_out = {"name": "mine", "kind": "reference", "options": {"name": "short_turn"}, "frames": 4, "gate": None}
    (tmp_path / "mine.json").write_text(json.dumps({**spelt_out, "filters": ["euclidean"]}))
    code, out, _ = command("bench", "--scenario", tmp_path / "mine.json", "--jobs", 1, "--out", tmp_path / "run")
    assert code == 0
    assert "mine" in out


def test_a_grid_of_your_own_has_a_report_over_all_its_cells(full_command, tmp_path):
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\nkind = "reference"\nseeds = 1\nframes = 4\ngate = false\nfilters = ["inverse-depth"]\n'
        'metrics = []\noptions = { name = "short_turn" }\n[grid]\n"options.sigma" = [1.0, 2.0]\n'
    )
    code, out, _ = full_command("bench", "--scenario", tmp_path / "mine.toml", "--jobs", 1, "--out", tmp_path / "run")
    assert code == 0
    for said in ("mine: 2 scenarios", "options.sigma  1.0, 2.0", "sigma-2.0", str(tmp_path / "run" / "report.html")):
        assert said in out, said
    page = (tmp_path / "run" / "report.html").read_text()
    assert "cells/sigma-2.0/report.html" in page
    assert (tmp_path / "run" / "cells" / "sigma-2.0" / "report.html").is_file()
    assert (tmp_path / "run" / "trials.sqlite").is_file()


def test_the_presets_are_listed(command):
    code, out, _ = command("bench", "--list")
    assert code == 0
    for name in ("quick", "attribution", "baseline", "mismatch", "real", "limits", "gaze"):
        assert f"\n  {name} " in out


def test_a_reader_that_has_seen_enough_is_no_error():
    asked = [sys.executable, "-m", "stereo_slam_env", "bench", "--list"]
    with subprocess.Popen(asked, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as listing:
        listing.stdout.close()
        assert listing.stderr.read() == b""


def test_policies_are_listed(command):
    code, out, _ = command("policies", "list")
    assert code == 0
    for line in ("fixed", "Look in one direction, straight ahead by default.", "sweep", "random"):
        assert line in out, line


def test_policies_are_compared(command, tmp_path):
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\nkind = "gaze"\nframes = 6\ngate = false\nuse_odometry = true\npolicies = ["random"]\n'
        'filters = [{ name = "shared-anchor", options = { motion = "velocity-driven" } }]\n'
        'options = { route = "right-turn", rig = "qvga" }\n'
    )
    code, out, _ = command(
        *("bench", "--scenario", tmp_path / "mine.toml", "--policy", "fixed,sweep", "--seeds", 2),
        *("--jobs", 1, "--out", tmp_path / "run"),
    )
    assert code == 0
    for said in (
        "policies  fixed, sweep",
        "claimed σ at the end, m",
        "true error at the end, m",
        "leaves the pose least uncertain at the end",
        "- sweep is not shown to claim another uncertainty than fixed",
        str(tmp_path / "run" / "report.html"),
    ):
        assert said in out, said
    code, again, _ = command("report", tmp_path / "run")
    assert code == 0
    assert "leaves the pose least uncertain at the end" in again


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--policy", "swep"), "did you mean 'sweep'?"),
        (("--policy", "sweep", "--preset", "turn"), "policies need a scenario of kind 'gaze'"),
        (("--policy", ","), "must name at least one policy"),
        (("--policy", "sweep", "--frames", "5000"), "frames must be at most 200"),
    ],
)
def test_policies_that_cannot_be_compared_get_one_line(command, tmp_path, arguments, said):
    code, _, err = command("bench", *arguments, "--out", tmp_path / "run")
    assert (code, err.count("\n")) == (2, 1)
    assert said in err
    assert not (tmp_path / "run").exists()


def test_two_runs_are_compared(command, tmp_path):
    for name, sigma in (("before", "3"), ("after", "1")):
        bench = (
            "bench",
            "--preset",
            "reference-turn",
            "--seeds",
            "10",
            "--frames",
            "6",
            "--jobs",
            "1",
            "--set",
            f"noise.independent_pixels={sigma}",
        )
        assert command(*bench, "--out", tmp_path / name, "--filters", "inverse-depth")[0] == 0
    code, out, _ = command("report", tmp_path / "before", tmp_path / "after")
    assert code == 0
    assert "pose NEES" in out
    assert "not significant" in out
    code, _, err = command("report", tmp_path / "before", tmp_path / "nothing")
    assert (code, err.count("\n")) == (2, 1)


def test_a_full_disk_is_told_in_one_line_with_what_is_kept(command, tmp_path, monkeypatch):
    write = RunDirectory.save_trial

    def until_full(self, *trial):
        if len(list(tmp_path.glob("run/trials/*/*.npz"))) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, *trial)

    monkeypatch.setattr(RunDirectory, "save_trial", until_full)
    code, _, err = command(*BENCH, "--out", tmp_path / "run")
    assert (code, err.splitlines()[-1].count("error: ")) == (2, 1)
    assert "the disk is full: 2 finished trials are kept" in err
    monkeypatch.undo()


NEAR_IS_XYZ = {"landmark": {"name": "hybrid", "linearity_limit": 0.02}}
TABLE = '{label = "near", name = "inverse-depth", options = {landmark = {name = "hybrid", linearity_limit = 0.02}}}'


def test_filters_are_named_or_written_as_in_a_scenario_file(command, tmp_path):
    """A part is a table of its settings with its name, in `bench`, in `replay` and in a file alike."""
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\nkind = "reference"\nseeds = 1\nframes = 4\noptions = { name = "short_turn" }\n'
        f'filters = ["inverse-depth", {TABLE}]\n'
    )
    drive = kitti07(tmp_path / "drive")
    for name, arguments in {
        "bench": (*BENCH, "--filters", f"inverse-depth, {TABLE}"),
        "replay": ("replay", drive, "--jobs", 1, "--filters", f"inverse-depth,{TABLE}"),
        "file": ("bench", "--scenario", tmp_path / "mine.toml", "--jobs", 1),
    }.items():
        assert command(*arguments, "--out", tmp_path / name)[0] == 0
        filters = json.loads((tmp_path / name / "summary.json").read_text())["filters"]
        assert list(filters) == ["inverse-depth", "near"]
        assert filters["near"]["options"].items() >= NEAR_IS_XYZ.items()
        assert "landmark" not in filters["inverse-depth"]["options"]


@pytest.mark.parametrize("layout", [kitti07, kitti00])
def test_replay_runs_filters_over_a_folder(command, tmp_path, layout):
    layout(tmp_path / "drive")
    code, out, _ = command(
        "replay", tmp_path / "drive", "--filters", "inverse-depth", "--jobs", 1, "--out", tmp_path / "run"
    )
    assert code == 0
    assert "sigma_px = 2," in out
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["recordings"][0]["seed"] is None
    assert summary["recordings"][0]["source"]["reader"].startswith(layout.__name__)
    assert "inverse-depth" in summary["filters"]
    assert (tmp_path / "run" / "trajectories" / "recording" / "inverse-depth.tum").is_file()


def test_replay_against_an_odometry_from_the_same_images_claims_nothing_of_consistency(
    full_command, tmp_path, monkeypatch
):
    """Nor does it keep silent on the innovations: 1 px of noise, and 8 px assumed."""
    odometry = Reference("odometry", "By hand.")
    for name, truth_from in (("true", SIMULATION), ("odometry", odometry)):
        save_recording(tmp_path / f"{name}.npz", replace(small_recording(frames=40), truth_from=truth_from))

    def said(name, *more):
        common = ("--filters", "inverse-depth", "--jobs", 1, "--set", "gate=none", "--out", tmp_path / f"run-{name}")
        code, out, _ = full_command("replay", tmp_path / f"{name}.npz", *common, *more)
        assert code == 0
        summary = json.loads((tmp_path / f"run-{name}" / "summary.json").read_text())
        return out, summary, (tmp_path / f"run-{name}" / "report.html").read_text(encoding="utf-8")

    with monkeypatch.context() as patch:
        make_no_report(patch)
        out, summary, _ = said("true")
    assert "pose NEES / 6" in out
    assert "Reference: independent truth (simulation). Exact poses of the simulation." in out
    assert "than claimed" not in out
    assert summary["recordings"][0]["reference"] == asdict(SIMULATION)
    assert summary["filters"]["inverse-depth"]["pose_anees"] > 0

    out, summary, page = said("odometry", "--set", "noise.independent_pixels=8")
    for claim in ("NEES /", "it is consistent", "its band", "that band"):
        assert claim not in out
        assert claim not in page
    for text in (out, page):
        assert "Reference: odometry from the same images. By hand. Errors are only disagreement with it" in text
        assert "smaller than claimed: normal where errors that last" in text
    assert summary["recordings"][0]["reference"] == asdict(odometry)
    assert summary["filters"]["inverse-depth"]["pose_anees"] is None
    assert summary["filters"]["inverse-depth"]["position_rmse_m"] > 0


def test_replay_says_of_a_strangers_truth_that_its_origin_is_unknown_until_it_is_stated(
    full_command, tmp_path, monkeypatch
):
    """The figures are the same; what they mean is said. As an odometry it makes no NEES."""
    save_recording(tmp_path / "mine.npz", replace(small_recording(frames=30), truth_from=GIVEN_TRUTH))

    def said(name, *more):
        common = ("--filters", "inverse-depth", "--jobs", 1, "--set", "gate=none", "--out", tmp_path / name)
        code, out, _ = full_command("replay", tmp_path / "mine.npz", *common, *more)
        assert code == 0
        figures = json.loads((tmp_path / name / "summary.json").read_text())["filters"]["inverse-depth"]
        return " ".join(out.split()), (tmp_path / name / "report.html").read_text(encoding="utf-8"), figures

    out, page, figures = said("unstated")
    for text in (out, page):
        assert "Reference: stated by the recording, origin unknown. It calls its poses true" in text
    assert "independent truth" not in out + page
    make_no_report(monkeypatch)
    out, _, surveyed = said("surveyed", *("--set", "options.reference={kind = 'surveyed', position_jitter = 0.001}"))
    assert "Reference: independent truth (surveyed). It calls its poses true" in out
    assert "Its kind was stated for this run. Its stated errors: jitter of 1 mm." in out
    assert surveyed["position_rmse_m"] == figures["position_rmse_m"]
    assert surveyed["pose_anees"] == pytest.approx(figures["pose_anees"], rel=0.2)
    out, _, odometry = said("odometry", "--set", "options.reference.kind=odometry")
    assert "Reference: odometry from the same images. " in out
    assert odometry["position_rmse_m"] == figures["position_rmse_m"]
    assert odometry["pose_anees"] is None


def test_a_kind_of_poses_that_are_not_there_is_refused(command, tmp_path):
    save_recording(tmp_path / "blind.npz", small_recording(truth=False))
    code, _, err = command(
        "replay", tmp_path / "blind.npz", "--set", "options.reference.kind=ins", "--out", tmp_path / "run"
    )
    assert code == 2
    assert "reference states kind=ins, but" in err
    assert "has no true pose: leave it out" in " ".join(err.split())


def test_what_replay_writes_is_read_by_evaluate_with_the_same_nees(command, tmp_path):
    """Of the filters' own errors, against a truth whose errors are stated; the motion over 1 s is scored beside it."""
    save_recording(tmp_path / "drive.npz", replace(small_recording(frames=25), truth_from=SIMULATION))
    stated = "options.reference={position_jitter = 0.01, rotation_jitter = 0.001, settled_at = 0.45}"
    arguments = ("replay", tmp_path / "drive.npz", "--filters", "inverse-depth,right-invariant", "--jobs", 1)
    code, out, _ = command(*arguments, "--set", stated, "--out", tmp_path / "run")
    assert code == 0
    assert "jitter of 10 mm, jitter of 1 mrad. It has settled at 0.45 s: scored from there on." in " ".join(out.split())
    assert "motion NEES, 1 s / 6" in out
    figures = json.loads((tmp_path / "run" / "summary.json").read_text())["filters"]
    folder = tmp_path / "run" / "trajectories" / "recording"
    ours, theirs, truth = (folder / f"{name}.square" for name in ("inverse-depth", "right-invariant", "truth"))
    code, out, _ = command("evaluate", ours, truth, "--against", theirs, "--out", tmp_path / "score")
    assert code == 0
    assert "Its log score of the pose differs by" in out
    for score in json.loads((tmp_path / "score" / "score.json").read_text())["scores"]:
        row = figures[score["estimate"]]
        assert score["frames"] == row["frames"] == 20
        assert score["position_rmse_m"] == pytest.approx(row["position_rmse_m"], rel=1e-9)
        for what in ("pose", "position", "rotation"):
            assert score["claims"][what]["nees"]["mean"] == pytest.approx(row[f"{what}_anees"], rel=1e-7)
    assert row["pose_nees_floor"] > 6.0
    assert row["window_nees_1s"] > 0.0


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("none.tum", "truth.tum"), "none.tum does not exist: give a trajectory (8 numbers a row (TUM)"),
        (("truth.tum", "truth.tum", "--align", "yaw"), "--align must be"),
        (("truth.tum", "truth.tum", "--align", "rigid"), "does not determine a rigid alignment"),
        (("truth.tum", "truth.tum", "--max-gap", "-1"), "max_gap"),
        (("truth.tum",), "evaluate needs an estimate and a reference, got truth.tum alone"),
        (("truth.tum", "truth.tum", "--time-offset", "soon"), "--time-offset must be a number of seconds or 'auto'"),
        (("truth.tum", "truth.tum", "--time-offset", "auto"), "time_offset is not determined"),
        (("truth.tum", "truth.tum", "--body", "none.json"), "none.json does not exist: give JSON with R and t"),
        (("truth.tum", "truth.tum", "--body", "truth.tum"), "truth.tum is no JSON"),
        (("truth.tum", "truth.tum", "--body", "b", "--body-estimated"), "leave one of them out"),
        (("truth.tum", "truth.tum", "--up", "w"), "up must be one of x, y, z, got 'w'"),
        (("truth.tum", "truth.tum", "--pair"), "pair needs covariances in both files"),
        (("truth.tum", "truth.tum", "truth.tum", "--against", "truth.tum"), "--against compares one estimate with"),
        (("truth.tum", "truth.tum", "--out", "score.json"), "--out must be a folder, got score.json: for the figures"),
    ],
)
def test_evaluate_says_in_one_line_what_is_wrong(command, tmp_path, monkeypatch, arguments, complaint):
    monkeypatch.chdir(tmp_path)
    Path("truth.tum").write_text("".join(f"{0.1 * k} {k} 0 0 0 0 0 1\n" for k in range(9)))
    code, out, err = command("evaluate", *arguments)
    assert (code, out) == (2, "")
    assert complaint in err
    assert err.count("\n") == 1


def test_estimates_without_a_claim_stand_side_by_side(command, tmp_path):
    truth = wave(tmp_path, "truth.tum")
    estimates = [wave(tmp_path, f"{name}.tum", seed, 0.01) for seed, name in enumerate(("mine", "yours", "theirs"))]
    code, out, _ = command("evaluate", *estimates, truth)
    assert code == 0
    assert all(f"{name}: position error" in out for name in ("mine", "yours", "theirs"))
    assert "judged by itself" not in out
    sse.save_trajectory(tmp_path / "sure.square", with_claim(sse.load_trajectory(estimates[0])))
    code, out, _ = command("evaluate", tmp_path / "sure.square", *estimates[1:], truth)
    assert code == 0
    assert "each is judged by itself: runs are judged together from two on, 1 of 3 can be" in out


def with_claim(trajectory):
    """The trajectory with a claim of 0.1 m and 0.1 rad."""
    return replace(trajectory, covariances=np.broadcast_to(0.01 * np.eye(6), (len(trajectory), 6, 6)))


def wave(folder, name, seed=0, size=0.0):
    """A winding path of 20 s, with an error that grows, as TUM."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(200)
    path = np.column_stack([5.0 * np.cos(t), 3.0 * np.sin(0.7 * t), t])
    drift = size * np.cumsum(rng.normal(size=(200, 3)), axis=0)
    heading = 0.2 * np.sin(t) + 0.02 * size * np.cumsum(rng.normal(size=200))
    turns = Rotation.from_rotvec(heading[:, None] * [0.0, 0.0, 1.0]).as_quat()
    sse.save_trajectory(folder / name, sse.Trajectory(path + drift, turns, t))
    return folder / name


def test_a_covariance_is_learned_claimed_and_judged(command, tmp_path):
    truth = wave(tmp_path, "truth.tum")
    runs = [wave(tmp_path, f"run{k}.tum", k, 0.01) for k in range(1, 5)]
    model, claimed = tmp_path / "model.json", tmp_path / "claimed.square"
    code, out, _ = command("calibrate", *runs[:3], "--truth", truth, truth, truth, "--out", model)
    assert code == 0
    assert "each of 3 drives by the model of the others" in " ".join(out.split())
    assert command("claim", runs[3], model, "--out", claimed)[0] == 0
    code, out, _ = command("evaluate", claimed, "--truth", truth, "--json")
    (score,) = json.loads(out)["scores"]
    assert score["alignment"] == "start"
    assert [window["nees_is_exact"] for window in score["windows"]] == [True, True, True]
    assert 0.1 < score["windows"][0]["nees"] / 6.0 < 5.0
    code, out, _ = command("evaluate", claimed, truth, "--against", claimed)
    assert (code, "not significant" in " ".join(out.split())) == (0, True)


def test_each_run_may_have_a_reference_of_its_own(command, tmp_path):
    truths = [wave(tmp_path, f"truth{k}.tum") for k in range(3)]
    runs = [wave(tmp_path, f"run{k}.tum", k, 0.01) for k in range(3)]
    code, out, _ = command("evaluate", *runs, "--truth", *truths, "--json")
    assert (code, json.loads(out)["runs"]) == (0, None)  # without claims there is nothing to judge together
    assert [score["reference"] for score in json.loads(out)["scores"]] == ["truth0", "truth1", "truth2"]
    model = tmp_path / "model.json"
    assert command("calibrate", *runs, "--truth", *truths, "--out", model)[0] == 0
    squares = [tmp_path / f"run{k}.square" for k in range(3)]
    for run, square in zip(runs, squares, strict=True):
        assert command("claim", run, model, "--out", square)[0] == 0
    code, out, _ = command("evaluate", *squares, "--truth", *truths, "--json")
    assert code == 0
    assert [score["reference"] for score in json.loads(out)["scores"]] == ["truth0", "truth1", "truth2"]
    code, _, err = command("evaluate", *squares, "--truth", *truths[:2])
    assert (code, "--truth must name one reference, or one for each of 3, got 2" in err) == (2, True)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("calibrate", "a.tum"), "Missing option '--truth'"),
        (("calibrate", "--truth", "a.tum"), "Missing argument 'EST...'"),
        (("calibrate", "a.tum", "--truth", "none.tum"), "none.tum does not exist"),
        (("calibrate", "a.tum", "--truth", "a.tum", "a.tum"), "1 estimates and 2 truths"),
        (("calibrate", "a.tum", "--truth", "a.tum", "--out", "model"), "--out must end in .json"),
        (("claim", "a.tum", "none.json"), "none.json does not exist: `stereo-slam calibrate` makes a model"),
        (("claim", "a.tum", "a.tum"), "a.tum is no JSON"),
        (("claim", "none.tum", "a.tum"), "does not exist"),
        (("claim", "a.tum", "a.tum", "--out", "b.tum"), "--out must end in .square"),
    ],
)
def test_calibrate_and_claim_say_in_one_line_what_is_wrong(command, tmp_path, monkeypatch, arguments, complaint):
    monkeypatch.chdir(tmp_path)
    wave(Path(), "a.tum")
    code, out, err = command(*arguments)
    assert (code, out) == (2, "")
    assert complaint in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_runs_are_judged_together_and_a_pair_without_a_truth(command, tmp_path, turn):
    rng = np.random.default_rng(0)
    t = 0.1 * np.arange(40)
    path = np.column_stack([np.cos(t), np.sin(t), 0.1 * t])
    turned = Rotation.from_rotvec(np.outer(turn * t, [0.0, 0.0, 1.0])).as_quat()
    names = [tmp_path / f"run{k}.square" for k in range(3)]
    for name in names:
        claimed = np.tile(1e-4 * np.eye(6), (40, 1, 1))
        noise = 0.01 * rng.normal(size=(40, 3))
        sse.save_trajectory(name, sse.Trajectory(path + noise, turned, t, claimed, name=name.stem))
    sse.save_trajectory(tmp_path / "truth.tum", sse.Trajectory(path, turned, t))
    code, out, _ = command("evaluate", *names, tmp_path / "truth.tum", "--out", tmp_path / "out")
    assert code == 0
    judged = "pose ANEES / 6" if turn else "position ANEES / 3"
    assert f"3 runs together: {judged} is" in " ".join(out.split())
    assert json.loads((tmp_path / "out" / "score.json").read_text())["runs"]["runs"] == ["run0", "run1", "run2"]
    code, out, _ = command("evaluate", names[0], names[1], "--pair")
    assert code == 0
    assert "the two claims" in " ".join(out.split())


@pytest.mark.parametrize(
    ("stated", "complaint"),
    [
        ("position_jitter=none", "must be a number or text"),
        ("jitter=1", "reference has no statement 'jitter'"),
        ("kind=gps", "kind of a reference must be one of 'simulation', 'surveyed', 'ins', 'odometry', 'unknown'"),
        ("misalignment=-1", "misalignment of a reference must be >= 0"),
    ],
)
def test_stated_errors_that_are_none_are_refused(command, tmp_path, stated, complaint):
    save_recording(tmp_path / "drive.npz", small_recording(frames=4))
    code, _, err = command(
        "replay", tmp_path / "drive.npz", "--set", f"options.reference.{stated}", "--out", tmp_path / "run"
    )
    assert code == 2
    assert complaint in err
    assert not (tmp_path / "run").exists()


def test_replay_says_whether_odometry_was_used(command, tmp_path):
    kitti07(tmp_path / "with")
    kitti00(tmp_path / "without")
    common = ("--filters", "euclidean", "--jobs", 1)
    assert "odometry  used" in command("replay", tmp_path / "with", *common, "--out", tmp_path / "a")[1]
    assert "odometry  not used" in command("replay", tmp_path / "without", *common, "--out", tmp_path / "b")[1]
    withheld = command("replay", tmp_path / "with", *common, "--out", tmp_path / "c", "--no-odometry")[1]
    assert "odometry  not used" in withheld


def test_report_is_written_again_from_the_directory(command, tmp_path):
    command(*BENCH, "--out", tmp_path / "run", "--filters", "euclidean")
    (tmp_path / "run" / "report.html").unlink()
    before = (tmp_path / "run" / "summary.json").read_text()
    code, out, _ = command("report", tmp_path / "run")
    assert code == 0
    assert "euclidean" in out
    assert (tmp_path / "run" / "report.html").is_file()
    assert (tmp_path / "run" / "summary.json").read_text() == before


@pytest.mark.usefixtures("third_party")
def test_third_party_filters_are_listed_and_benchmarked(command, tmp_path):
    listed = command("filters", "list")[1]
    assert "odometry-only" in listed
    assert "Integrates the odometry and maps nothing." in listed
    code, out, _ = command(*BENCH, "--out", tmp_path / "run", "--filters", "odometry-only,raises")
    assert code == 0
    assert "raises failed: seed 0, frame 2: RuntimeError: the third frame is too much" in out
    code, out, _ = command(*BENCH, "--out", tmp_path / "nothing", "--filters", "raises")
    assert (code, "raises failed" in out) == (1, True)  # nothing came of it


@pytest.mark.usefixtures("third_party")
def test_what_a_filter_does_not_get_is_in_console_and_summary(command, tmp_path):
    code, out, _ = command(
        *BENCH, "--out", tmp_path / "run", "--filters", "its-own-way,odometry-only,euclidean", "--set", "gate=0.99"
    )
    assert code == 0
    remarks = (
        "its-own-way does not get the common motion: it has its own, Gliding.",
        "odometry-only does not get the common gate: it does not leave it open.",
        "odometry-only does not get the common motion: it does not leave it open.",
    )
    for remark in remarks:
        assert f"note: {remark}" in out
    assert "euclidean does not get" not in out
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["filters"]["its-own-way"]["not_given"] == {"motion": "it has its own, Gliding"}
    assert summary["filters"]["its-own-way"]["options"] == {"gate": 0.99}
    assert summary["filters"]["its-own-way"]["failures"] == []


def test_filters_are_checked(command):
    code, out, _ = command("filters", "check", "euclidean")
    assert (code, "0 failed" in out) == (0, True)


@pytest.mark.usefixtures("third_party")
def test_a_filter_that_breaks_the_contract_gives_exit_code_1(command):
    code, out, _ = command("filters", "check", "odometry-only")
    assert code == 1
    assert "failed:" in out


def test_scenes_are_listed_and_drawn(command, tmp_path):
    from PIL import Image

    listed = command("scenes", "list")[1]
    assert "town" in listed
    assert "quick" in listed
    code, _, _ = command("scenes", "render", "right-turn", "--out", tmp_path / "scene.png", "--seed", 1)
    assert code == 0
    with Image.open(tmp_path / "scene.png") as image:
        assert image.width > 600
        assert len(set(image.convert("L").resize((40, 20)).tobytes())) > 20


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (("bnch",), "Did you mean 'bench'?"),
        (("bench", "--seds", "3"), "--seeds"),
        (("bench", "--seeds", "many"), "--seeds"),
        (("bench", "--seeds", "0"), "--seeds"),
        (("bench", "--preset", "quik"), "did you mean 'quick'?"),
        (("bench", "--preset", "quick", "--scenario", "x.json"), "exclude each other"),
        (("bench", "--scenario", "no.json"), "no.json does not exist"),
        (("bench", "--filters", "inverse-dept"), "did you mean 'inverse-depth'?"),
        (("bench", "--filters", ","), "at least one filter"),
        (("bench", "--filters", '{name = "hybrid"'), '--filters must be names, or tables such as {name = "hybrid",'),
        (
            ("bench", "--filters", '{name = "hybrid", gate = 0.9}'),
            "filters has no key 'gate'. Known: label, name, options",
        ),
        (("bench", "--filters", TABLE.replace("hybrid", "hybird")), "landmark must be one of 'inverse-depth', "),
        (("bench", "--filters", TABLE.replace("_limit", "_limt")), "did you mean 'linearity_limit'?"),
        (("bench", "--filters", TABLE.replace("0.02", "-1")), "linearity_limit must be a finite number > 0, got -1"),
        (("bench", "--set", "gate=tight"), "gate must be a probability"),
        (("bench", "--set", "gate=2"), "gate must be a probability"),
        (("bench", "--set", "noise.independent_pixels=-1"), "must be a finite number > 0"),
        (("replay",), "argument"),
        (("replay", "nowhere"), "nowhere does not exist: give a folder with a recording"),
        (("view", "nowhere"), "nowhere does not exist: give the directory of a run"),
        (("report", "nowhere"), "nowhere does not exist: give the directory of a run"),
        (("report", "."), "holds no run: it has no settings.json"),
        (("report", __file__), "is a file: give the directory of a run"),
        (("report", "nowhere", "nor here"), "nowhere does not exist"),
        (("report", "a", "b", "c"), "several need --fail-if-worse"),
        (("report", "a", "b", "--markdown", "gate.md"), "need --fail-if-worse"),
        (("report", "a", "b", "--limit", "3"), "need --fail-if-worse"),
        (("report", "a", "--fail-if-worse"), "needs a second run"),
        (("report", "a", "b", "--fail-if-worse", "--out", "page"), "leave --out and --trajectories out"),
        (("filters", "check", "inverse-dept"), "did you mean 'inverse-depth'?"),
        (("scenes", "render", "twon", "--out", "x.png"), "'town'"),
        (("scenes", "render", "town", "--out", "x.bmp"), ".png"),
    ],
)
def test_wrong_use_gets_one_line_and_exit_code_2(command, tmp_path, monkeypatch, arguments, hint):
    monkeypatch.chdir(tmp_path)
    code, _, err = command(*arguments)
    assert code == 2
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert hint in err
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_recording_and_a_damaged_result_are_named(command, tmp_path):
    folder = kitti07(tmp_path / "drive")
    (folder / "tracks.npz").write_bytes((folder / "tracks.npz").read_bytes()[:1000])
    code, _, err = command("replay", folder, "--out", tmp_path / "run")
    assert (code, err.count("\n")) == (2, 1)
    assert "tracks.npz is damaged" in err
    command(*BENCH, "--out", tmp_path / "bench", "--filters", "euclidean")
    trial = tmp_path / "bench" / "trials" / "seed-0001" / "euclidean.npz"
    trial.write_bytes(trial.read_bytes()[:1000])
    for again in (("report", tmp_path / "bench"), (*BENCH, "--out", tmp_path / "bench", "--filters", "euclidean")):
        code, _, err = command(*again)
        assert (code, err.count("\n")) == (2, 1)
        assert "seed-0001/euclidean.npz is damaged" in err


def test_other_settings_never_overwrite_results(command, tmp_path):
    command(*BENCH, "--out", tmp_path / "run", "--filters", "euclidean")
    code, _, err = command(
        *BENCH, "--out", tmp_path / "run", "--filters", "euclidean", "--set", "noise.independent_pixels=2"
    )
    assert code == 2
    assert "choose another output directory" in err


@pytest.mark.parametrize(
    ("arguments", "wrong"),
    [
        (("replay", "nosuch"), "nosuch does not exist"),
        (("bench", "--policy", "nosuch"), "policy must be one of"),
        (("bench", "--filters", "nosuch"), "filter must be one of"),
        (("bench", "--preset", "turn", "--frames", "1000"), "frames must be at most 80"),
        (("bench", "--preset", "turn", "--rig", "nosuch"), "rig must be one of"),
    ],
)
def test_what_does_not_exist_is_refused_before_a_filter_is_compiled(command, monkeypatch, arguments, wrong):
    monkeypatch.setattr("stereo_slam_env.benchmark.campaign.make_with_common_options", None)
    code, _, err = command(*arguments)
    assert (code, wrong in err) == (2, True), err


@pytest.mark.parametrize("arguments", [(), ("filters",), ("scenes",), ("--help",), ("bench", "-h")])
def test_help_is_there_when_it_is_needed(command, arguments):
    code, out, err = command(*arguments)
    assert (code, err) == (0, "")
    assert "Usage: stereo-slam" in out


def test_the_version_is_told(command):
    assert command("--version")[1] == f"stereo-slam {sse.__version__}\n"


def test_what_a_report_of_a_bug_should_hold_is_printed(capsys):
    sse.show_versions()
    out = capsys.readouterr().out
    assert re.search(rf"^stereo-slam-env +{re.escape(sse.__version__)}$", out, re.MULTILINE)
    assert re.search(rf"^numpy +{re.escape(np.__version__)}$", out, re.MULTILINE)
    assert re.search(r"^pybullet +3\.", out, re.MULTILINE)


def test_the_package_is_a_command_too():
    command = [sys.executable, "-m", "stereo_slam_env", "--version"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"stereo-slam {sse.__version__}\n", "")


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        ("stereo-slam ev", {"evaluate"}),
        ("stereo-slam evaluate --ag", {"--against"}),
        ("stereo-slam bench --preset tu", {"turn"}),
        ("stereo-slam filters check inv", {"inverse-depth"}),
    ],
)
def test_the_shell_completes_commands_options_and_names(words, completed):
    asked = {"_STEREO_SLAM_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    command = [sys.executable, "-m", "stereo_slam_env"]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, **asked}, capture_output=True, text=True, timeout=100)
    assert set(done.stdout.split()) == completed


@pytest.mark.parametrize("arguments", [("filters", "list"), ("policies", "list"), ("scenes", "list")])
def test_lists_are_printed_as_json_too(command, arguments):
    _, out, _ = command(*arguments)
    code, text, err = command(*arguments, "--json")
    assert (code, err) == (0, "")
    listed = json.loads(text)
    for title, line in listed.items():
        assert title in out
        assert all(name in out for name in (line if isinstance(line, dict) else [line]))


def test_checks_of_a_filter_are_printed_as_json_too(command):
    code, out, _ = command("filters", "check", "inverse-depth", "--json")
    found = json.loads(out)
    assert (code, found["filter"], found["failed"]) == (0, "inverse-depth", [])
    assert len(found["passed"]) > 10


def test_help_loads_nothing_heavy():
    code = (
        "import sys; from stereo_slam_env.cli import app; app.main(['--help']); "
        "heavy = {'matplotlib', 'pybullet', 'joblib', 'cv2', 'rich.progress', 'stereo_slam_env.benchmark'}; "
        "sys.exit(str(heavy & set(sys.modules)) if heavy & set(sys.modules) else 0)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr


def test_ctrl_c_before_a_command_has_begun_is_an_exit_code_and_no_traceback(monkeypatch):
    def interrupted(**_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "app", interrupted)
    assert cli.main([]) == 130


def test_ctrl_c_in_a_destructor_ends_the_command_too(monkeypatch):
    class Destroyed:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGINT)

    def works_on(**_: object) -> None:
        Destroyed()
        for _second in range(20):
            time.sleep(1.0)

    monkeypatch.setattr(cli, "app", works_on)
    begun = time.monotonic()
    assert cli.main([]) == 130
    assert time.monotonic() - begun < 15.0


@pytest.mark.slow
def test_ctrl_c_says_what_is_kept_and_the_same_command_goes_on(third_party, tmp_path):
    arguments = ("bench", "--preset", "reference-drive", "--seeds", 2, "--frames", 10, "--jobs", 1)
    arguments = (*arguments, "--filters", "inverse-depth,waits", "--out", tmp_path / "run")
    running = process(*arguments, folders=(ROOT, third_party), cwd=tmp_path)
    deadline = time.monotonic() + 300
    while not (tmp_path / "waiting").exists():
        assert running.poll() is None, running.communicate()[1]
        assert time.monotonic() < deadline, "the second trial did not begin in five minutes"
        time.sleep(0.02)
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=60)
    assert running.returncode == 130
    assert "Traceback" not in err
    assert "finished trials are kept in" in err
    (resume,) = [line.removeprefix("to go on: stereo-slam ") for line in err.splitlines() if "to go on" in line]
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "run").glob("trials/*/*.npz")}
    assert len(kept) == 1
    (tmp_path / "go").touch()
    again = process(*resume.split(), folders=(ROOT, third_party), cwd=tmp_path)
    out, err = again.communicate(timeout=120)
    assert again.returncode == 0, err
    assert "report.html" in out
    assert len(list((tmp_path / "run").glob("trials/*/*.npz"))) == 4
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


def test_all_filters_and_presets_of_ours_are_in_one_group():
    for groups, names in ((FILTER_GROUPS, available_filters()), (PRESET_GROUPS, presets())):
        grouped = [name for group in groups.values() for name in group]
        assert len(grouped) == len(set(grouped))
        assert set(grouped) == {name for name in names if "my-" not in name}


def test_older_names_of_filters_resolve_and_are_not_listed():
    assert filter_factory("shared-anchor") is filter_factory("inverse-depth")
    for name in ("shared-anchor", "hybrid"):
        assert name not in available_filters()
        assert callable(filter_factory(name))


@pytest.mark.parametrize(
    ("setting", "complaint"),
    [
        ("gate", "--set must be KEY=VALUE"),
        ("=1", "--set must be KEY=VALUE"),
        ("noise..diagonal=1", "--set must be KEY=VALUE"),
        ("gait=0.9", "scenario has no key 'gait', did you mean 'gate'"),
        ("search=sideways", "search must be one of flow, forecast, got 'sideways'"),
        ("seeds=0.5", "seeds must be whole numbers"),
        ("options.rout=town", "did you mean 'route'"),
    ],
)
def test_a_setting_that_is_none_is_refused_before_any_work(command, tmp_path, setting, complaint):
    code, _, err = command("bench", "--set", setting, "--out", tmp_path / "run")
    assert (code, err.count("\n")) == (2, 1)
    assert complaint in err
    assert not (tmp_path / "run").exists()


def test_a_setting_does_not_override_what_a_grid_varies(command, tmp_path):
    for setting in ("noise=none", "noise.diagonal=[1, 1, 1]"):
        code, _, err = command("bench", "--preset", "mismatch", "--set", setting, "--out", tmp_path / "run")
        assert code == 2
        assert "the grid of mismatch varies it" in err


def test_an_option_that_moved_is_refused_with_the_field_that_it_became(command):
    for option, field in (("--gate", "gate="), ("--sigma-px", "noise.independent_pixels="), ("--search", "search=")):
        code, _, err = command("bench", option, "1")
        assert (code, f"--set {field}" in err) == (2, True)
    code, _, err = command("replay", "somewhere", "--reference=kind=ins")
    assert (code, "--set options.reference" in err) == (2, True)


def test_settings_are_completed_from_the_tree_of_scenarios():
    keys = setting_keys()
    assert {"gate", "motion.sigma_acceleration", "options.reference", "options.path"} <= set(keys)
    assert len(set(keys)) == len(keys)


def test_a_filter_of_the_working_directory_is_checked(command, tmp_path, monkeypatch):
    (tmp_path / "handed_in.py").write_text("from filters import InverseDepthStereoEKF as Mine\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    code, out, _ = command("filters", "check", "handed_in:Mine")
    assert (code, "0 failed" in out) == (0, True)
    for wrong in ("handed_in:Yours", "nosuch:Mine", "handed_in:"):
        code, _, err = command("filters", "check", wrong)
        assert (code, "must be a filter or MODULE:CLASS" in err) == (2, True)
