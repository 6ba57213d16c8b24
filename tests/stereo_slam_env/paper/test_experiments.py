"""Experiments are done once, kept, and done again only where something has changed (3 s)."""

from functools import partial

import numpy as np
import pytest

from stereo_slam_env import paper
from stereo_slam_env.benchmark import Backend

ALONE = Backend(jobs=1)


def squares(count, log):
    with open(log, "a") as lines:
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
    return {f"of-{n}": partial(squares, n, str(log)) for n in counts}


def done(log):
    return [int(line) for line in log.read_text().split()]


def results_of(experiments, folder, backend=ALONE, progress=lambda done, total: None):
    found = paper.run_experiments(experiments, folder, backend, progress)
    return {name: arrays["squares"].tolist() for name, arrays in found.items()}


def test_nothing_is_done_twice(tmp_path, log):
    first = results_of(work(log, 2, 3), tmp_path / "kept")
    again = results_of(work(log, 2, 3, 4), tmp_path / "kept")
    assert done(log) == [2, 3, 4]
    assert first == {"of-2": [0, 1], "of-3": [0, 1, 4]}
    assert again == first | {"of-4": [0, 1, 4, 9]}


def test_an_interruption_keeps_what_is_finished(tmp_path, log):
    with pytest.raises(KeyboardInterrupt):
        results_of({**work(log, 2, 3), "broken": partial(broken)}, tmp_path / "kept")
    results_of(work(log, 2, 3), tmp_path / "kept")
    assert done(log) == [2, 3]


def test_other_arguments_or_other_code_are_done_again(tmp_path, log, monkeypatch):
    results_of(work(log, 2), tmp_path / "kept")
    results_of({"of-2": partial(squares, 5, str(log))}, tmp_path / "kept")
    monkeypatch.setattr(paper, "versions", lambda: {"code": "other"})
    results_of({"of-2": partial(squares, 5, str(log))}, tmp_path / "kept")
    assert done(log) == [2, 5, 5]


def test_a_damaged_file_is_done_again(tmp_path, log):
    results_of(work(log, 2), tmp_path / "kept")
    path = tmp_path / "kept" / "of-2.npz"
    path.write_bytes(path.read_bytes()[:40])
    assert results_of(work(log, 2), tmp_path / "kept")["of-2"] == [0, 1]
    assert done(log) == [2, 2]


def test_progress_is_told(tmp_path, log):
    told = []
    results_of(work(log, 2), tmp_path / "kept")
    results_of(work(log, 2, 3), tmp_path / "kept", progress=lambda done, total: told.append((done, total)))
    assert told == [(1, 2), (2, 2)]


def test_several_processes_find_the_same(tmp_path, log):
    alone = results_of(work(log, 2, 3, 4), tmp_path / "a")
    assert results_of(work(log, 2, 3, 4), tmp_path / "b", Backend(jobs=2)) == alone
