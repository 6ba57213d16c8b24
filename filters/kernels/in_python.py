"""Functions of a part in Python, for what Numba cannot compile: a dictionary, a spline, an exception that is caught.

They take what compiled ones take (`Functions`), and are made of the same plain functions, on columns of numbers and of
dual numbers; row by row where these branch on their numbers. The kernels call them once for all landmarks.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import Any

import numpy as np

from filters.geometry import vectors
from filters.geometry.derivatives import columns_of, jacobian_of
from filters.geometry.poses import ADDITIVE
from filters.kernels.recipe import Functions
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel, Rig
from filters.motions.motion_model import MotionModel


def functions_in_python(part: Any) -> Functions:
    """Functions of a landmark, a sensor or a motion, in Python."""
    if isinstance(part, LandmarkModel):
        functions = _of_landmark(part)
    elif isinstance(part, MeasurementModel):
        functions = _of_sensor(part)
    else:
        functions = _of_motion(part)
    return replace(functions, in_python=True, made_by=(functions_in_python, part))


def _unless_empty(place: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Leave a function alone where the argument at this place has no rows."""

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        @wraps(function)
        def called(*arguments: Any) -> None:
            if len(arguments[place]):
                function(*arguments)

        return called

    return decorate


def _of_landmark(part: LandmarkModel) -> Functions:
    n = part.size
    own_turn = type(part).turned_by is not LandmarkModel.turned_by and not part.additive

    @_unless_empty(1)
    def point(settings: Any, values: Any, points: Any, J: Any) -> None:
        none = np.zeros((len(values), n))
        points[:], J[:] = jacobian_of(lambda e, y: part.point_of(part.retract_by(y, e)), none, values)

    @_unless_empty(1)
    def start(settings: Any, points: Any, values: Any, J: Any, possible: Any) -> None:
        possible[:] = columns_of(lambda h: (part.can_start_from(h),), points)[:, 0]
        values[:] = columns_of(part.start_from, points)
        J[:] = jacobian_of(lambda h, y: part.local_by(y, part.start_from(h)), points, values)[1]

    @_unless_empty(1)
    def turn(settings: Any, values: Any, theta: Any, correction: Any, moved: Any, J: Any, J_theta: Any) -> None:
        def moved_by(both: Any, y: Any) -> Any:
            if own_turn and not theta.any():
                return part.retract_by(y, both[:n])
            return part.turned_by(y, both[n:], both[:n])

        both = np.hstack([correction, np.broadcast_to(theta, (len(values), 3))])
        moved[:] = columns_of(moved_by, both, values)
        slopes = jacobian_of(lambda x, y, end: part.local_by(end, moved_by(x, y)), both, values, moved)[1]
        J[:], J_theta[:] = slopes[:, :, :n], slopes[:, :, n:]

    def effect_of(moved: Callable[[Any, Any], Any]) -> Callable[..., None]:
        """Effect on the errors of something that moves points h by three numbers e."""

        @_unless_empty(1)
        def effect(settings: Any, values: Any, J: Any) -> None:
            def changed(e: Any, y: Any) -> Any:
                h = part.point_of(y)
                return part.local_by(y, part.start_from((*moved(e, h), *h[3:])))

            J[:] = jacobian_of(changed, np.zeros((len(values), 3)), values)[1]

        return effect

    @_unless_empty(2)
    def become(settings: Any, to_anchor: Any, values: Any, variances: Any, becomes: Any) -> None:
        becomes[:] = columns_of(lambda *of_one: (part.becomes_point(*of_one),), to_anchor, values, variances)[:, 0]

    if part.in_world:
        return Functions(point=point, start=start)
    return Functions(
        point=point,
        start=start,
        turn=turn,
        rotation=effect_of(lambda e, h: vectors.turned_by(e, h[:3])),
        shift=None if part.anchored else effect_of(lambda e, h: tuple(h[i] + h[3] * e[i] for i in range(3))),
        become=None if part.steady else become,
    )


def _of_sensor(part: MeasurementModel) -> Functions:
    names = part.value_names
    record: Any = namedtuple("Values", [name.replace("-", "_") for name in names])  # type: ignore[misc]
    shapes = [(variable.size, variable.retraction is ADDITIVE) for variable in part.variables]
    shapes += [(6, True)] if part.sees_velocity else []

    def named(values: Any, e: Any) -> tuple[Any, ...]:
        """Values as the plain functions take them, with errors e added."""
        parts, at, column = [], 0, 0
        for size, adds in shapes:
            if adds:
                parts.append(tuple(values[at + i] + e[column + i] for i in range(size)))
            else:
                half = tuple(0.5 * e[column + i] for i in range(3))
                parts.append(vectors.product(tuple(values[at : at + 4]), (*half, 1.0)))
            at, column = at + (size if adds else 4), column + size
        return (record(*parts),) if names else ()

    def sense(function: Any, camera: Any, arguments: Any, values: Any, results: Any, J: Any, J_values: Any) -> None:
        rig, none = Rig(*camera.tolist()), np.zeros((1, J_values.shape[2]))
        still = named(values, none[0])
        results[:], J[:] = jacobian_of(lambda h: function(rig, h, *still), arguments)
        if names:
            J_values[:] = jacobian_of(lambda e, h: function(rig, h, *named(values, e)), none, arguments)[1]

    @_unless_empty(2)
    def project(settings: Any, camera: Any, points: Any, values: Any, *written: Any) -> None:
        written[-1][:] = columns_of(lambda h: (part.can_see(h),), points)[:, 0]
        sense(part.project, camera, points, values, *written[:-1])

    @_unless_empty(2)
    def backproject(settings: Any, camera: Any, uvd: Any, values: Any, *written: Any) -> None:
        sense(part.unproject, camera, uvd, values, *written)

    return Functions(project=project, backproject=backproject)


def _of_motion(part: MotionModel) -> Functions:
    def step(settings: Any, x: Any, dt: float, odometry: Any, moved: Any, F: Any, Q: Any) -> None:
        moved[:], F[:], G, noise = part.stepped(x, dt, odometry)
        Q[:] = G @ noise @ G.T

    def measure(settings: Any, x: Any, dt: float, odometry: Any, innovation: Any, H: Any, R: Any) -> None:
        expected, H[:] = part.expected_odometry(x, dt)
        innovation[:], R[:] = odometry[0, :6] - expected, odometry[1:7, :6]

    return Functions(step=step, measure=measure if part.expects_odometry and not part.driven else None)
