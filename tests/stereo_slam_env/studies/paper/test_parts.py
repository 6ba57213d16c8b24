"""Parts of the work are done once, kept, and done again only where something has changed (3 s)."""

from functools import partial

import numpy as np
import pytest
from stereo_slam_env.studies.paper.parts import Part, run_parts

from stereo_slam_env.studies.paper import parts as parts_module


def squares(count, log):
    with log.open("a") as lines:
        lines.write(f"{count}\n")
    return {"squares": np.arange(count) ** 2}


def broken():
    raise KeyboardInterrupt


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.txt"
    path.touch()
    return path


def work(log, *counts):
    return [Part(f"part-{n}", {"count": n}, partial(squares, n, log)) for n in counts]


def done(log):
    return [int(line) for line in log.read_text().split()]


def test_results_come_by_name(tmp_path, log):
    results = run_parts(work(log, 2, 3), tmp_path / "parts")
    assert results["part-3"]["squares"].tolist() == [0, 1, 4]


def test_nothing_is_done_twice(tmp_path, log):
    first = run_parts(work(log, 2, 3), tmp_path / "parts")
    again = run_parts(work(log, 2, 3, 4), tmp_path / "parts")
    assert done(log) == [2, 3, 4]
    assert again["part-2"]["squares"].tolist() == first["part-2"]["squares"].tolist()


def test_an_interruption_keeps_what_is_finished(tmp_path, log):
    with pytest.raises(KeyboardInterrupt):
        run_parts([*work(log, 2, 3), Part("broken", {}, broken)], tmp_path / "parts")
    run_parts(work(log, 2, 3), tmp_path / "parts")
    assert done(log) == [2, 3]


def test_other_inputs_or_other_code_are_done_again(tmp_path, log, monkeypatch):
    run_parts(work(log, 2), tmp_path / "parts")
    run_parts([Part("part-2", {"count": 5}, partial(squares, 5, log))], tmp_path / "parts")
    monkeypatch.setattr(parts_module, "code_digest", lambda without: "other")
    run_parts([Part("part-2", {"count": 5}, partial(squares, 5, log))], tmp_path / "parts")
    assert done(log) == [2, 5, 5]


def test_a_damaged_file_is_done_again(tmp_path, log):
    run_parts(work(log, 2), tmp_path / "parts")
    path = tmp_path / "parts" / "part-2.npz"
    path.write_bytes(path.read_bytes()[:40])
    assert run_parts(work(log, 2), tmp_path / "parts")["part-2"]["squares"].tolist() == [0, 1]
    assert done(log) == [2, 2]


def test_what_measures_time_is_done_last_and_progress_is_told(tmp_path, log):
    told = []
    timed = Part("timed", {}, partial(squares, 9, log), alone=True)
    run_parts([timed, *work(log, 2, 3)], tmp_path / "parts", progress=lambda n, total: told.append((n, total)))
    assert done(log) == [2, 3, 9]
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_several_processes_find_the_same(tmp_path, log):
    alone = run_parts(work(log, 2, 3, 4), tmp_path / "a")
    together = run_parts(work(log, 2, 3, 4), tmp_path / "b", jobs=2)
    assert {name: arrays["squares"].tolist() for name, arrays in together.items()} == {
        name: arrays["squares"].tolist() for name, arrays in alone.items()
    }
