"""Compiled code of a part from its plain functions: one source for numbers, for dual numbers and for columns.

Jacobians are those of dual numbers. What Numba cannot compile (a dict, a spline, an array inside) runs in Python, on
columns where it can and row by row where it branches on its numbers.
"""

from __future__ import annotations

import dataclasses
import re
from collections import namedtuple
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from filters.contract.variables import VELOCITY
from filters.geometry.machine_code import Compiled, compiled
from filters.geometry.retractions import ADDITIVE
from filters.geometry.vectors import turned_by
from filters.kernels.blas import kernel
from filters.kernels.calls import of_part
from filters.kernels.compilation import include, sources_digest
from filters.kernels.duals import added, numbers, variables, write
from filters.landmarks.landmark_model import LandmarkKernels, LandmarkModel
from filters.measurements.measurement_model import MeasurementKernels, MeasurementModel
from filters.parts import kernels_of

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


def _grouped(layout: Layout) -> Callable[[Any], Any]:
    """Function that names the numbers of a flat tuple."""
    if not layout:
        return lambda flat: None
    record: Any = namedtuple("Numbers", [name.replace("-", "_") for name, _ in layout])  # type: ignore[misc]
    parts, first = Keyed(_nothing), _size(layout)
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


def _size(layout: Layout) -> int:
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
    named, sizes = [compiled(_grouped(group)) for group in groups], [_size(group) for group in groups]
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


def _settings(part: Any) -> Layout:
    """Fields of a part that are numbers (None is NaN), or rows of numbers; whatever else it has is not for kernels."""
    layout = []
    for field in dataclasses.fields(part) if dataclasses.is_dataclass(part) else ():
        value = getattr(part, field.name)
        numbers_there = value is None or isinstance(value, (bool, int, float, tuple, list, np.ndarray))
        row = np.array(np.nan if value is None else value) if numbers_there else np.array("")
        if row.dtype.kind in "biuf" and row.ndim < 2:
            layout.append((field.name, row.size if row.ndim else 0))
    return tuple(layout)


def _tried(method: Callable[..., Any], kernels: Any, names: Sequence[str]) -> Any:
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


def _sum(settings: Any, y: Any, c: Any) -> Any:
    """Retraction of values that add."""
    return added(y, c)


def _second(settings: Any, y: Any, other: Any) -> Any:
    """The other value: its derivatives are those of the difference."""
    return other


@cache
def landmark_functions(cls: type[LandmarkModel], layout: Layout) -> LandmarkKernels | str:
    """Compiled functions of a landmark, or why there are none."""
    made_by = landmark_functions, cls, layout
    return _tried(cls.point_of, replace(_landmark_kernels(cls, layout), made_by=made_by), ("point", "start"))


def _landmark_kernels(cls: type[LandmarkModel], layout: Layout) -> LandmarkKernels:
    n, v, k, adds = cls.size, cls.value_size, cls.seen_size, cls.retract_by is LandmarkModel.retract_by
    point, start, able = (plain(getattr(cls, name), layout) for name in ("point_of", "start_from", "can_start_from"))
    retract = Keyed(_sum, "sum") if adds else plain(cls.retract_by, layout)
    local = Keyed(_second, "second") if adds else plain(cls.local_by, layout)

    def point_kernel(settings: Any, values: Any, points: Any, J: Any) -> None:
        none = np.zeros(n)
        for i in range(len(values)):
            moved = retract(settings, numbers(values[i], v), variables(none, n, 0, n))
            write(points[i], J[i], point(settings, moved))

    def start_kernel(settings: Any, points: Any, values: Any, J: Any, possible: Any) -> None:
        by_seen, none = np.zeros((v, k)), np.zeros(n)
        for i in range(len(values)):
            possible[i] = able(settings, numbers(points[i], k))
            new = start(settings, variables(points[i], k, 0, k))
            write(values[i], by_seen, new)
            write(none, J[i], local(settings, numbers(values[i], v), new))

    names = tuple(name for name, _ in layout)
    if cls.in_world:
        return LandmarkKernels(point_kernel, start_kernel, settings=names)

    def rotation_kernel(settings: Any, values: Any, effect: Any) -> None:
        still, none = np.zeros(3), np.zeros(n)
        for i in range(len(values)):
            value = numbers(values[i], v)
            h = point(settings, value)
            turned = turned_by(variables(still, 3, 0, 3), h[:3]) + h[3:]
            write(none, effect[i], local(settings, value, start(settings, turned)))

    becomes: Any = None if cls.steady else plain(cls.becomes_point, layout)

    def become_kernel(settings: Any, to_anchor: Any, values: Any, variances: Any, become: Any) -> None:
        for i in range(len(values)):
            become[i] = becomes(settings, numbers(to_anchor[i], 3), numbers(values[i], v), numbers(variances[i], n))

    become = None if cls.steady else become_kernel
    turn_kernel = _turn(_moved(cls, layout, point, start, retract, adds), local, n, v)
    return LandmarkKernels(point_kernel, start_kernel, turn_kernel, rotation_kernel, become, settings=names)


def _moved(cls: type[LandmarkModel], layout: Layout, point: Any, start: Any, retract: Any, adds: bool) -> Any:
    """Compiled value after a correction and a turn of the world."""
    own = plain(cls.turned_by, layout) if cls.turned_by is not LandmarkModel.turned_by else None
    if own is not None and adds:
        return own

    def corrected_then_turned(settings: Any, value: Any, turn: Any, c: Any) -> Any:
        h = point(settings, retract(settings, value, c))
        return start(settings, turned_by(turn, h[:3]) + h[3:])

    if own is None:
        return Keyed(corrected_then_turned, point, start, retract)

    def turned_or_retracted(settings: Any, value: Any, turn: Any, c: Any) -> Any:
        if turn[0].value == 0.0 and turn[1].value == 0.0 and turn[2].value == 0.0:
            return retract(settings, value, c)
        return own(settings, value, turn, c)

    return Keyed(turned_or_retracted, retract, own)


def _turn(moved_by: Any, local: Any, n: int, v: int) -> Callable[..., None]:
    slopes = n + 3  # of the correction, then of theta

    def turn_kernel(settings: Any, values: Any, theta: Any, correction: Any, moved: Any, J: Any, J_theta: Any) -> None:
        both, by_value, none = np.zeros((n, slopes)), np.zeros((v, slopes)), np.zeros(n)
        turn = variables(theta, 3, n, slopes)
        for i in range(len(values)):
            new = moved_by(settings, numbers(values[i], v), turn, variables(correction[i], n, 0, slopes))
            write(moved[i], by_value, new)
            write(none, both, local(settings, numbers(moved[i], v), new))
            for a in range(n):
                for b in range(n):
                    J[i, a, b] = both[a, b]
                for b in range(3):
                    J_theta[i, a, b] = both[a, n + b]

    return turn_kernel


@cache
def sensor_functions(cls: type[MeasurementModel], layout: Layout, values: Layout) -> MeasurementKernels | str:
    """Compiled functions of a sensor with these settings and values of variables, or why there are none."""
    kernels = replace(_sensor_kernels(cls, layout, values), made_by=(sensor_functions, cls, layout, values))
    return _tried(cls.project, kernels, ("predict", "backproject"))


def _sensor_kernels(cls: type[MeasurementModel], layout: Layout, values_layout: Layout) -> MeasurementKernels:
    m, size, k = cls.size, _size(values_layout), cls.seen_size
    groups = (layout, CAMERA, values_layout) if values_layout else (layout, CAMERA)
    project, unproject = plain(cls.project, *groups), plain(cls.unproject, *groups)
    can_see, slopes_of_point, slopes_of_uvd = plain(cls.can_see, layout), k + size, 3 + size

    def predict(
        settings: Any, camera: Any, points: Any, values: Any, seen: Any, J: Any, J_values: Any, in_front: Any
    ) -> None:
        for i in range(len(points)):
            in_front[i] = can_see(settings, numbers(points[i], k))
            write(seen[i], J[i], project(settings, camera, variables(points[i], k, 0, k)))

    def backproject(settings: Any, camera: Any, uvd: Any, values: Any, points: Any, J: Any, J_values: Any) -> None:
        for i in range(len(uvd)):
            write(points[i], J[i], unproject(settings, camera, variables(uvd[i], 3, 0, 3)))

    def predict_with_values(
        settings: Any, camera: Any, points: Any, values: Any, seen: Any, J: Any, J_values: Any, in_front: Any
    ) -> None:
        both = np.zeros((m, slopes_of_point))
        others = variables(values, size, k, slopes_of_point)
        for i in range(len(points)):
            in_front[i] = can_see(settings, numbers(points[i], k))
            write(seen[i], both, project(settings, camera, variables(points[i], k, 0, slopes_of_point), others))
            _split(both, J[i], J_values[i])

    def backproject_with_values(
        settings: Any, camera: Any, uvd: Any, values: Any, points: Any, J: Any, J_values: Any
    ) -> None:
        both = np.zeros((k, slopes_of_uvd))
        others = variables(values, size, 3, slopes_of_uvd)
        for i in range(len(uvd)):
            write(points[i], both, unproject(settings, camera, variables(uvd[i], 3, 0, slopes_of_uvd), others))
            _split(both, J[i], J_values[i])

    names = tuple(name for name, _ in layout)
    if values_layout:
        return MeasurementKernels(predict_with_values, backproject_with_values, settings=names)
    return MeasurementKernels(predict, backproject, settings=names)


@kernel
def _split(both: Any, J: Any, J_values: Any) -> None:
    """Columns of one Jacobian into two."""
    for a in range(len(both)):
        for c in range(J.shape[1]):
            J[a, c] = both[a, c]
        for c in range(J_values.shape[1]):
            J_values[a, c] = both[a, J.shape[1] + c]


_COLUMNS = (
    *("parameters_of", "can_start", "started", "retract", "local", "transport", "homogeneous", "relative_to"),
    *("rotated", "world_rotation", "turned", "turned_jacobians", "first_estimates", "become_points"),
)
_SENSED = ("predict", "backproject", "in_front", "stages", "jacobians", "backprojection_jacobians")
"""Functions of columns of a landmark and of a sensor, which follow from the plain ones."""


def _changes(cls: type, base: type, names: Sequence[str]) -> bool:
    """Whether a class of a stranger has functions of columns of its own: then these are what it means."""
    return any(
        getattr(cls, name) is not getattr(base, name) and not getattr(cls, name).__module__.startswith("filters.")
        for name in names
    )


def compiled_functions(part: Any) -> Any:
    """Compiled functions of a part: those that its class states, or those made of its plain ones; None: none."""
    if "kernels" in vars(type(part)):
        return kernels_of(part)
    functions = functions_of(part)
    return None if isinstance(functions, str) else functions


def functions_of(part: Any) -> Any:
    """Compiled functions of a part that is given by plain functions; a text that says why there are none, or None.

    Parts of other kinds, and such whose landmarks have several vectors or a pose for an anchor, have none.
    """
    cls: Any = type(part)
    layout = _settings(part)
    if isinstance(part, LandmarkModel):
        plain_form = cls.point_of is not LandmarkModel.point_of and part.in_machine_code
        if not plain_form or cls.in_anchor or cls.seen_vectors != 1 or _changes(cls, LandmarkModel, _COLUMNS):
            return None
        return landmark_functions(cls, layout)
    if isinstance(part, MeasurementModel):
        plain_form = cls.project is not MeasurementModel.project and cls.seen_vectors == 1
        if not plain_form or _changes(cls, MeasurementModel, _SENSED):
            return None
        if any(variable.retraction is not ADDITIVE for variable in part.variables):
            return None
        values = tuple((variable.name, variable.size) for variable in part.variables)
        if part.sees_velocity:
            values = (*values, (VELOCITY, 6))
        return sensor_functions(cls, layout, values)
    return None


def how_it_runs(part: Any) -> str:
    """How a landmark or a sensor runs in a filter, as a report says it; nothing for other parts."""
    if not isinstance(part, (LandmarkModel, MeasurementModel)):
        return ""
    functions = None if "kernels" in vars(type(part)) else functions_of(part)
    if functions is None:
        return "in Python, on columns"
    if isinstance(functions, str):
        return f"in Python, on columns: Numba cannot compile {functions}"
    return "in machine code, with Jacobians by dual numbers"
