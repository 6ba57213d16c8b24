"""What the scripts of this folder share: the command line, seeds in processes, times in turns, memory and tables."""

from __future__ import annotations

import argparse
import gc
import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from rich.console import Console
from rich.table import Table


def arguments(about: str | None, *positional: str, **options: Any) -> argparse.Namespace:
    """What the command line says, by options that are named as in Python and have the type of their default.

    A type is an option without a default, False a flag, a dict JSON. Of a tuple one value is taken, by default the
    first; of a list several, by default all, and of a list of texts no others. "name?" is a positional that may be left
    out.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in options.items():
        several = isinstance(default, list)
        value = default[0] if isinstance(default, list | tuple) else default
        settings: dict[str, Any] = {"default": value if isinstance(default, tuple) else default}
        if value is False:
            settings["action"] = "store_true"
        elif isinstance(value, type):
            settings = {"type": value}
        else:
            settings["type"] = json.loads if isinstance(value, dict) else type(value)
        if several:
            settings["nargs"] = "+"
        if isinstance(default, tuple) or (several and isinstance(value, str)):
            settings["choices"] = default
        if name in positional:
            settings.pop("default", None)
        if f"{name}?" in positional:
            settings["nargs"] = "?"
        is_positional = {name, f"{name}?"} & set(positional)
        parser.add_argument(name if is_positional else f"--{name.replace('_', '-')}", **settings)
    return parser.parse_args()


def by_seed(run: Callable[..., Any], seeds: int | Iterable[int], jobs: int, *given: Any) -> list[Any]:
    """`run(seed, *given)` of each seed, in `jobs` processes."""
    numbers = range(seeds) if isinstance(seeds, int) else seeds
    found: list[Any] = Parallel(jobs)(delayed(run)(seed, *given) for seed in numbers)
    return found


def seconds(call: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Processor time of a call, s."""
    began = clock()
    call()
    return clock() - began


def in_turns(
    calls: Mapping[str, Callable[[], object]],
    rounds: int,
    *,
    burst: int = 1,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, list[float]]:
    """Seconds of each call, measured in turns, some of one in a row: their ratios hold on a busy machine."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            times[name] += [seconds(call, clock) for _ in range(burst)]
    return times


def undisturbed(times: Sequence[float]) -> float:
    """The 20 % quantile: other processes on the machine take their share of its caches most of the time."""
    return float(np.quantile(times, 0.2))


def resident_megabytes() -> float:
    """Memory that this process holds, after a garbage collection (Linux)."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def mean_and_error(values: np.ndarray, digits: int = 3) -> str:
    """Mean of independent values (N,) with its standard error."""
    return f"{np.mean(values):.{digits}f} ± {np.std(values, ddof=1) / np.sqrt(len(values)):.{digits}f}"


def show(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table; its first column is text, the others are numbers."""
    table = Table(title=title)
    for number, head in enumerate(heads):
        table.add_column(head, justify="right" if number else "left")
    for row in rows:
        table.add_row(*row)
    Console(width=200).print(table)
