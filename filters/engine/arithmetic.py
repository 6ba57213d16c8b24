"""The steps of a frame in which the time goes: NumPy's, or machine code that computes the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from filters.camera import StereoCamera
from filters.engine import kalman, linearisation, symmetric
from filters.engine.error_definition import StandardError
from filters.engine.fates import FateArray
from filters.engine.joint_state import JointState
from filters.engine.kalman import Correction, LinearisedMeasurements
from filters.measurements.model import Stage
from filters.motion import CameraState, MotionModel
from filters.validation import FloatArray, IntArray

CorrectStage = Callable[[StereoCamera, JointState, IntArray, Stage, float, FateArray], "Correction | None"]


@dataclass(frozen=True)
class Arithmetic:
    """How the steps are computed.

    Attributes
    ----------
    linearise, squared_distances, update, transform_leading : function
        With the contract of the NumPy ones in `NUMPY`.
    correct_stage : function, optional
        (camera, state, index (M,), stage, gate limit, fates (M,)) -> Correction: linearise, gate and update in one go,
        for the measurements whose fate so far is USED; writes their new fates, updates P in place, moves nothing.
    predict : function, optional
        (state, motion, dt) -> CameraState: the prediction of P in place, and the camera it leads to.
    retract : function, optional
        (state, error, delta) -> JointState: the state corrected by delta, with P carried along.

    The optional ones do several steps in one call where there is such a call; if they are None or return None, the
    filter goes step by step.
    """

    linearise: Callable[[StereoCamera, JointState, IntArray, Stage, JointState | None], LinearisedMeasurements]
    squared_distances: Callable[[FloatArray, LinearisedMeasurements], FloatArray]
    update: Callable[[FloatArray, LinearisedMeasurements], Correction]
    transform_leading: Callable[[FloatArray, FloatArray, FloatArray], None]
    correct_stage: CorrectStage | None = None
    predict: Callable[[JointState, MotionModel, float], CameraState | None] | None = None
    retract: Callable[[JointState, StandardError, FloatArray], JointState | None] | None = None


NUMPY = Arithmetic(linearisation.linearise, kalman.squared_distances, kalman.update, symmetric.transform_leading)
