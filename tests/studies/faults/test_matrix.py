"""The fault matrix: how drives are judged, and the command (15 s)."""

import json

import numpy as np
import pytest

from filters.monitor import Alarm, Cause
from stereo_slam_env.benchmark.scenarios.scenario import filter_choice
from studies.faults import FAULTS, FaultMatrix, Session, run_matrix
from studies.faults.__main__ import main
from studies.faults.matrix import first_cause, in_words, judge

ONSET = FAULTS["outliers-30"].begins


def session(error=0.1, nees=1.0, alarms=(), broken="", changes_at=10.0):
    """A drive of 20 s at 5 m/s, good until `changes_at`."""
    times = np.arange(200) * 0.1
    later = times >= changes_at - 1e-9
    errors, claims = np.where(later, error, 0.1), np.where(later, nees, 1.0)
    told = tuple(Alarm(time, Cause.INNOVATIONS, "so") for time in alarms)
    return Session(times, errors, 5.0 * times, claims, told, 0, broken)


def judged(*arguments, **changes):
    return judge(session(*arguments, **changes), "outliers-30", "some-filter", 0)


@pytest.mark.parametrize(
    ("changes", "outcome"),
    [
        ({}, "ok"),
        ({"error": 2.0}, "degraded"),
        ({"nees": 20.0}, "degraded"),
        ({"error": 20.0}, "diverged"),
        ({"nees": 101.0}, "diverged"),
        ({"error": np.nan}, "diverged"),
        ({"broken": "raised"}, "diverged"),
    ],
)
def test_outcomes(changes, outcome):
    assert judged(**changes).outcome == outcome


@pytest.mark.parametrize(
    ("alarm", "in_time", "after"),
    [(9.0, True, -1.0), (12.0, True, 2.0), (12.1, False, 2.1), (ONSET - 1.0, False, None)],
)
def test_an_alarm_is_in_time_if_it_comes_after_the_fault_and_two_seconds_after_divergence(alarm, in_time, after):
    run = judged(error=20.0, alarms=[alarm])
    assert run.diverged_at == pytest.approx(10.0)
    assert run.in_time is in_time
    assert run.detected_after == (None if after is None else pytest.approx(after))


def test_where_nothing_diverges_there_is_nothing_to_detect():
    run = judged(alarms=[9.0])
    assert (run.in_time, run.detected_after, run.causes) == (None, None, ("INNOVATIONS",))


def test_the_table_says_how_many_of_each():
    runs = (judged(), judged(error=20.0, alarms=[9.0]), judged(error=20.0), judged(broken="it raised"))
    cell = FaultMatrix(runs).runs_of("outliers-30", "some-filter")
    assert in_words(cell) == "1 ok; 3 diverged; told 1/3; BROKEN: it raised"
    assert first_cause(cell) == Cause.INNOVATIONS.value


def test_the_table_says_how_late_it_was_told():
    late = FaultMatrix((judged(error=20.0, alarms=[11.5]),))
    assert in_words(late.runs_of("outliers-30")) == "diverged; told 1/1, after 1.5 s"


def test_what_cannot_be_seen_is_counted_apart():
    told, untold = (judge(session(error=20.0, alarms=a), "outliers-30", "f", 0) for a in ([9.0], []))
    hidden = judge(session(error=20.0), "baseline-5", "f", 0)
    false = judge(session(alarms=[3.0]), "nominal", "f", 0)
    summary = FaultMatrix((told, untold, hidden, false)).summary()
    assert (summary["diverged"], summary["detected_in_time"], summary["diverged_hidden"]) == (2, 1, 1)
    assert (summary["nominal"], summary["false_alarms"]) == (1, 1)


def test_every_fault_says_what_it_is():
    for name, fault in FAULTS.items():
        assert name == name.lower()
        assert 10 < len(fault.line) < 80


def test_divergence_is_told_and_a_good_drive_is_left_alone():
    matrix = run_matrix([filter_choice("shared-anchor")], ("nominal", "kidnapped", "duplicated-frames"), seeds=1)
    outcomes = {run.fault: (run.outcome, run.in_time, bool(run.causes)) for run in matrix.runs}
    assert outcomes["nominal"] == ("ok", None, False)
    assert outcomes["kidnapped"] == ("diverged", True, True)
    assert outcomes["duplicated-frames"][2]
    assert matrix.broken == ()


def test_the_command_writes_its_table(tmp_path, capsys):
    arguments = ["nan", "--filters", "euclidean", "--seeds", "1", "--jobs", "1", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "contract kept in 1 of 1 runs" in out
    kept = json.loads((tmp_path / "out" / "faults.json").read_text())
    assert kept["runs"][0]["refused"] > 10
    assert "| nan | ok |" in (tmp_path / "out" / "faults.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [(["outlier-10"], "outliers-10"), (["--filters", "nobody", "nominal"], "nobody"), (["--seeds", "0"], "seeds")],
)
def test_a_wrong_word_gets_one_line(arguments, word, capsys):
    with pytest.raises(SystemExit) as refusal:
        main(arguments)
    assert refusal.value.code == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert "error: " in line
    assert word in line


def test_the_faults_are_listed(capsys):
    assert main(["--list"]) == 0
    assert all(name in capsys.readouterr().out for name in ["kidnapped"])
