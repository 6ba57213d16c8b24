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
from filters.kernels.duals import numbers, variables

Layout = tuple[tuple[str, int], ...]
"""Names of numbers, and how many each has; 0: a single number, no tuple; `ORIENTATION`: a quaternion."""
ORIENTATION = -4
"""Four numbers whose errors are three, a rotation vector on the right."""
CAMERA: Layout = tuple((name, 0) for name in ("fx", "fy", "cx", "cy", "baseline"))


def _again(*what: Any) -> None:
    """Never called: what it is called with makes the key by which machine code is kept."""


class Keyed(Compiled):
    """Compiled function of no module, with what distinguishes it from others for the key of the machine code."""

    def __init__(self, function: Callable[..., Any], *key: Any) -> None:
        super().__init__(function)
        self._key = key

    def __reduce__(self) -> Any:
        """Parts that the key of machine code is made of."""
        return _again, self._key


def grouped(layout: Layout) -> Callable[[Any], Any]:
    """Function that names the numbers of a flat tuple."""
    if not layout:
        return lambda flat: None
    record: Any = namedtuple("Numbers", [name.replace("-", "_") for name, _ in layout])  # type: ignore[misc]
    parts, first = Keyed(_nothing), size_of(layout)
    for _, size in reversed(layout):
        last, first = first, first - (abs(size) or 1)
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
    return sum(abs(size) or 1 for _, size in layout)


def errors_of(layout: Layout) -> int:
    """Error numbers of a layout."""
    return sum(3 if size < 0 else size or 1 for _, size in layout)


def seeded(layout: Layout, slopes: int) -> Keyed:
    """Function that gives the numbers of a row as dual ones, with `slopes` derivatives.

    Its arguments are the row, zeros (3,), and the place of the first error among the derivatives.
    """
    rest = Keyed(_no_numbers, "none")
    for at, column, count in reversed(_runs(layout)):
        rest = Keyed(
            _turned_then(at, column, slopes, rest) if count < 0 else _added_then(at, column, count, slopes, rest)
        )
    return rest


def differences(layout: Layout) -> Keyed:
    """Function that gives the errors of numbers with derivatives relative to their values: (row of those, numbers)."""
    rest = Keyed(_no_differences, "none")
    for at, _, count in reversed(_runs(layout)):
        rest = Keyed(_turn_then(at, rest) if count < 0 else _part_then(at, at + count, rest))
    return rest


def _runs(layout: Layout) -> list[tuple[int, int, int]]:
    """First number, first error and count of each orientation, and of all that add between two of them."""
    runs: list[tuple[int, int, int]] = []
    at = column = 0
    for _, size in layout:
        count = size or 1
        if count > 0 and runs and runs[-1][2] > 0:
            runs[-1] = (*runs[-1][:2], runs[-1][2] + count)
        else:
            runs.append((at, column, count))
        at, column = at + abs(count), column + (3 if count < 0 else count)
    return runs


def _no_numbers(row: Any, zeros: Any, first: Any) -> Any:
    return ()


def _no_differences(values: Any, x: Any) -> Any:
    return ()


def _added_then(at: int, column: int, count: int, slopes: int, rest: Keyed) -> Callable[..., Any]:
    return lambda row, zeros, first: variables(row[at:], count, first + column, slopes) + rest(row, zeros, first)


def _turned_then(at: int, column: int, slopes: int, rest: Keyed) -> Callable[..., Any]:
    def turned(row: Any, zeros: Any, first: Any) -> Any:
        q, (a, b, c) = numbers(row[at:], 4), variables(zeros, 3, first + column, slopes)
        a, b, c = 0.5 * a, 0.5 * b, 0.5 * c  # q x (half the rotation, 1)
        return (
            q[0] + (q[3] * a + q[1] * c - q[2] * b),
            q[1] + (q[3] * b + q[2] * a - q[0] * c),
            q[2] + (q[3] * c + q[0] * b - q[1] * a),
            q[3] - (q[0] * a + q[1] * b + q[2] * c),
            *rest(row, zeros, first),
        )

    return turned


def _part_then(first: int, last: int, rest: Keyed) -> Callable[..., Any]:
    return lambda values, x: x[first:last] + rest(values, x)


def _turn_then(at: int, rest: Keyed) -> Callable[..., Any]:
    end = at + 4

    def turn(values: Any, x: Any) -> Any:
        q, p = x[at:end], numbers(values[at:], 4)
        return (
            2.0 * (p[3] * q[0] - p[0] * q[3] + p[2] * q[1] - p[1] * q[2]),
            2.0 * (p[3] * q[1] - p[1] * q[3] + p[0] * q[2] - p[2] * q[0]),
            2.0 * (p[3] * q[2] - p[2] * q[3] + p[1] * q[0] - p[0] * q[1]),
            *rest(values, x),
        )

    return turn


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
    first_argument, n = named[0], sizes[0]
    if len(groups) == 1:
        return Keyed(lambda settings, *arguments: called(first_argument(numbers(settings, n)), *arguments), *key)
    rig, m = named[1], sizes[1]
    if len(groups) == 2:
        return Keyed(
            lambda settings, camera, x: called(first_argument(numbers(settings, n)), rig(numbers(camera, m)), x), *key
        )
    other_arguments = named[2]

    def with_values(settings: Any, camera: Any, x: Any, values: Any) -> Any:
        return called(first_argument(numbers(settings, n)), rig(numbers(camera, m)), x, other_arguments(values))

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
