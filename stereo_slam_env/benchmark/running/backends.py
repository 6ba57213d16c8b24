"""Backends of trials: this machine, or a Dask cluster.

On this machine each trial has a process of its own anyway (`isolation`), and a thread that waits for it is enough.
Where the system cannot fork, joblib's processes do the work themselves.
"""

from __future__ import annotations

import itertools
import logging
import os
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, TypeVar, get_args

import joblib
from threadpoolctl import threadpool_limits

from filters.contract.extras import install_command
from filters.contract.validation import first_line, type_name
from stereo_slam_env.benchmark.running.isolation import run_isolated, start_server, waiting_threads

Task = TypeVar("Task")
Result = TypeVar("Result")
RunAll = Callable[[Callable[[Task], Result], Iterable[Task]], Iterator[Result]]
Submit = Callable[[Callable[[Any], Any], Any], "Future[Any]"]

BackendName = Literal["processes", "dask"]
"""Processes of this machine, or a Dask cluster, which the extra `dask` brings."""
SECONDS_TO_ANSWER = 15
SECONDS_OF_A_TASK = 3600
_OF_WORKERS = ("joblib", "distributed", "concurrent")
"""Packages whose exceptions say that a worker was lost; what a task raises is never one of them."""

_DASK = {
    "logging.distributed": "error",  # read when `dask.distributed` is imported, here and in the workers
    "distributed.scheduler.allowed-failures": 0,  # a task whose worker is lost is done once more here, see `_twice`
    "distributed.admin.large-graph-warning-threshold": "10GB",  # a task holds its recording
}

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Backend:
    """Backend that runs tasks.

    Attributes
    ----------
    name : {"processes", "dask"}
        What runs them.
    jobs : int
        Trials at a time, each on one core with one BLAS thread.
    address : str, optional
        That of the cluster's scheduler; None: a cluster of `jobs` processes on this machine, for this run.

    Raises
    ------
    ValueError
        No such backend, jobs < 1, or an address that the backend does not take.
    """

    name: BackendName = "processes"
    jobs: int = 2
    address: str | None = None

    def __post_init__(self) -> None:
        backend_names = get_args(BackendName)
        if self.name not in backend_names:
            raise ValueError(f"backend must be one of {', '.join(backend_names)}, got {self.name!r}")
        if type(self.jobs) is not int or self.jobs < 1:
            raise ValueError(f"jobs must be >= 1, got {self.jobs!r}")
        if self.address is not None and self.name == "processes":
            raise ValueError("address needs the backend dask: processes run on this machine")

    @property
    def in_this_process(self) -> bool:
        """Whether tasks run one after the other right here."""
        return self.name == "processes" and self.jobs == 1

    @contextmanager
    def started(self, *, isolated: bool = False, preloaded: Sequence[str] = ()) -> Iterator[RunAll[Any, Any]]:
        """Yield a function like `map`, whose results come in the order in which they are ready.

        Tasks are taken from their iterable as processes become free. What a worker of a cluster had when it was lost is
        done once more.

        Parameters
        ----------
        isolated : bool
            Whether tasks do what takes time in processes of their own (`run_isolated`) already. Others are given one,
            for at most `SECONDS_OF_A_TASK`.
        preloaded : sequence of str
            Modules that processes of this machine start with.

        Raises
        ------
        ImportError
            The backend is not installed: the message says which extra brings it.
        ValueError
            The cluster cannot be reached.
        ChildProcessError
            Workers were lost twice, or the server of processes does not start.
        """
        if self.in_this_process:
            start_server(*preloaded)
            with threadpool_limits(limits=1):
                yield map
        elif self.name == "dask":
            with _dask(self.jobs, self.address) as (submit, workers):
                yield partial(_twice, partial(_as_completed, submit, workers))
        elif hasattr(os, "fork"):
            start_server(*preloaded)  # here, where Ctrl-C interrupts it
            yield self._in_threads if isolated else self._apart
        else:
            with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
                yield partial(_twice, self._as_ready)

    def _in_threads(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        with waiting_threads(self.jobs) as submit:
            yield from _as_completed(
                lambda function, task: submit(partial(function, task)), lambda: self.jobs, function, tasks
            )

    def _apart(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        return self._in_threads(partial(_in_own_process, function), tasks)

    def _as_ready(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        workers = joblib.Parallel(n_jobs=self.jobs, batch_size=1, return_as="generator_unordered")
        results: Generator[Result, None, None] = workers(joblib.delayed(function)(task) for task in tasks)
        try:
            for result in results:  # noqa: UP028 ("yield from" would close them before what follows)
                yield result
        finally:
            with warnings.catch_warnings():  # a caller that stops early knows that tasks are given up
                warnings.simplefilter("ignore", UserWarning)
                results.close()


def _as_completed(
    submit: Submit, at_a_time: Callable[[], int], function: Callable[[Task], Result], tasks: Iterable[Task]
) -> Iterator[Result]:
    """Results of what is submitted, so many tasks at a time as there are workers now."""
    waiting, running = iter(tasks), set[Future[Result]]()
    try:
        while True:
            for task in itertools.islice(waiting, max(0, at_a_time() - len(running))):
                running.add(submit(function, task))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    finally:
        for future in running:
            future.cancel()


def _twice(run_all: RunAll[Any, Any], function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
    """Run all, and where a worker is lost what it had, and what is left, once more."""
    begun: dict[int, Task] = {}
    remaining = enumerate(tasks)

    def noted(numbered: Iterable[tuple[int, Task]]) -> Iterator[tuple[int, Task]]:
        for number, task in numbered:
            begun[number] = task
            yield number, task

    for attempt in ("first", "second"):
        try:
            # The rest comes from the same iterator, after what had been begun.
            for number, result in run_all(
                partial(_numbered, function), noted(itertools.chain([*begun.items()], remaining))
            ):
                del begun[number]
                yield result
            return
        except Exception as error:
            if type(error).__module__.partition(".")[0] not in _OF_WORKERS:
                raise
            why = f"{type_name(error)}: {first_line(error)}"
            if attempt == "second":
                raise ChildProcessError(f"workers were lost twice ({why}): what is finished is kept") from error
            _log.warning("a worker was lost (%s): what it had is done once more", why)


def _in_own_process(function: Callable[[Task], Result], task: Task) -> Result:
    return run_isolated(lambda tell: function(task), silence_limit=SECONDS_OF_A_TASK)


def _numbered(function: Callable[[Task], Result], task: tuple[int, Task]) -> tuple[int, Result]:
    return task[0], function(task[1])


@contextmanager
def _dask(jobs: int, address: str | None) -> Iterator[tuple[Submit, Callable[[], int]]]:
    """Yield a function that submits work to Dask, and one that tells how many tasks it does at a time.

    Workers may come late, as those of a queue do.

    Not through joblib, whose callers wait for ever for a task that Dask gives up because it ends its workers (1.6.0).
    """
    try:
        import dask

        dask.config.set(_DASK)
        from dask.distributed import Client, LocalCluster
    except ImportError as error:
        raise ImportError(f"backend dask is not installed: {install_command('dask')}") from error
    with ExitStack() as stack:
        if address is None:
            cluster: Any = stack.enter_context(
                LocalCluster(n_workers=jobs, threads_per_worker=1, dashboard_address=":0")
            )
        else:
            cluster = address
        try:
            client = stack.enter_context(Client(cluster, timeout=SECONDS_TO_ANSWER))
        except OSError as error:
            raise ValueError(f"no Dask scheduler answers at {address}: {first_line(error)}") from error
        try:
            client.wait_for_workers(1, timeout=SECONDS_TO_ANSWER)
        except TimeoutError as error:  # one class since Python 3.11
            raise ValueError(f"the Dask cluster has no worker within {SECONDS_TO_ANSWER} s") from error
        executor = client.get_executor(pure=False)
        stack.callback(executor.shutdown, wait=False)
        yield executor.submit, lambda: max(1, sum(client.ncores().values()))
