"""What would be seen from a camera pose that is only imagined, and what it would tell: pure maths, many poses at once.

A planner knows where landmarks are believed to be, and the field of view. It does not know what stands in between.

Everything rests on one fact. Let e = p - r be a landmark seen from the camera, in the axes of W; its error
delta e = delta p - delta r + [e]x phi, with phi the error of the rotation in W, does not change when the camera makes a
*known* turn or step. A measurement from anywhere is H delta e with H = J R_cw (J: Eq. 10's Jacobian), so that

    S = H C H^T + R,    C = cov(delta e).                                                                  (Eq. 15)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from filters import rotations
from filters.camera import StereoCamera
from filters.interface import StereoFilter
from filters.motion import POSE_SIZE, POSITION, ROTATION
from filters.noise import StereoNoise
from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.recording.recording import Pose


@dataclass(frozen=True, eq=False)
class CameraPoses:
    """Poses of the left camera in W, with any leading dimensions.

    Attributes
    ----------
    positions : (..., 3)
        m.
    R_wc : (..., 3, 3)
        Camera to W.
    """

    positions: FloatArray
    R_wc: FloatArray

    @classmethod
    def at(cls, pose: Pose) -> CameraPoses:
        """One pose, or many with the same leading dimensions in both of its fields."""
        return cls(pose.position, rotations.matrix(pose.orientation))

    def to_camera(self, points_w: FloatArray) -> FloatArray:
        """Points (N, 3) of W in each camera frame; (..., N, 3) m."""
        points_c: FloatArray = (points_w - self.positions[..., None, :]) @ self.R_wc
        return points_c


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What a filter believes of the pose and of N landmarks.

    Attributes
    ----------
    ids : (N,) int64
        Landmarks.
    pose : Pose
        Of the left camera.
    points : (N, 3)
        Landmarks in W, m.
    covariance : (6 + 3 N, 6 + 3 N)
        Of the errors of the position (W, m), of the rotation (**in the axes of W**, rad) and of `points` (m).
    """

    ids: IntArray
    pose: Pose
    points: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, slam: StereoFilter, within: float = np.inf) -> Knowledge:
        """What a filter believes now of the landmarks `within` m of the camera that have a finite position."""
        belief, landmarks = slam.pose, slam.landmarks
        with np.errstate(invalid="ignore"):
            near = np.linalg.norm(landmarks.positions - belief.position, axis=1) <= within
        near &= np.isfinite(landmarks.positions).all(axis=1) & np.isfinite(landmarks.covariances).all(axis=(1, 2))
        near &= landmarks.inverse_distance > 0.0
        ids = landmarks.ids[near]
        covariance = slam.joint_covariance(ids).copy()
        R_wc = rotations.matrix(belief.orientation)
        covariance[ROTATION] = R_wc @ covariance[ROTATION]
        covariance[:, ROTATION] = covariance[:, ROTATION] @ R_wc.T
        return cls(ids, Pose(belief.position, belief.orientation), landmarks.positions[near], covariance)

    def of_landmarks(self, index: IntArray) -> Knowledge:
        """The same of the landmarks at `index` (M,) only."""
        rows = np.concatenate([np.arange(POSE_SIZE), (POSE_SIZE + 3 * index[:, None] + np.arange(3)).ravel()])
        return Knowledge(self.ids[index], self.pose, self.points[index], self.covariance[np.ix_(rows, rows)])

    @property
    def by_pose(self) -> FloatArray:
        """d e / d (position, rotation), (N, 3, 6): [-I, [e]x]."""
        J = np.empty((len(self.points), 3, POSE_SIZE))
        J[:, :, POSITION] = -np.eye(3)
        J[:, :, ROTATION] = rotations.skew(self.points - self.pose.position)
        return J

    @property
    def relative_covariances(self) -> FloatArray:
        """C, covariance of each landmark as seen from the camera, in the axes of W; (N, 3, 3) m^2."""
        rows = POSE_SIZE + 3 * np.arange(len(self.points))[:, None] + np.arange(3)
        J = self.by_pose
        J_P = J @ self.covariance[:POSE_SIZE, :POSE_SIZE]
        cross = J @ self.covariance[:POSE_SIZE, rows].transpose(1, 0, 2)
        own = self.covariance[rows[:, :, None], rows[:, None, :]]
        relative: FloatArray = J_P @ J.transpose(0, 2, 1) + cross + cross.transpose(0, 2, 1) + own
        return relative


@dataclass(frozen=True, eq=False)
class Sight:
    """What N landmarks look like from cameras with any leading dimensions.

    Attributes
    ----------
    uvd : (..., N, 3)
        Predicted left pixel and disparity, px; of no meaning behind the camera.
    in_view : (..., N) bool
        Whether it could be measured, if nothing stood in between.
    points_c : (..., N, 3)
        In each camera frame, m.
    """

    uvd: FloatArray
    in_view: BoolArray
    points_c: FloatArray


@dataclass(frozen=True)
class Eyes:
    """A stereo sensor as a planner knows it.

    Attributes
    ----------
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        R of (u, v, d).
    nearest, farthest : float
        Range of depths z in which landmarks are measured, m.
    margin : float
        px that a landmark must be inside both images.
    most : int, optional
        Landmarks that are measured in one frame at most. None: all in view.
    """

    camera: StereoCamera
    noise: StereoNoise
    nearest: float = 0.0
    farthest: float = np.inf
    margin: float = 0.0
    most: int | None = None

    @cached_property
    def reach(self) -> float:
        """Largest distance of a landmark in view, m: that of the farthest depth at the corner of the image."""
        camera = self.camera
        corners = camera.ray([[u, v] for u in (0.0, camera.width - 1.0) for v in (0.0, camera.height - 1.0)])
        return self.farthest * float(np.linalg.norm(corners, axis=1).max())

    @cached_property
    def _whitening(self) -> FloatArray:
        """L^-1 with R = L L^T."""
        whitening: FloatArray = np.linalg.inv(np.linalg.cholesky(self.noise.R))
        return whitening

    def sight(self, points: FloatArray, cameras: CameraPoses) -> Sight:
        """What the points (N, 3) of W, m, look like from each of the cameras."""
        points_c = cameras.to_camera(points)
        z = points_c[..., 2]
        uvd = self.camera.project(points_c)
        with np.errstate(invalid="ignore"):  # a point beside the camera has no image
            in_view = (z > 0.0) & (z >= self.nearest) & (z <= self.farthest) & self.camera.in_view(uvd, self.margin)
        return Sight(uvd, in_view, points_c)

    def innovation_covariances(self, knowledge: Knowledge, cameras: CameraPoses) -> FloatArray:
        """S (Eq. 15) of each landmark from each camera, the way there being known exactly; (..., N, 3, 3) px^2."""
        J = self.camera.project_jacobian(cameras.to_camera(knowledge.points))
        H = J @ np.swapaxes(cameras.R_wc, -1, -2)[..., None, :, :]
        S: FloatArray = H @ knowledge.relative_covariances @ np.swapaxes(H, -1, -2) + self.noise.R
        return S

    def information(self, points: FloatArray, cameras: CameraPoses) -> FloatArray:
        """H^T R^-1 H of each landmark in view, 0 of the others; (..., N, 3, 3) 1/m^2, in the axes of W.

        Where more are in view than are measured, each counts with the share of those that are.
        """
        sight = self.sight(points, cameras)
        seen = np.nonzero(sight.in_view)
        J = self.camera.project_jacobian(sight.points_c[seen])
        R_wc = np.broadcast_to(cameras.R_wc[..., None, :, :], (*sight.in_view.shape, 3, 3))[seen]
        H = self._whitening @ J @ R_wc.transpose(0, 2, 1)
        information = np.zeros((*sight.in_view.shape, 3, 3))
        information[seen] = H.transpose(0, 2, 1) @ H
        if self.most is not None:
            count = sight.in_view.sum(axis=-1)
            information *= (self.most / np.maximum(count, self.most))[..., None, None, None]
        return information
