"""Image sensor of the environment: landmarks measured in rendered pairs by the front end."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from filters import Pose, StereoCamera, StereoObservation
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.front_ends import make_front_end
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import TrackedPair
from stereo_slam_env.recording.recording import LandmarkTruth
from stereo_slam_env.rendering.images import StereoImages, grey
from stereo_slam_env.rendering.pinhole import points_at
from stereo_slam_env.simulator.kept import Kept
from stereo_slam_env.world.routes import FRAME_PERIOD


class ImageSensor(Kept):
    """Measures landmarks in the pairs that `take_pair` renders; what `moves` (points of W (N, 3) -> (N,)) is none."""

    changes = ("_tracker", "_ids", "_points", "_moving_ids", "_seen", "tracked")

    def __init__(
        self,
        camera: StereoCamera,
        take_pair: Callable[[], StereoImages],
        settings: TrackerSettings,
        moves: Callable[[FloatArray], BoolArray] | None = None,
    ) -> None:
        self.camera = camera
        self._take_pair, self._moves = take_pair, moves
        self._tracker = make_front_end(camera, settings)
        self._ids: list[IntArray] = [np.zeros(0, dtype=np.int64)]
        self._points: list[FloatArray] = [np.zeros((0, 3))]
        self._moving_ids: list[IntArray] = [np.zeros(0, dtype=np.int64)]
        self._seen = np.zeros(0, dtype=np.int64)
        self.tracked: TrackedPair | None = None
        """Result of the front end in the last pair."""

    def observe(self, pose: Pose) -> StereoObservation:
        """Follow the landmarks to the pair taken now, from `pose`, one frame after the previous one."""
        images = self._take_pair()
        self.tracked = self._tracker.track(grey(images.left), grey(images.right), FRAME_PERIOD)
        corners = self.tracked.corners
        if corners is None:  # of those that are new to it
            observation = self.tracked.observation
            fresh = ~np.isin(observation.ids, self._seen)
            self._seen = np.union1d(self._seen, observation.ids)
            corners = StereoObservation(observation.ids[fresh], observation.uvd[fresh])
        points_w = points_at(self.camera, pose, images.depth, corners.uvd[:, :2])
        known = np.isfinite(points_w).all(axis=1)
        if self._moves is not None:
            moving = self._moves(points_w)
            self._moving_ids.append(corners.ids[moving])
            known &= ~moving
        self._ids.append(corners.ids[known])
        self._points.append(points_w[known])
        return self.tracked.observation

    @property
    def moving_ids(self) -> IntArray:
        """Corners found so far that are truly on moving bodies; ascending."""
        return np.concatenate(self._moving_ids)

    @property
    def landmarks(self) -> LandmarkTruth:
        """True positions of the corners found so far, as far as the render tells: not at the edges of things."""
        ids, points = np.concatenate(self._ids), np.concatenate(self._points)
        order = np.argsort(ids, kind="stable")
        return LandmarkTruth(ids[order], points[order])
