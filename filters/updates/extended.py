"""Linearisation: its base class, and that by Jacobians, Eq. 8-10 and 13-14 for many landmarks at once.

Derivation: docs/derivations/measurements.md.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.landmarks.landmark_model import ScaledPoints
from filters.measurements.measurement_model import MeasurementModel, Stage
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
from filters.state.joint_state import JointState
from filters.state.layout import LinearisedMeasurements


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


class Extended(Linearisation):
    """The extended Kalman filter's: Jacobians at the state."""

    kernels: ClassVar[bool] = True

    def linearise(
        self,
        sensor: MeasurementModel,
        camera: StereoCamera,
        state: JointState,
        index: IntArray,
        stage: Stage,
        point: JointState | None = None,
    ) -> LinearisedMeasurements:
        """H by the chain rule through Eq. 8-10, and through the variables that the sensor names."""
        at = state if point is None else point
        position, R_wc = at.seen_from(index)
        seen = at.model.relative_to(position, at.anchors(index), at.parameters(index))
        points_c = at.model.with_axes(R_wc.swapaxes(-1, -2), seen.homogeneous)
        jacobians = sensor.jacobians(camera, points_c, sensor.values_at(at.camera))
        by_pose, by_map = chain_rule(R_wc, seen, points_c, stage.T @ jacobians.by_point, at.model.seen_vectors)
        if at.model.in_anchor:
            by_pose, by_anchor = at.through_anchors(index, by_pose)
            by_map = np.concatenate([by_anchor, by_map], axis=2)
        by_variable = {name: stage.T @ J for name, J in jacobians.by_variable.items()}
        by_leading = sensor.by_leading(by_pose, by_variable, at.camera)
        if point is not None:
            points_c = points_in_camera(state, index)
        predicted = sensor.predict(camera, points_c, sensor.values_at(state.camera))
        innovation = stage.z - predicted @ stage.T.T
        return LinearisedMeasurements(innovation, by_leading, by_map, state.map_rows(index), stage.R)


def chain_rule(
    R_wc: FloatArray, seen: ScaledPoints, points_c: FloatArray, z_by_point: FloatArray, vectors: int = 1
) -> tuple[FloatArray, FloatArray]:
    """H by the pose and by the landmarks, from the Jacobian by homogeneous points in the camera frame.

    Parameters
    ----------
    R_wc : (3, 3)
        Orientation, or that of the camera in the frame of each, (M, 3, 3).
    seen : ScaledPoints
        M landmarks relative to the camera centre.
    points_c : (M, seen_size)
        The same in the camera frame.
    z_by_point : (M, k, seen_size)
        Jacobian of the measurement by them.
    vectors : int
        How many vectors lead them, `seen_vectors`.

    Returns
    -------
    by_pose, by_map : (M, k, 6), (M, k, w)
        By position and rotation, and by the landmark's own numbers.
    """
    z_by_world, by_rotation = z_by_point.copy(), np.zeros((*z_by_point.shape[:2], 3))
    for i in range(vectors):
        vector = slice(3 * i, 3 * i + 3)
        z_by_world[:, :, vector] = z_by_point[:, :, vector] @ R_wc.swapaxes(-1, -2)
        by_rotation += z_by_point[:, :, vector] @ rotations.skew(points_c[:, vector])
    by_pose = np.empty((*z_by_point.shape[:2], POSE_SIZE))
    by_pose[:, :, POSITION], by_pose[:, :, ROTATION] = z_by_world @ seen.by_position, by_rotation
    return by_pose, z_by_world @ seen.by_map
