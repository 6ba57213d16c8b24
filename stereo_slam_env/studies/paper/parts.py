"""Parts of the long work: each is kept on disk once it is finished, so that an interrupted run goes on."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from stereo_slam_env.benchmark.storage.code_identity import code_digest
from stereo_slam_env.files.atomic import write_atomically
from stereo_slam_env.files.readers import read_arrays

Arrays = dict[str, NDArray[Any]]
Progress = Callable[[float, int], None]
NOT_COMPUTED = ("stereo_slam_env/cli", "stereo_slam_env/report/console.py", "stereo_slam_env/studies/paper/report.py")
"""Where the paths of modules begin that no part needs."""
KEY = "made from"
"""Entry of a file that says of which inputs and code it is."""


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of work that can be done on its own.

    Attributes
    ----------
    name : str
        Usable as a file name; unique.
    inputs : mapping
        Everything that the result depends on besides the code; JSON-able.
    compute : callable
        Does it. Without arguments, and can be sent to another process.
    alone : bool
        Whether it must have the machine for itself (because it measures time).
    """

    name: str
    inputs: Mapping[str, Any]
    compute: Callable[[], Arrays]
    alone: bool = False


def run_parts(
    parts: Sequence[Part], folder: Path, *, jobs: int = 1, progress: Progress | None = None
) -> dict[str, Arrays]:
    """Results of all parts, by name; what `folder` has of the same inputs and code is not computed again.

    Parameters
    ----------
    parts : sequence of Part
        The work.
    folder : Path
        For one npz file a part.
    jobs : int
        Processes, one BLAS thread each.
    progress : callable, optional
        Called with (parts done, parts).
    """
    code = code_digest(NOT_COMPUTED)
    keys = {part.name: json.dumps({"code": code, "inputs": part.inputs}, sort_keys=True) for part in parts}
    found = {part.name: _kept(folder / f"{part.name}.npz", keys[part.name]) for part in parts}
    results = {name: arrays for name, arrays in found.items() if arrays is not None}

    def tell() -> None:
        if progress is not None:
            progress(len(results), len(parts))

    tell()
    todo = [part for part in parts if part.name not in results]
    together = [part for part in todo if not part.alone]
    if min(jobs, len(together)) > 1:
        import joblib

        with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
            workers = joblib.Parallel(n_jobs=min(jobs, len(together)), batch_size=1, return_as="generator")
            done = workers(joblib.delayed(_compute)(part, folder, keys[part.name]) for part in together)
            for name, arrays in done:
                results[name] = arrays
                tell()
        todo = [part for part in todo if part.alone]
    for part in sorted(todo, key=lambda part: part.alone):
        results.update([_compute(part, folder, keys[part.name])])
        tell()
    return results


def _compute(part: Part, folder: Path, key: str) -> tuple[str, Arrays]:
    with threadpool_limits(limits=1):
        arrays = part.compute()
    named: dict[str, Any] = {KEY: np.array(key), **arrays}
    write_atomically(folder / f"{part.name}.npz", lambda stream: np.savez_compressed(stream, **named))
    return part.name, arrays


def _kept(path: Path, key: str) -> Arrays | None:
    """What the file has, if it is of this key; a damaged one is computed again."""
    try:
        arrays = read_arrays(path)
        return arrays if str(arrays.pop(KEY)) == key else None
    except (OSError, ValueError, KeyError):
        return None
