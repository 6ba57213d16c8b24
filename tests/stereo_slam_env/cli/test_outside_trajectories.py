"""Trajectories of other programs as competitors of `bench`, as a user meets them (20 s, starting processes)."""

import json

import pytest

from stereo_slam_env.cli import app as cli

BENCH = ["bench", "--preset", "reference-turn", "--seeds", "2", "--frames", "12", "--jobs", "1", "--filters"]


@pytest.fixture
def bench(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("stereo_slam_env.report.benchmark_report.write_report", lambda out, *_, **__: out)

    def run(name, *arguments):
        code = cli.main([*BENCH, *arguments, "--out", str(tmp_path / name)])
        return code, capsys.readouterr().err

    return run


def test_a_trajectory_for_each_recording_is_a_competitor_with_the_figures_of_its_filter(bench, tmp_path):
    assert bench("first", "shared-anchor")[0] == 0
    pattern = tmp_path / "first" / "trajectories" / "seed-000{seed}" / "shared-anchor.square"
    assert bench("second", "shared-anchor", "--trajectory", f"again={pattern}")[0] == 0
    filters = json.loads((tmp_path / "second" / "summary.json").read_text())["filters"]
    again, own = filters["again"], filters["shared-anchor"]
    for figure in ("position_rmse_m", "pose_anees", "ate_rigid_m"):
        assert again[figure] == pytest.approx(own[figure], rel=1e-6)
    assert again["ms_per_frame"] is None
    assert own["ms_per_frame"] > 0

    # A file that has changed is another trajectory: it is read again.
    one = tmp_path / "first" / "trajectories" / "seed-0001" / "shared-anchor.square"
    one.write_text((tmp_path / "first" / "trajectories" / "seed-0001" / "truth.square").read_text())
    assert bench("second", "shared-anchor", "--trajectory", f"again={pattern}")[0] == 0
    filters = json.loads((tmp_path / "second" / "summary.json").read_text())["filters"]
    assert filters["again"]["position_rmse_m"] < again["position_rmse_m"]


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ("est.tum", "--trajectory must be LABEL=FILE, as orbslam3=est.tum, got 'est.tum'"),
        ("a={seed}.tum", "0.tum does not exist"),
        ("a=est.tum", "a has one file for several recordings: write {seed} in its name"),
    ],
)
def test_a_trajectory_that_cannot_stand_there_is_refused_before_the_work(bench, said, reason, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, told = bench("run", "shared-anchor", "--trajectory", said)
    assert code == 2
    assert reason in told
    assert told.count("\n") == 1
    assert not (tmp_path / "run").exists()
