"""Base class of linearisations: how H and R of a stage come about, and the prediction of measurements."""

from __future__ import annotations

from typing import ClassVar

from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.measurements.model import MeasurementModel, Stage
from filters.state.joint_state import JointState
from filters.state.linearised import LinearisedMeasurements


class Linearisation:
    """The fifth part of a filter, option `update`."""

    by_jacobians: ClassVar[bool] = True
    """Whether it takes Jacobians, which may be taken at another point than the state; without, first-estimates
    Jacobians and variables of the measurement model cannot be had."""
    kernels: ClassVar[bool] = False
    """Whether it is the engine's own, compiled: by Jacobians, or by `sigma_points` along the Cholesky factor. It holds
    for the class that states it, not for its subclasses."""

    def sigma_points(self, size: int) -> tuple[float, ...]:
        """Of `size` numbers: distance from the centre, its weights in mean and covariance, weight of each other one."""
        return ()

    def linearise(
        self,
        sensor: MeasurementModel,
        camera: StereoCamera,
        state: JointState,
        index: IntArray,
        stage: Stage,
        point: JointState | None = None,
    ) -> LinearisedMeasurements:
        """Innovations of a stage (Eq. 14) and what they are linear in.

        Parameters
        ----------
        sensor : MeasurementModel
            What is measured.
        camera : StereoCamera
            The rig.
        state : JointState
            Predicts the measurements.
        index : (M,) int64
            Landmarks of the stage.
        stage : Stage
            M measurements.
        point : JointState, optional
            Where H is evaluated, if elsewhere than at `state`.
        """
        raise NotImplementedError(f"{type(self).__name__} must have linearise: see Linearisation")


def points_in_camera(state: JointState, index: IntArray) -> FloatArray:
    """What is seen of the landmarks at `index`, in the camera frame: homogeneous points, (M, seen_size)."""
    position, R_wc = state.seen_from(index)
    seen = state.model.homogeneous(position, state.anchors(index), state.parameters(index))
    return state.model.with_axes(R_wc.swapaxes(-1, -2), seen)
