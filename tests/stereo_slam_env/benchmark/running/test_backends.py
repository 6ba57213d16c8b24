"""Where trials run makes no difference to what comes out: real local clusters of several processes (40 s)."""

import itertools
import os
import time
from functools import partial
from typing import get_args

import numpy as np
import pytest

from stereo_slam_env.benchmark import Scenario, run_benchmark
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.running import backends
from stereo_slam_env.benchmark.running.backends import Backend, BackendName
from stereo_slam_env.benchmark.scenarios.scenario import filter_choice

FILTERS = (filter_choice("inverse-depth"), filter_choice("euclidean"))
SHORT = Scenario("short", ReferenceSource("short_turn"), FILTERS, seeds=(0, 1), frames=5, gate=None, metrics=("map",))


def where_i_am(number):
    time.sleep(0.2)
    return number, os.getpid()


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The result of running everything here, one after the other."""
    return run_benchmark(SHORT, tmp_path_factory.mktemp("alone") / "out", jobs=1)


@pytest.mark.slow
@pytest.mark.parametrize("name", get_args(BackendName))
def test_results_are_those_of_the_run_in_one_process(name, alone, tmp_path):
    if name != "processes":
        pytest.importorskip("dask.distributed" if name == "dask" else name, reason=f"needs the extra {name}")
    elsewhere = run_benchmark(SHORT, tmp_path / "out", jobs=2, backend=name)
    assert [(r.seed, r.filter_name) for r in elsewhere.runs] == [(r.seed, r.filter_name) for r in alone.runs]
    for here, there in zip(alone.runs, elsewhere.runs, strict=True):
        np.testing.assert_array_equal(here.positions, there.positions)
        np.testing.assert_array_equal(here.pose_nees, there.pose_nees)
    for key, bound in alone.cells[0].bounds.items():
        np.testing.assert_array_equal(bound.pose, elsewhere.cells[0].bounds[key].pose)


@pytest.mark.slow
def test_tasks_are_spread_over_processes():
    with Backend("processes", jobs=2).started() as run_all:
        results = dict(run_all(where_i_am, range(4)))
    assert sorted(results) == [0, 1, 2, 3]
    assert len(set(results.values())) >= 2
    assert os.getpid() not in results.values()


def test_one_job_is_done_here():
    with Backend("processes", jobs=1).started() as run_all:
        assert list(run_all(where_i_am, [7])) == [(7, os.getpid())]


def test_tasks_are_taken_as_they_are_needed():
    taken = []

    def tasks():
        for number in range(3):
            taken.append(number)
            yield number

    with Backend("processes", jobs=1).started() as run_all:
        results = run_all(where_i_am, tasks())
        next(results)
        assert taken == [0]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"name": "slurm"}, "backend must be one of processes, dask, got 'slurm'"),
        ({"jobs": 0}, "jobs must be >= 1, got 0"),
        ({"address": "tcp://10.0.0.1:8786"}, "address needs the backend dask"),
    ],
)
def test_impossible_backends_are_refused(arguments, complaint):
    with pytest.raises(ValueError, match=complaint):
        Backend(**arguments)


def test_a_cluster_that_does_not_answer_is_told_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(backends, "SECONDS_TO_ANSWER", 1)
    pytest.importorskip("dask.distributed", reason="needs the extra dask")
    scenario = SHORT.replaced(seeds=(0,))
    with pytest.raises(ValueError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        run_benchmark(scenario, tmp_path / "out", backend="dask", address="tcp://127.0.0.1:9")


def lost_once(place, number):
    """The number; its worker is lost the first time that it is 1."""
    if number == 1 and not (place / "lost").exists():
        (place / "lost").touch()
        os.kill(os.getpid(), 9)
    return number


def lost_always(number):
    if number == 1:
        os.kill(os.getpid(), 9)
    return number


@pytest.mark.slow
@pytest.mark.timeout(60)
def test_what_a_lost_worker_of_a_cluster_had_is_done_once_more(tmp_path, caplog):
    pytest.importorskip("dask.distributed", reason="needs the extra dask")
    with Backend("dask", jobs=2).started() as run_all:
        assert sorted(run_all(partial(lost_once, tmp_path), range(4))) == [0, 1, 2, 3]
        assert "a worker was lost" in caplog.text
        with pytest.raises(ChildProcessError, match=r"\Aworkers were lost twice [^\n]*: what is finished is kept\Z"):
            list(run_all(lost_always, range(4)))


def interval(seconds):
    began = time.time()
    time.sleep(seconds)
    return began, time.time()


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_workers_that_come_late_are_used():
    """As those of a queue: with one worker no two tasks overlap."""
    distributed = pytest.importorskip("dask.distributed", reason="needs the extra dask")
    cluster = distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0")
    with cluster, Backend("dask", address=cluster.scheduler_address).started() as run_all:
        results = run_all(interval, [0.2] * 3 + [0.5] * 40)
        first = next(results)
        cluster.scale(3)
        intervals = sorted([first, *results])
    assert any(later[0] < earlier[1] for earlier, later in itertools.pairwise(intervals))


@pytest.mark.slow
@pytest.mark.timeout(60)
def test_what_dask_has_not_finished_is_given_up_with_the_run():
    pytest.importorskip("dask.distributed", reason="needs the extra dask")
    with Backend("dask", jobs=2).started() as run_all:
        assert sorted(number for number, _ in run_all(where_i_am, range(5))) == [0, 1, 2, 3, 4]
        results = run_all(time.sleep, [0.0, 3600.0, 3600.0])
        assert next(results) is None
        results.close()


def test_what_a_task_raises_is_no_lost_worker():
    def fails(number):
        raise ZeroDivisionError

    with Backend("processes", jobs=2).started() as run_all, pytest.raises(ZeroDivisionError):
        list(run_all(fails, range(4)))
