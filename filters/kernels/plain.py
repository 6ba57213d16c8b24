"""Plain functions of parts as compiled ones call them: settings by name, and names for flat numbers."""

from __future__ import annotations

import dataclasses
import re
from collections import namedtuple
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from filters.geometry.machine_code import Compiled, compiled
from filters.kernels.blas import kernel
from filters.kernels.calls import of_part
from filters.kernels.compilation import include, sources_digest
from filters.kernels.duals import numbers

Layout = tuple[tuple[str, int], ...]
"""Names of numbers, and how many each has; 0: a single number, no tuple."""
CAMERA: Layout = tuple((name, 0) for name in ("fx", "fy", "cx", "cy", "baseline"))


def _again(*what: Any) -> None:
    """Never called: what it is called with makes the key by which machine code is kept."""


class Keyed(Compiled):
    """Compiled function of no module, with what distinguishes it from others for the key of the machine code."""

    def __init__(self, function: Callable[..., Any], *key: Any) -> None:
        super().__init__(function)
        self._key = key

    def __reduce__(self) -> Any:
        """What the key of machine code is made of."""
        return _again, self._key


def grouped(layout: Layout) -> Callable[[Any], Any]:
    """Function that names the numbers of a flat tuple."""
    if not layout:
        return lambda flat: None
    record: Any = namedtuple("Numbers", [name.replace("-", "_") for name, _ in layout])  # type: ignore[misc]
    parts, first = Keyed(_nothing), size_of(layout)
    for _, size in reversed(layout):
        last, first = first, first - max(size, 1)
        parts = Keyed(_with_part(first, last, bool(size), parts))
    return lambda flat: record(*parts(flat))


def _nothing(flat: Any) -> Any:
    return ()


def _with_part(first: int, last: int, is_row: bool, rest: Keyed) -> Callable[[Any], Any]:
    """Function that puts a number or a row of a flat tuple before others."""
    if is_row:
        return lambda flat: (flat[first:last], *rest(flat))
    return lambda flat: (flat[first], *rest(flat))


def size_of(layout: Layout) -> int:
    """Numbers of a layout."""
    return sum(max(size, 1) for _, size in layout)


def _with_compiled_helpers(function: Any) -> Any:
    """The function, with the functions of its module that it calls marked as ones that kernels may call."""
    room = function.__globals__
    globals_there = {name: room.get(name) for name in function.__code__.co_names}
    helpers = {
        name: one for name, one in globals_there.items() if isinstance(one, FunctionType) and one is not function
    }
    if not helpers:
        return function
    room = {**room, **{name: compiled(_with_compiled_helpers(helper)) for name, helper in helpers.items()}}
    return FunctionType(function.__code__, room, function.__name__, function.__defaults__, function.__closure__)


def plain(method: Callable[..., Any], *groups: Layout) -> Keyed:
    """Method of a part as kernels call it: `self` is its settings by name.

    Parameters
    ----------
    method : callable
        As the class has it.
    groups : sequence of layouts
        Of the settings; of a sensor also of the camera and, where it takes them, of the values of its variables.
    """
    include(method.__module__)
    key = method.__module__, method.__qualname__, groups, sources_digest(method.__module__)
    called = kernel(_with_compiled_helpers(method))
    named, sizes = [compiled(grouped(group)) for group in groups], [size_of(group) for group in groups]
    own, n = named[0], sizes[0]
    if len(groups) == 1:
        return Keyed(lambda settings, *arguments: called(own(numbers(settings, n)), *arguments), *key)
    rig, m = named[1], sizes[1]
    if len(groups) == 2:
        return Keyed(lambda settings, camera, x: called(own(numbers(settings, n)), rig(numbers(camera, m)), x), *key)
    others = named[2]

    def with_values(settings: Any, camera: Any, x: Any, values: Any) -> Any:
        return called(own(numbers(settings, n)), rig(numbers(camera, m)), x, others(values))

    return Keyed(with_values, *key)


def settings_layout(part: Any) -> Layout:
    """Fields of a part that are numbers (None is NaN), or rows of numbers; whatever else it has is not for kernels."""
    layout = []
    for field in dataclasses.fields(part) if dataclasses.is_dataclass(part) else ():
        value = getattr(part, field.name)
        numbers_there = value is None or isinstance(value, (bool, int, float, tuple, list, np.ndarray))
        row = np.array(np.nan if value is None else value) if numbers_there else np.array("")
        if row.dtype.kind in "biuf" and row.ndim < 2:
            layout.append((field.name, row.size if row.ndim else 0))
    return tuple(layout)


def tried(method: Callable[..., Any], kernels: Any, names: Sequence[str]) -> Any:
    """These kernels of a part with this method; why Numba cannot compile them, where they are a stranger's.

    Machine code is kept on disk only where the source of the part is a file.
    """
    has_source = Path(method.__code__.co_filename).exists()
    for one in vars(kernels).values():
        if isinstance(one, FunctionType):
            vars(one)["has_source"] = has_source
    if method.__module__.startswith("filters."):
        return kernels
    try:
        for name in names:
            of_part(kernels, name)
    except ValueError as error:
        reason = _STEPS.sub("", str(error).partition("Numba can compile: ")[2])
        return f"{method.__qualname__}: {reason}"
    return kernels


_STEPS = re.compile(r"Failed in \w+ mode pipeline \(step: [^)]*\) ")
