"""The steps of a frame that NumPy or compiled kernels implement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from filters.camera import StereoCamera
from filters.engine.error_definition import StandardError
from filters.engine.gating import FateArray
from filters.engine.joint_state import JointState
from filters.engine.kalman import Correction, LinearisedMeasurements
from filters.landmarks.parametrisation import LandmarkModel, NewLandmarks
from filters.measurements.model import Stage
from filters.motion import CameraState, MotionModel
from filters.validation import FloatArray, IntArray

CorrectStage = Callable[
    [StereoCamera, JointState, IntArray, Stage, float, FateArray], tuple[FloatArray, float, int] | None
]


@dataclass(frozen=True)
class Arithmetic:
    """Implementation of the steps.

    Attributes
    ----------
    linearise, squared_distances, update, transform_leading : function
        With the contract of the NumPy ones, `arithmetic.NUMPY`.
    correct_stage : function, optional
        (camera, state, index (M,), stage, gate limit, fates (M,)) -> delta, NIS and its dof: linearise, gate and update
        P in one go, for the measurements whose fate so far is USED; writes their new fates, does not move the state.
    predict : function, optional
        (state, motion, dt) -> CameraState: the prediction of P in place, and the camera it leads to.
    retract : function, optional
        (state, error, delta) -> True: the state corrected by delta in place, with P carried along.
    initialise : function, optional
        (model, camera, camera state, uvd (M, 3)) -> NewLandmarks.

    The optional ones do several steps in one call where there is such a call. If they are None, or give None or False,
    the filter goes step by step.
    """

    linearise: Callable[[StereoCamera, JointState, IntArray, Stage, JointState | None], LinearisedMeasurements]
    squared_distances: Callable[[FloatArray, LinearisedMeasurements], FloatArray]
    update: Callable[[FloatArray, LinearisedMeasurements], Correction]
    transform_leading: Callable[[FloatArray, FloatArray, FloatArray], None]
    correct_stage: CorrectStage | None = None
    predict: Callable[[JointState, MotionModel, float], CameraState | None] | None = None
    retract: Callable[[JointState, StandardError, FloatArray], bool] | None = None
    initialise: Callable[[LandmarkModel, StereoCamera, CameraState, FloatArray], NewLandmarks | None] | None = None
