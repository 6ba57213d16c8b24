"""Where trials run: in this process, in processes of this machine, or on a cluster, all through joblib."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import joblib

Task = TypeVar("Task")
Result = TypeVar("Result")

ENGINES = {
    "processes": "processes of this machine",
    "ray": "a Ray cluster, or one on this machine; needs the extra ray",
    "dask": "a Dask cluster, or one on this machine; needs the extra dask",
}


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
            yield lambda function, tasks: map(function, tasks)
            return
        with ExitStack() as stack:
            stack.enter_context(_BACKENDS[self.name](self.jobs, self.address))

            def run(function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
                workers = joblib.Parallel(n_jobs=self.jobs, batch_size=1, return_as="generator_unordered")
                results: Iterator[Result] = workers(joblib.delayed(function)(task) for task in tasks)
                return results

            yield run


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
        raise ImportError("engine ray is not installed: pip install 'stereo-slam-env[ray]'") from error
    ours = not ray.is_initialized()
    if ours:
        try:
            if address is None:
                ray.init("local", num_cpus=jobs, include_dashboard=False, log_to_driver=False)
            else:
                ray.init(address, log_to_driver=False)
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
        from dask.distributed import Client, LocalCluster
    except ImportError as error:
        raise ImportError("engine dask is not installed: pip install 'stereo-slam-env[dask]'") from error
    with ExitStack() as stack:
        if address is None:
            cluster: Any = stack.enter_context(
                LocalCluster(n_workers=jobs, threads_per_worker=1, dashboard_address=None, silence_logs=True)
            )
        else:
            cluster = address
        try:
            stack.enter_context(Client(cluster, timeout=30))
        except OSError as error:
            raise ValueError(f"no Dask scheduler answers at {address}: {error}") from error
        with joblib.parallel_config(backend="dask"):
            yield


_BACKENDS = {"processes": _processes, "ray": _ray, "dask": _dask}
