"""What planning policies share: the filter's belief, the directions to choose from, and the choice."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

from filters.interface import StereoFilter
from filters.validation import FloatArray
from stereo_slam_env.policies.foresight import Eyes, Knowledge
from stereo_slam_env.policies.interface import require_head
from stereo_slam_env.recording import Pose
from stereo_slam_env.sensing.landmark_sensor import TrackingPolicy
from stereo_slam_env.world.head import Head


class Observer:
    """An environment as a planner may know it: filter, head, eyes; see `Policy`.

    Parameters
    ----------
    env : gymnasium.Env
        With a filter in the loop and a head that moves.

    Raises
    ------
    ValueError
        One of the two is missing.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        self._env = env
        self.head: Head = require_head(env)
        try:
            env.get_wrapper_attr("slam")
        except AttributeError:
            raise ValueError(
                "the policy plans on the belief of a filter, and there is none: "
                "wrap the environment in stereo_slam_env.wrappers.BeliefObservation"
            ) from None
        options = env.get_wrapper_attr("options")
        tracking: TrackingPolicy = options.tracking
        self.eyes = Eyes(
            camera=env.get_wrapper_attr("camera"),
            noise=env.get_wrapper_attr("noise"),
            nearest=tracking.nearest,
            farthest=tracking.farthest,
            margin=tracking.margin,
            most=tracking.max_landmarks,
        )
        self.odometry_sigmas = (options.odometry_sigma_linear, options.odometry_sigma_angular)
        self.route = env.get_wrapper_attr("route")

    @property
    def slam(self) -> StereoFilter:
        """The filter."""
        slam: StereoFilter = self._env.get_wrapper_attr("slam")
        return slam

    @property
    def angles(self) -> FloatArray:
        """Pan and tilt now, rad; (2,)."""
        angles: FloatArray = self._env.get_wrapper_attr("head_angles")
        return angles

    def knowledge(self, ahead: float = 0.0) -> Knowledge:
        """The belief on landmarks that could be seen now, or after driving `ahead` m."""
        return Knowledge.of(self.slam, within=self._reach + ahead)

    def body(self, camera: Pose) -> Pose:
        """Where the camera would be if the head looked straight ahead."""
        return self.head.body_pose(camera, self.angles)

    @property
    def _reach(self) -> float:
        """Largest distance of a landmark that is measured, m: at the corner of the image."""
        camera = self.eyes.camera
        corner = camera.ray(np.array([[u, v] for u in (0, camera.width - 1) for v in (0, camera.height - 1)]))
        return self.eyes.farthest * float(np.linalg.norm(corner, axis=1).max())


def directions(head: Head, pans: int, tilts: int) -> FloatArray:
    """A grid of pan and tilt over all that the head can do, (pans * tilts, 2) rad; one is straight ahead if odd."""
    most_pan, most_tilt = head.max_angles
    pan = np.linspace(-most_pan, most_pan, pans) if pans > 1 else np.zeros(1)
    tilt = np.linspace(-most_tilt, most_tilt, tilts) if tilts > 1 else np.zeros(1)
    return np.stack(np.meshgrid(pan, tilt, indexing="ij"), axis=-1).reshape(-1, 2)


def turning_share(head: Head, angles: FloatArray, targets: FloatArray) -> FloatArray:
    """How far the targets (B, 2) are from `angles` (2,), in shares of the largest angles, summed; (B,)."""
    most = np.maximum(head.max_angles, np.finfo(float).tiny)
    share: FloatArray = (np.abs(targets - angles) / most).sum(axis=1)
    return share
