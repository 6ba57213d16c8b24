"""Machine code for filters that keep a state of their own: their functions, and the step of a motion."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache, wraps
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from filters.geometry.arrays import FloatArray
from filters.geometry.machine_code import settings_of
from filters.motions.motion_model import CameraState, MotionModel, MotionPrediction, StepInput

if TYPE_CHECKING:
    from filters.kernels.calls import Packed

_Function = TypeVar("_Function", bound=Callable[..., Any])


class _Identity:
    """Key of a motion as this object: others with the same settings may be of another class."""

    def __init__(self, motion: MotionModel) -> None:
        self.motion = motion

    def __hash__(self) -> int:
        return id(self.motion)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Identity) and self.motion is other.motion


@lru_cache(maxsize=64)
def _compiled(key: _Identity) -> tuple[Packed, FloatArray]:
    """Addresses of the step of a motion, and its settings."""
    from filters.kernels.calls import Packed, addresses, of_part  # Numba takes longer to import than all the rest
    from filters.kernels.lift import functions_of

    functions = functions_of(key.motion)
    return Packed(addresses(step=of_part(functions, "step"))), settings_of(key.motion, functions)


def predict_camera(motion: MotionModel, state: CameraState, dt: float, odometry: StepInput | None) -> MotionPrediction:
    """`MotionModel.predict` in machine code, with the noise of the whole step as Q."""
    from filters.kernels.calls import raise_failure
    from filters.kernels.entries import step_at

    motion.check_odometry(odometry)
    calls, settings = _compiled(_Identity(motion))
    m, x = motion.size, motion.numbers_of(state)
    rows = np.zeros((0, 6)) if odometry is None else odometry.rows
    moved, F, Q = x.copy(), np.zeros((m, m)), np.zeros((m, m))
    step_at(calls.address, settings, x, dt, rows, moved, F, Q)
    raise_failure()
    return MotionPrediction(motion.state_of(moved, state.variables), F, np.eye(m), Q)


def kernel(function: _Function) -> _Function:
    """Compile a function of numbers and arrays by Numba, when it is first called, and keep the code on disk.

    What Numba's `njit` does, but for the long import of Numba before it is needed, and kept anew where any source that
    the function reaches has changed. With `NUMBA_DISABLE_JIT=1` it stays Python.
    """

    @cache
    def machine_code() -> Any:
        from filters.kernels.blas import entry
        from filters.kernels.compilation import include

        include(function.__module__)
        return entry(function)

    @wraps(function)
    def call(*arguments: Any) -> Any:
        return machine_code()(*arguments)

    return cast("_Function", call)
