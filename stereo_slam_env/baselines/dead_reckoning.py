"""The least one can do: integrate the odometry, look at nothing."""

from __future__ import annotations

from filters.interface import StereoObservation, UpdateReport
from stereo_slam_env.baselines.camera_filter import CameraFilter


class DeadReckoning(CameraFilter):
    """Odometry integrated, or constant velocity where there is none: no camera, no map.

    Every measurement is new to it and starts nothing, so every id is reported as rejected.
    """

    def _use(self, observation: StereoObservation) -> UpdateReport:
        return UpdateReport(rejected=observation.ids)
