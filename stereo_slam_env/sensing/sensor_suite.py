"""Sensors of a recorded drive that is written for other programs: where they sit, how often they measure, their noise.

Frames: U, a world with z up whose x axis is where the left camera looks at the start, seen from above; C0 and C1, the
left and the right camera (x right, y down, z forward); B, the body whose pose others estimate, which is the inertial
unit, or without one a frame at the left camera with x forward, y left and z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import InertialUnit, Pose, StereoCamera
from filters.contract.validation import finite_array, positive
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.recording.trajectory_transforms import OPTICAL_TO_BASE
from stereo_slam_env.sensing.imu import GRAVITY
from stereo_slam_env.sensing.rig_files import LARGEST_SHIFT

T_BASE_CAMERA = Pose(orientation=rotations.from_matrix(OPTICAL_TO_BASE))
"""Pose of C0 in a frame at the same place with x forward, y left and z up."""


@dataclass(frozen=True, eq=False)
class SensorSuite:
    """A rectified stereo rig with what is mounted beside it.

    Raises
    ------
    ValueError
        A rate that is not above 0, gravity that is no vector, clocks that are too far apart.
    """

    camera: StereoCamera
    """The rig."""
    rate: float
    """Pairs a second, Hz."""
    unit: InertialUnit | None = None
    """The inertial unit, with its pose in C0 and the noise densities that its samples have."""
    imu_rate: float = 200.0
    """Samples a second, Hz."""
    time_offset: float = 0.0
    """Stamps of the unit less those of the cameras for one instant, s (Kalibr's `timeshift_cam_imu`)."""
    gravity: tuple[float, float, float] = (0.0, GRAVITY, 0.0)
    """Acceleration of a body that falls, in W, m/s^2."""
    odometry: FloatArray | None = None
    """Covariance (6, 6) of mean velocities of C0 over a step, linear before angular; None: no wheels."""

    def __post_init__(self) -> None:
        positive("rate", self.rate)
        positive("imu_rate", self.imu_rate)
        finite_array("gravity", self.gravity, (3,))
        if not abs(self.time_offset) <= LARGEST_SHIFT:
            raise ValueError(
                f"time_offset must be from -{LARGEST_SHIFT:g} to {LARGEST_SHIFT:g} s, got {self.time_offset}"
            )

    @property
    def T_bc(self) -> Pose:
        """Pose of C0 in B."""
        if self.unit is None:
            return T_BASE_CAMERA
        return Pose(self.unit.position, self.unit.orientation).inverse()

    @property
    def T_lr(self) -> Pose:
        """Pose of C1 in C0."""
        return Pose(np.array([self.camera.baseline, 0.0, 0.0]))

    @property
    def T_br(self) -> Pose:
        """Pose of C1 in B."""
        return self.T_bc @ self.T_lr

    @property
    def T_uw(self) -> Pose:
        """Pose of W in U: both have one origin, the left camera at the start."""
        up = -np.asarray(self.gravity) / np.linalg.norm(self.gravity)
        forward = np.array([0.0, 0.0, 1.0])
        x = forward - (forward @ up) * up
        x /= np.linalg.norm(x)
        return Pose(orientation=rotations.from_matrix(np.vstack([x, np.cross(up, x), up])))
