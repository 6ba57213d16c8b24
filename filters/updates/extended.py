"""Linearisation by Jacobians: Eq. 8-10 and 13-14 for many landmarks at once.

Derivation: docs/derivations/measurements.md.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from filters.landmarks.model import ScaledPoints
from filters.measurements.model import MeasurementModel, Stage
from filters.motions.model import POSE_SIZE, POSITION, ROTATION
from filters.state.joint_state import JointState
from filters.state.linearised import LinearisedMeasurements
from filters.updates.model import Linearisation, points_in_camera
from filters.validation import FloatArray, IntArray


class Extended(Linearisation):
    """The extended Kalman filter's: Jacobians at the state."""

    kernel: ClassVar[str | None] = "extended"

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
        seen = at.model.relative_to(at.camera.position, at.anchors(index), at.parameters(index))
        points_c = np.concatenate(
            [rotations.turned(at.camera.R_wc.T, seen.homogeneous[:, :3]), seen.homogeneous[:, 3:]], axis=1
        )
        jacobians = sensor.jacobians(camera, points_c, at.camera.variables)
        by_pose, by_map = chain_rule(at.camera.R_wc, seen, points_c, stage.T @ jacobians.by_point)
        by_variables = [stage.T @ jacobians.by_variable[variable.name] for variable in sensor.variables]
        by_leading = np.concatenate([by_pose, *by_variables], axis=2) if by_variables else by_pose
        if point is not None:
            points_c = points_in_camera(state, index)
        predicted = sensor.predict(camera, points_c, state.camera.variables)
        innovation = stage.z - predicted @ stage.T.T
        return LinearisedMeasurements(innovation, by_leading, by_map, state.map_rows(index), stage.R)


def chain_rule(
    R_wc: FloatArray, seen: ScaledPoints, points_c: FloatArray, z_by_point: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """H by the pose and by the landmarks, from the Jacobian by homogeneous points in the camera frame.

    Parameters
    ----------
    R_wc : (3, 3) or (M, 3, 3)
        Orientation, one for all landmarks or one for each.
    seen : ScaledPoints
        M landmarks relative to the camera centre.
    points_c : (M, 4)
        The same in the camera frame.
    z_by_point : (M, k, 4)
        Jacobian of the measurement by them.

    Returns
    -------
    by_pose, by_map : (M, k, 6), (M, k, w)
        By position and rotation, and by the landmark's own numbers.
    """
    z_by_world = z_by_point.copy()
    z_by_world[:, :, :3] = z_by_point[:, :, :3] @ R_wc.swapaxes(-1, -2)
    by_pose = np.empty((*z_by_point.shape[:2], POSE_SIZE))
    by_pose[:, :, POSITION] = z_by_world @ seen.by_position
    by_pose[:, :, ROTATION] = z_by_point[:, :, :3] @ rotations.skew(points_c[:, :3])
    return by_pose, z_by_world @ seen.by_map
