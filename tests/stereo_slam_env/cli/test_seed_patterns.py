"""`evaluate` of all seeds of a system by a pattern, as a stranger's folders have them (10 s)."""

import json
from dataclasses import replace

import numpy as np
import pytest

import stereo_slam_env as sse
from stereo_slam_env.cli import app as cli

from ..evaluation.test_state_claims import odometry
from ..evaluation.test_trajectory_runs import away

TRUTH = "mav0/state_groundtruth_estimate0/data.csv"


@pytest.fixture
def evaluate(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "160")
    monkeypatch.chdir(tmp_path)

    def command(*arguments):
        code = cli.main(["evaluate", *map(str, arguments)])
        captured = capsys.readouterr()
        return code, " ".join(captured.out.split()), captured.err

    return command


def drive(folder, seed=0, change=lambda estimate: estimate, longer=50):
    """A folder as `scenes record` leaves it, whose truth goes on after the estimate, and an estimate in it."""
    estimate, truth = odometry(80 + longer, seed)
    (folder / "mav0" / "state_groundtruth_estimate0").mkdir(parents=True)
    q = truth.orientations[:, [3, 0, 1, 2]]
    states = [belief.values for belief in truth.states.values()]
    rows = np.column_stack([1e9 * truth.timestamps + 1.4e18, truth.positions, q, *states])
    np.savetxt(folder / TRUTH, rows, delimiter=",", fmt=["%.0f", *["%.12g"] * 16])
    estimate = change(estimate.rows(slice(0, 80)))
    estimate = replace(estimate, timestamps=estimate.timestamps + 1.4e9, gauge="fixed")
    sse.save_trajectory(folder / "est.square", estimate)
    sse.save_trajectory(folder / "est.tum", estimate)
    return folder


def test_all_seeds_are_judged_together_and_a_missing_one_is_a_failed_one(evaluate, tmp_path):
    for k, name in enumerate("abc"):
        drive(tmp_path / f"run_{name}", k)
    (tmp_path / "run_b" / "est.square").unlink()
    drive(tmp_path / "run_d", 3, away)
    (tmp_path / "run_e").mkdir()  # a folder without a drive is none
    for truth in ([], ["--truth", f"run_{{seed}}/{TRUTH}"]):
        code, out, err = evaluate("run_{seed}/est.square", *truth, "--out", "scores")
        assert (code, "report: " in out) == (0, True), err
        assert "Of 4 runs, 1 diverged, " in out
        assert "1 left nothing to score" in out
        assert "b (no estimate: run_{seed}" in out
        assert "2 runs together: pose ANEES / 6" in out
    page = (tmp_path / "scores" / "report.html").read_text(encoding="utf-8")
    assert "Of 4 runs, 1 diverged" in page
    assert "position RMSE, m" in page
    runs = json.loads((tmp_path / "scores" / "score.json").read_text())["runs"]
    assert (runs["runs"], list(runs["failed"]), list(runs["diverged"])) == (["a", "c"], ["b"], ["d"])


def test_positions_alone_and_empty_files_count(evaluate, tmp_path):
    for k in range(3):
        drive(tmp_path / f"{k:03d}", k)
    rows = np.loadtxt(tmp_path / "000" / "est.tum")
    np.savetxt(tmp_path / "000" / "est.tum", rows[:, :4])
    (tmp_path / "001" / "est.tum").write_text("")
    code, out, _ = evaluate("{seed}/est.tum", "--json")
    runs = json.loads(out)["runs"]
    assert code == 0
    assert (runs["errors"]["position"]["runs"], runs["errors"]["rotation"]["runs"]) == (2, 1)
    assert "has no rows" in runs["failed"]["001"]
    assert runs["claims"] == {}
    code, out, _ = evaluate("{seed}/est.tum", "--out", "scores")
    assert (code, "0 of 3 runs have a claim that can be judged" in out) == (0, True)


def test_one_estimate_has_its_truth_beside_it(evaluate, tmp_path):
    drive(tmp_path / "000")
    code, out, _ = evaluate("000/est.square")
    assert (code, "against data" in out, "est: position error" in out or "mine: position error" in out) == (
        0,
        True,
        True,
    )


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("{seed}/est.tum", "--truth", "{seed}/none.csv"), "no truth for {seed} = 0: "),
        (("{seed}/none.tum",), "matches no file"),
        (
            ("{seed}/est.tum", "{seed}/est.square", "--truth", "0/est.tum"),
            "names all runs of one system, got 2 estimates",
        ),
        (("{seed}/est.square", "--against", "0/est.tum"), "--against compares one estimate with another"),
        (("0/est.tum", "--truth", "{seed}/est.tum"), "0/est.tum is one estimate: write {seed}"),
        (("{seed}/bad.tum", "--truth", "0/est.tum"), "none of 1 runs can be scored, 0: "),
    ],
)
def test_patterns_that_cannot_be_judged_are_refused_in_a_line(evaluate, tmp_path, arguments, reason):
    drive(tmp_path / "0")
    (tmp_path / "0" / "bad.tum").write_text("nothing\n")
    code, out, err = evaluate(*arguments)
    assert (code, out) == (2, "")
    assert reason in err
    assert err.count("\n") == 1
