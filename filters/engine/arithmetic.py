"""The steps of a frame in which the time goes: NumPy's, or machine code that computes the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from filters.camera import StereoCamera
from filters.engine import kalman, linearisation, symmetric
from filters.engine.joint_state import JointState
from filters.engine.kalman import Correction, LinearisedMeasurements
from filters.measurements.model import Stage
from filters.validation import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Arithmetic:
    """How the steps are computed; each field is a function with the contract of its NumPy version in `NUMPY`."""

    in_front: Callable[[JointState, IntArray], BoolArray]
    linearise: Callable[[StereoCamera, JointState, IntArray, Stage, JointState | None], LinearisedMeasurements]
    squared_distances: Callable[[FloatArray, LinearisedMeasurements], FloatArray]
    update: Callable[[FloatArray, LinearisedMeasurements], Correction]
    transform_leading: Callable[[FloatArray, FloatArray, FloatArray], None]


NUMPY = Arithmetic(
    linearisation.in_front,
    linearisation.linearise,
    kalman.squared_distances,
    kalman.update,
    symmetric.transform_leading,
)
