"""Odometry with a covariance from stereo pairs, one after another; knows no ROS."""

from dataclasses import dataclass

import numpy as np

from filters import StereoCamera, make_filter
from stereo_slam_env.frontend import TYPICAL_NOISE, StereoTracker

R_OW = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Takes vectors of W (x right, y down, z forward) to those of the odometry's world (x forward, y left, z up)."""


@dataclass(frozen=True)
class Estimate:
    """Pose of the left camera (x right, y down, z forward) in the odometry's world, as ROS has it."""

    position: np.ndarray
    """(3,), m."""
    orientation: np.ndarray
    """(4,): quaternion xyzw."""
    covariance: np.ndarray
    """(6, 6): of the position and of the rotation about the fixed axes of the world, m and rad."""
    landmarks: int
    """In the map."""


class StereoOdometry:
    """Front end and filter of one rig.

    Parameters
    ----------
    camera : StereoCamera
        The rectified rig.
    filter_name : str
        One of `filters.available_filters()`.
    """

    def __init__(self, camera: StereoCamera, filter_name: str = "right-invariant") -> None:
        self._tracker = StereoTracker(camera)
        self._slam = make_filter(filter_name, camera=camera, noise=TYPICAL_NOISE)
        self._time: float | None = None

    def step(self, left: np.ndarray, right: np.ndarray, time: float) -> Estimate:
        """Estimate at a pair: (H, W) uint8, rectified; `time` in s, which must grow."""
        dt = None if self._time is None else time - self._time
        if dt is not None:
            self._slam.predict(dt)
        tracked = self._tracker.track(left, right, dt, None if dt is None else self._slam.forecast())
        self._slam.update(tracked.observation)
        self._time = time
        return self._estimate()

    def _estimate(self) -> Estimate:
        from filters import Pose

        belief = self._slam.pose
        R_wc = Pose(belief.position, belief.orientation).R_wc
        turn = np.zeros((6, 6))
        turn[:3, :3], turn[3:, 3:] = R_OW, R_OW @ R_wc  # ours is a rotation in the camera frame
        covariance = turn @ belief.covariance @ turn.T
        pose = Pose(np.zeros(3), _quaternion(R_OW)) @ Pose(belief.position, belief.orientation)
        return Estimate(
            pose.position, pose.orientation, 0.5 * (covariance + covariance.T), len(self._slam.landmarks.ids)
        )


def _quaternion(R: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(R).as_quat()
