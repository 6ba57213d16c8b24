"""`Belief`: pose and map of a filter after a frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from filters.checks.consistency import blind_pose_error, nees
from filters.contract.outputs import PoseBelief, UpdateReport
from filters.contract.stereo_filter import StereoFilter
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.poses import Pose
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION


@dataclass(frozen=True, eq=False)
class Belief:
    """Pose and map of a filter after a frame; properties must be read before the filter goes on."""

    slam: StereoFilter
    """The filter."""
    report: UpdateReport
    """Of the frame."""
    pose: PoseBelief
    """Estimated pose."""
    ids: IntArray
    """(N,): landmarks in front of their anchors, at a finite distance; ascending."""
    points_w: FloatArray
    """(N, 3): their positions in W, m."""
    points_c: FloatArray
    """(N, 3): their positions in the camera frame, m."""
    map_size: int
    """Number of all landmarks, wherever they are."""

    @classmethod
    def of(cls, slam: StereoFilter, report: UpdateReport) -> Belief:
        """The current belief of a filter; an `ArithmeticError` where its pose is not finite."""
        pose, landmarks = slam.pose, slam.landmarks
        for name, value in vars(pose).items():
            if not np.isfinite(value).all():
                raise ArithmeticError(f"the filter returned NaN or infinity in its {name} of the pose")
        located = np.isfinite(landmarks.positions).all(axis=1) & np.isfinite(landmarks.covariances).all(axis=(1, 2))
        located &= landmarks.inverse_distance > 0
        points_w = landmarks.positions[located]
        points_c = (points_w - pose.position) @ rotations.matrix(pose.orientation)
        return cls(slam, report, pose, landmarks.ids[located], points_w, points_c, len(landmarks.ids))

    def __len__(self) -> int:
        return len(self.ids)

    @cached_property
    def joint_covariance(self) -> FloatArray:
        """Of the pose and the positions (W) of `ids`, (6 + 3 N, 6 + 3 N), see `StereoFilter.joint_covariance`."""
        return self.slam.joint_covariance(self.ids)

    @cached_property
    def relative_covariances(self) -> FloatArray:
        """Covariances of `points_c`, (N, 3, 3) m^2.

        p_c = R_wc^T (p_w - r), so the errors of pose and landmark, and their correlation, all count.
        """
        R_cw = rotations.matrix(self.pose.orientation).T
        J = np.empty((len(self), 3, POSE_SIZE + 3))
        J[:, :, POSITION], J[:, :, POSE_SIZE:] = -R_cw, R_cw
        J[:, :, ROTATION] = rotations.skew(self.points_c)
        relative: FloatArray = J @ self.slam.pose_landmark_covariances(self.ids) @ J.transpose(0, 2, 1)
        return relative

    def nees(self, truth: Pose) -> FloatArray:
        """NEES of position, rotation, and both, (3,), in the filter's own error definition.

        Infinite where the covariance is not positive definite.
        """
        error, covariance = blind_pose_error(self.slam, truth.position, truth.orientation)
        blocks = np.stack([covariance[POSITION, POSITION], covariance[ROTATION, ROTATION]])
        values = np.append(nees(error.reshape(2, 3), blocks), nees(error[None], covariance[None]))
        return np.where(np.isnan(values), np.inf, values)
