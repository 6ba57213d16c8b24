"""Compiled code of a part from its plain functions: one source for numbers, for dual numbers and for columns.

Jacobians are those of dual numbers. What Numba cannot compile (a dict, a spline, an array inside) runs in Python, on
columns where it can and row by row where it branches on its numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from filters.contract.inputs import InertialSamples
from filters.contract.outputs import VELOCITY, Variable
from filters.geometry.poses import ADDITIVE
from filters.geometry.vectors import turned_by
from filters.kernels.blas import kernel
from filters.kernels.duals import added, numbers, variables, write
from filters.kernels.in_python import functions_in_python
from filters.kernels.lifted_motion import motion_functions
from filters.kernels.plain import (
    CAMERA,
    ORIENTATION,
    Keyed,
    Layout,
    errors_of,
    plain,
    seeded,
    settings_layout,
    tried,
)
from filters.kernels.recipe import Functions
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel
from filters.motions.motion_model import MotionModel


def _sum(settings: Any, y: Any, c: Any) -> Any:
    """Retraction of values that add."""
    return added(y, c)


def _second(settings: Any, y: Any, other: Any) -> Any:
    """The other value: its derivatives are those of the difference."""
    return other


@cache
def landmark_functions(cls: type[LandmarkModel], layout: Layout) -> Functions | str:
    """Compiled functions of a landmark, or why there are none."""
    made_by = landmark_functions, cls, layout
    return tried(cls.point_of, replace(_landmark_kernels(cls, layout), made_by=made_by), ("point", "start"))


def _landmark_kernels(cls: type[LandmarkModel], layout: Layout) -> Functions:
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
        return Functions(point=point_kernel, start=start_kernel, settings=names)

    def rotation_kernel(settings: Any, values: Any, effect: Any) -> None:
        still, none = np.zeros(3), np.zeros(n)
        for i in range(len(values)):
            value = numbers(values[i], v)
            h = point(settings, value)
            turned = turned_by(variables(still, 3, 0, 3), h[:3]) + h[3:]
            write(none, effect[i], local(settings, value, start(settings, turned)))

    def shift_kernel(settings: Any, values: Any, effect: Any) -> None:
        still, none = np.zeros(3), np.zeros(n)
        for i in range(len(values)):
            value = numbers(values[i], v)
            h, (x, y, z) = point(settings, value), variables(still, 3, 0, 3)
            moved = (h[0] + h[3] * x, h[1] + h[3] * y, h[2] + h[3] * z)
            write(none, effect[i], local(settings, value, start(settings, moved + h[3:])))

    becomes: Any = None if cls.steady else plain(cls.becomes_point, layout)

    def become_kernel(settings: Any, to_anchor: Any, values: Any, variances: Any, become: Any) -> None:
        for i in range(len(values)):
            become[i] = becomes(settings, numbers(to_anchor[i], 3), numbers(values[i], v), numbers(variances[i], n))

    become = None if cls.steady else become_kernel
    turn_kernel = _turn(_moved(cls, layout, point, start, retract, adds), local, n, v)
    return Functions(
        point=point_kernel,
        start=start_kernel,
        turn=turn_kernel,
        rotation=rotation_kernel,
        shift=None if cls.anchored else shift_kernel,
        become=become,
        settings=names,
    )


def _moved(cls: type[LandmarkModel], layout: Layout, point: Any, start: Any, retract: Any, adds: bool) -> Any:
    """Compiled value after a correction and a turn of the world."""
    turned_kernel = plain(cls.turned_by, layout) if cls.turned_by is not LandmarkModel.turned_by else None
    if turned_kernel is not None and adds:
        return turned_kernel

    def corrected_then_turned(settings: Any, value: Any, turn: Any, c: Any) -> Any:
        h = point(settings, retract(settings, value, c))
        return start(settings, turned_by(turn, h[:3]) + h[3:])

    if turned_kernel is None:
        return Keyed(corrected_then_turned, point, start, retract)

    def turned_or_retracted(settings: Any, value: Any, turn: Any, c: Any) -> Any:
        if turn[0].value == 0.0 and turn[1].value == 0.0 and turn[2].value == 0.0:
            return retract(settings, value, c)
        return turned_kernel(settings, value, turn, c)

    return Keyed(turned_or_retracted, retract, turned_kernel)


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
def sensor_functions(cls: type[MeasurementModel], layout: Layout, values: Layout) -> Functions | str:
    """Compiled functions of a sensor with these settings and values of variables, or why there are none."""
    kernels = replace(_sensor_kernels(cls, layout, values), made_by=(sensor_functions, cls, layout, values))
    return tried(cls.project, kernels, ("project", "backproject"))


def _sensor_kernels(cls: type[MeasurementModel], layout: Layout, values_layout: Layout) -> Functions:
    m, k, errors = cls.size, cls.seen_size, errors_of(values_layout)
    groups = (layout, CAMERA, values_layout) if values_layout else (layout, CAMERA)
    project, unproject = plain(cls.project, *groups), plain(cls.unproject, *groups)
    can_see, slopes_of_point, slopes_of_uvd = plain(cls.can_see, layout), k + errors, 3 + errors

    seed_beside_point, seed_beside_uvd = seeded(values_layout, slopes_of_point), seeded(values_layout, slopes_of_uvd)

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
        others = seed_beside_point(values, np.zeros(3), k)
        for i in range(len(points)):
            in_front[i] = can_see(settings, numbers(points[i], k))
            write(seen[i], both, project(settings, camera, variables(points[i], k, 0, slopes_of_point), others))
            _split(both, J[i], J_values[i])

    def backproject_with_values(
        settings: Any, camera: Any, uvd: Any, values: Any, points: Any, J: Any, J_values: Any
    ) -> None:
        both = np.zeros((k, slopes_of_uvd))
        others = seed_beside_uvd(values, np.zeros(3), 3)
        for i in range(len(uvd)):
            write(points[i], both, unproject(settings, camera, variables(uvd[i], 3, 0, slopes_of_uvd), others))
            _split(both, J[i], J_values[i])

    names = tuple(name for name, _ in layout)
    if values_layout:
        return Functions(project=predict_with_values, backproject=backproject_with_values, settings=names)
    return Functions(project=predict, backproject=backproject, settings=names)


@kernel
def _split(both: Any, J: Any, J_values: Any) -> None:
    """Columns of one Jacobian into two."""
    for a in range(len(both)):
        for c in range(J.shape[1]):
            J[a, c] = both[a, c]
        for c in range(J_values.shape[1]):
            J_values[a, c] = both[a, J.shape[1] + c]


def functions_of(part: Any) -> Functions:
    """Functions of a landmark, a sensor or a motion: in machine code, or in Python where Numba cannot compile them."""
    functions = _compiled(part) if part.in_machine_code else ""
    return functions_in_python(part) if isinstance(functions, str) else functions


def _compiled(part: Any) -> Functions | str:
    """Compiled functions, or a text that says why there are none."""
    cls: Any = type(part)
    layout = settings_layout(part)
    if isinstance(part, LandmarkModel):
        return landmark_functions(cls, layout)
    if isinstance(part, MeasurementModel):
        values = tuple(map(_entry, part.variables))
        return sensor_functions(cls, layout, (*values, (VELOCITY, 6)) if part.sees_velocity else values)
    position, _, *velocities = part.layout[:4]
    state = (position, ("orientation", ORIENTATION), *velocities, *map(_entry, part.variables))
    if not part.driven:
        return motion_functions(cls, layout, state, len(part.sigmas(1.0)), "noise")
    samples = part.takes is InertialSamples
    return motion_functions(cls, layout, state, 12 if samples else 6, "samples" if samples else "odometry")


def _entry(variable: Variable) -> tuple[str, int]:
    return variable.name.replace("-", "_"), variable.size if variable.retraction is ADDITIVE else ORIENTATION


def how_it_runs(part: Any) -> str:
    """Form in which a landmark, a sensor or a motion runs in a filter, as a report says it; nothing for other parts."""
    if not isinstance(part, LandmarkModel | MeasurementModel | MotionModel):
        return ""
    if not part.in_machine_code:
        return "in Python, on columns"
    functions = _compiled(part)
    if isinstance(functions, str):
        return f"in Python, on columns: Numba cannot compile {functions}"
    return "in machine code, with Jacobians by dual numbers"
