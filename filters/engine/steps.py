"""Steps of a motion outside the engine: for filters that keep a state of their own, and for parts in Python."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from filters.geometry.arrays import FloatArray
from filters.geometry.machine_code import settings_of
from filters.kernels.calls import Packed, addresses, of_part
from filters.kernels.entries import step_at
from filters.kernels.lift import compiled_functions
from filters.kernels.recipe import Functions
from filters.motions.motion_model import CameraState, LinearMeasurement, MotionModel, MotionPrediction, StepInput


class _Step:
    """Compiled step of a motion, called by Python."""

    def __init__(self, motion: MotionModel, functions: Functions) -> None:
        self._motion, self._settings = motion, settings_of(motion, functions)
        self._calls = Packed(addresses(step=of_part(functions, "step")))

    def predict(self, state: CameraState, dt: float, odometry: Any) -> MotionPrediction:
        """`MotionModel.predict`, with the noise of the whole step as Q."""
        m, x = self._motion.size, self._motion.numbers_of(state)
        given = np.zeros((0, 6)) if odometry is None else odometry.rows
        moved, F, Q = x.copy(), np.zeros((m, m)), np.zeros((m, m))
        step_at(self._calls.address, self._settings, x, dt, given, moved, F, Q)
        return MotionPrediction(self._motion.state_of(moved, state.variables), F, np.eye(m), Q)


class _Identity:
    """Key of a motion as this object: others with the same settings may be of another class."""

    def __init__(self, motion: MotionModel) -> None:
        self.motion = motion

    def __hash__(self) -> int:
        return id(self.motion)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Identity) and self.motion is other.motion


@lru_cache(maxsize=64)
def _compiled(key: _Identity) -> _Step | None:
    functions = compiled_functions(key.motion)
    return None if functions is None else _Step(key.motion, functions)


def predict_camera(motion: MotionModel, state: CameraState, dt: float, odometry: StepInput | None) -> MotionPrediction:
    """Prediction of a motion for one camera: by its compiled functions, or by `predict`, with its shapes checked.

    Raises
    ------
    ValueError
        The model returned something else than a `MotionPrediction` with the shapes of its documentation.
    """
    compiled = _compiled(_Identity(motion))
    if compiled is not None:
        motion.check_odometry(odometry)
        return compiled.predict(state, dt, odometry)
    predicted = motion.predict(state, dt, odometry)
    _require_type(motion, "a MotionPrediction from predict", predicted, MotionPrediction)
    _require_type(motion, "its predicted state as a CameraState", predicted.state, CameraState)
    noises, size = _rows(predicted.Q), motion.size
    _require_shapes(
        motion,
        ("state.position", predicted.state.position, (3,)),
        ("state.orientation", predicted.state.orientation, (4,)),
        ("state.linear_velocity", predicted.state.linear_velocity, (3,)),
        ("state.angular_velocity", predicted.state.angular_velocity, (3,)),
        ("F", predicted.F, (size, size)),
        ("Q", predicted.Q, (noises, noises)),
        ("G", predicted.G, (size, noises)),
        *(
            (f"state.variables[{variable.name!r}]", predicted.state.variables.get(variable.name), variable.value.shape)
            for variable in motion.variables
        ),
    )
    return predicted


def measure_odometry(
    motion: MotionModel, state: CameraState, dt: float, odometry: StepInput
) -> LinearMeasurement | None:
    """Odometry of one camera as a measurement, with its shapes checked; None: it adds nothing.

    Raises
    ------
    ValueError
        The model returned something else than None or a `LinearMeasurement` with the shapes of its documentation.
    """
    measured = motion.odometry_measurement(state, dt, odometry)
    if measured is not None:
        _require_type(motion, "a LinearMeasurement or None from odometry_measurement", measured, LinearMeasurement)
        rows = _rows(measured.innovation)
        _require_shapes(
            motion,
            ("the innovation of odometry", measured.innovation, (rows,)),
            ("the H of odometry", measured.H, (rows, motion.size)),
            ("the R of odometry", measured.R, (rows, rows)),
        )
    return measured


def _rows(array: FloatArray) -> int:
    shape = getattr(array, "shape", ())
    return shape[0] if shape else 0


def _require_type(motion: MotionModel, wanted: str, returned: object, kind: type) -> None:
    if not isinstance(returned, kind):
        raise ValueError(f"motion model {type(motion).__name__} must return {wanted}, got {type(returned).__name__}")


def _require_shapes(motion: MotionModel, *parts: tuple[str, FloatArray | None, tuple[int, ...]]) -> None:
    for name, array, wanted in parts:
        shape = getattr(array, "shape", None)
        if shape != wanted:
            got = type(array).__name__ if shape is None else shape
            raise ValueError(f"motion model {type(motion).__name__} must return {name} of shape {wanted}, got {got}")
