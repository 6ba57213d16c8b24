"""Full smoothing with GTSAM as a filter: what the data allow, for those who compare with it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from filters import BodyVelocity, CameraState, InertialSamples, StereoCamera, StereoNoise
from filters.contract.validation import positive
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.motions.motion_model import CAMERA_SIZE, POSE_SIZE
from stereo_slam_env.baselines.dead_reckoning import CameraBelief
from stereo_slam_env.baselines.guided_smoother import GuidedSmoother
from stereo_slam_env.baselines.smoothing_graph import Smoothed, SmoothingGraph


class BatchSmoother(GuidedSmoother):
    """Full smoothing of all poses and landmarks by GTSAM, with stereo and motion factors.

    Nothing is ever marginalised. Everything is solved again whenever the drive has grown by a tenth (`growth`); in
    between the guide carries on from there. Uncertainties are those of the guide. `smooth()` solves now and gives all
    poses. Needs the extra `gtsam`.

    Parameters
    ----------
    camera, noise, **options
        See `GuidedSmoother`.
    growth : float
        Share by which the drive grows from one solution to the next; infinity leaves it to `smooth()`, which on a long
        drive may then end in a false minimum (see `Smoothed.degrees_of_freedom`).

    Raises
    ------
    ValueError
        gtsam is not installed, or an option has an impossible value.
    """

    def __init__(self, camera: StereoCamera, noise: StereoNoise, *, growth: float = 0.1, **options: Any) -> None:
        self._growth = math.inf if growth == math.inf else positive("growth", growth)
        super().__init__(camera, noise, **options)

    def _new_graph(self, start: CameraState, P: FloatArray) -> SmoothingGraph:
        self._next_solution = 1.0
        return SmoothingGraph(self.camera, start, P, self._tail_dof)

    def smooth(self) -> Smoothed:
        """Solve now; all poses given all measurements so far."""
        self._solve()
        return self._graph.smoothed()

    def predict(self, dt: float, odometry: BodyVelocity | None = None, inertial: InertialSamples | None = None) -> None:
        """Move the guide forward; the step enters the graph with the next frame."""
        super().predict(dt, odometry, inertial)
        self._follow_guide()

    def _finish(self, believed: bool) -> None:
        if believed and self._graph.last >= self._next_solution:
            self._solve()
            self._next_solution = self._graph.last * (1.0 + self._growth)
        self._follow_guide()

    def _follow_guide(self) -> None:
        """The guide's belief, in the world of the graph."""
        pose, velocity = self._guide.pose, self._guide.velocity
        state = CameraState(
            self._turn @ pose.position + self._shift,
            rotations.multiply(rotations.exp_quaternion(rotations.log(self._turn)), pose.orientation),
            self._turn @ velocity.linear,
            velocity.angular,
        )
        P = np.zeros((CAMERA_SIZE, CAMERA_SIZE))
        for first, covariance in ((0, pose.covariance), (POSE_SIZE, velocity.covariance)):
            turned = covariance.copy()
            turned[:3] = self._turn @ turned[:3]
            turned[:, :3] = turned[:, :3] @ self._turn.T
            P[first : first + 6, first : first + 6] = 0.5 * (turned + turned.T)
        self._belief = CameraBelief(state, P)
