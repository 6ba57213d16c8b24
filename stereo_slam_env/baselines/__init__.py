"""Baseline filters to compare with, from `dead-reckoning` to smoothing by GTSAM.

They implement `filters.StereoFilter` and are found by their entry points, like anybody's filter. They live here and not
in `filters` because they need more than numpy and scipy.
"""

from stereo_slam_env.baselines.camera_alone import DeadReckoning, FrameToFrame
from stereo_slam_env.baselines.filterpy_ekf import FilterpyEKF
from stereo_slam_env.baselines.smoothers import BatchSmoother, FixedLagSmoother

__all__ = ["BatchSmoother", "DeadReckoning", "FilterpyEKF", "FixedLagSmoother", "FrameToFrame"]
