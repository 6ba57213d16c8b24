"""Where trials run: in this process, in processes of this machine, or on a cluster, all through joblib."""

from __future__ import annotations

import itertools
import logging
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import joblib
from threadpoolctl import threadpool_limits

from filters.extras import install_command

Task = TypeVar("Task")
Result = TypeVar("Result")

ENGINES = {
    "processes": "processes of this machine",
    "ray": "a Ray cluster, or one on this machine; needs the extra ray",
    "dask": "a Dask cluster, or one on this machine; needs the extra dask",
}
TASKS_IN_A_ROUND = 4
SECONDS_TO_ANSWER = 15


@dataclass(frozen=True)
class Engine:
    """How to run tasks.

    Attributes
    ----------
    name : str
        A key of `ENGINES`.
    jobs : int
        Trials at a time, each on one core with one BLAS thread.
    address : str, optional
        Of the cluster's scheduler; None: a cluster of `jobs` processes on this machine, for this run.

    Raises
    ------
    ValueError
        No such engine, jobs < 1, or an address that the engine does not take.
    """

    name: str = "processes"
    jobs: int = 2
    address: str | None = None

    def __post_init__(self) -> None:
        if self.name not in ENGINES:
            raise ValueError(f"engine must be one of {', '.join(ENGINES)}, got {self.name!r}")
        if type(self.jobs) is not int or self.jobs < 1:
            raise ValueError(f"jobs must be >= 1, got {self.jobs!r}")
        if self.address is not None and self.name == "processes":
            raise ValueError("address needs the engine ray or dask: processes run on this machine")

    @property
    def in_this_process(self) -> bool:
        """Whether tasks run one after the other right here."""
        return self.name == "processes" and self.jobs == 1

    @contextmanager
    def started(self) -> Iterator[Callable[[Callable[[Task], Result], Iterable[Task]], Iterator[Result]]]:
        """Yield a function like `map`, whose results come in the order in which they are ready.

        Tasks are taken from their iterable as processes become free.

        Raises
        ------
        ImportError
            The engine is not installed: the message says which extra brings it.
        ValueError
            The cluster cannot be reached.
        """
        if self.in_this_process:
            with threadpool_limits(limits=1):
                yield map
            return
        with ExitStack() as stack:
            stack.enter_context(_BACKENDS[self.name](self.jobs, self.address))

            yield self._in_rounds if self.name == "ray" else self._as_ready

    def _as_ready(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        workers = joblib.Parallel(n_jobs=self.jobs, batch_size=1, return_as="generator_unordered")
        results: Generator[Result, None, None] = workers(joblib.delayed(function)(task) for task in tasks)
        try:
            for result in results:  # noqa: UP028 ("yield from" would close them before what follows)
                yield result
        finally:
            with warnings.catch_warnings():  # who stops early knows that tasks are given up
                warnings.simplefilter("ignore", UserWarning)
                results.close()

    def _in_rounds(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """For joblib's back ends that only return when all is done: so that little is lost in an interruption."""
        waiting = iter(tasks)
        while round_of_tasks := list(itertools.islice(waiting, TASKS_IN_A_ROUND * self.jobs)):
            workers = joblib.Parallel(n_jobs=self.jobs, batch_size=1)
            yield from workers(joblib.delayed(function)(task) for task in round_of_tasks)


@contextmanager
def _processes(jobs: int, address: str | None) -> Iterator[None]:
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        yield


@contextmanager
def _ray(jobs: int, address: str | None) -> Iterator[None]:
    try:
        import ray
        from ray.util.joblib import register_ray
    except ImportError as error:
        raise ImportError(f"engine ray is not installed: {install_command('ray')}") from error
    ours, quietly = not ray.is_initialized(), {"log_to_driver": False, "logging_level": logging.ERROR}
    if ours:
        try:
            if address is None:
                ray.init("local", num_cpus=jobs, include_dashboard=False, **quietly)
            else:
                ray.init(address, **quietly)
        except (ConnectionError, OSError) as error:
            raise ValueError(f"no Ray cluster answers at {address}: {error}") from error
    register_ray()
    try:
        with joblib.parallel_config(backend="ray"):
            yield
    finally:
        if ours:
            ray.shutdown()


@contextmanager
def _dask(jobs: int, address: str | None) -> Iterator[None]:
    try:
        import dask

        dask.config.set({"logging.distributed": "error"})  # read by what follows, here and in the workers
        from dask.distributed import Client, LocalCluster
    except ImportError as error:
        raise ImportError(f"engine dask is not installed: {install_command('dask')}") from error
    with ExitStack() as stack:
        if address is None:
            cluster: Any = stack.enter_context(
                LocalCluster(n_workers=jobs, threads_per_worker=1, dashboard_address=":0")
            )
        else:
            cluster = address
        try:
            stack.enter_context(Client(cluster, timeout=SECONDS_TO_ANSWER))
        except OSError as error:
            raise ValueError(f"no Dask scheduler answers at {address}: {error}") from error
        with joblib.parallel_config(backend="dask"):
            yield


_BACKENDS = {"processes": _processes, "ray": _ray, "dask": _dask}
