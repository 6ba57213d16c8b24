"""Simulated sensors: tracked landmarks and odometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from filters import BodyVelocity, Pose, StereoCamera, StereoObservation
from filters.geometry import rotations
from filters.validation import BoolArray, FloatArray, IntArray, positive, unchecked
from stereo_slam_env.recording.recording import LandmarkTruth, Velocity
from stereo_slam_env.sensing.pixel_noise import PixelNoise

Occlusion = Callable[[Pose, FloatArray], BoolArray]
"""(left camera pose, points in W (N, 3)) -> which points both cameras see (N,)."""


@dataclass(frozen=True)
class TrackingPolicy:
    """Number and visibility limits of the tracked landmarks."""

    max_landmarks: int = 90  # most landmarks in one frame
    refill_below: int = 65  # new ones are only taken up, to `max_landmarks`, when fewer than this are left
    nearest: float = 4.0  # least depth z, m
    farthest: float = 150.0  # largest depth z, m
    margin: float = 2.0  # distance to the edge of both images, px
    revisit: bool = False  # whether a lost landmark may be tracked again, under its old id


class LandmarkSensor:
    """Tracks landmarks from frame to frame and measures them with noise.

    A landmark is kept as long as both cameras see it. New ones are drawn with a probability proportional to their
    disparity, so near ones are preferred. The generator is the source of the choice and of the noise.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: PixelNoise,
        landmarks: LandmarkTruth,
        visible: Occlusion,
        policy: TrackingPolicy,
        rng: np.random.Generator,
    ) -> None:
        self.camera, self.noise, self.landmarks, self.policy = camera, noise, landmarks, policy
        self._visible = visible
        self._choice_rng, self._noise_rng = rng.spawn(2)
        self._edges = (-0.5 - camera.cx) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx
        """x / z at the left and at the right edge of the left image."""
        self._positions_t = np.ascontiguousarray(landmarks.positions.T)
        self._tracked = np.zeros(len(landmarks.ids), dtype=bool)
        self._lost = np.zeros(len(landmarks.ids), dtype=bool)

    def observe(self, pose: Pose) -> StereoObservation:
        """Track to the frame taken from `pose` and measure; ids ascend."""
        in_view, uvd = self._in_view(pose)
        before = self._tracked[in_view]
        kept = in_view[before]
        kept = kept[self._visible(pose, self.landmarks.positions[kept])]
        tracked = np.zeros_like(self._tracked)
        tracked[kept] = True
        if not self.policy.revisit:
            self._lost |= self._tracked & ~tracked
        if len(kept) < self.policy.refill_below:
            fresh = ~(before | self._lost[in_view])
            tracked[self._draw(pose, in_view[fresh], uvd[fresh, 2], self.policy.max_landmarks - len(kept))] = True
        self._tracked = tracked
        measured, v_right = self.noise.corrupt(uvd[tracked[in_view]], self._noise_rng)
        return unchecked(StereoObservation, ids=self.landmarks.ids[tracked], uvd=measured, v_right=v_right, R=None)

    def project(self, pose: Pose) -> FloatArray:
        """True (u, v, d) of every landmark, visible or not; (N, 3) px."""
        return self.camera.project(pose.to_camera(self.landmarks.positions))

    def _in_view(self, pose: Pose) -> tuple[IntArray, FloatArray]:
        """Which landmarks are within range and inside both images, ascending (K,), and their true (u, v, d) (K, 3)."""
        # One row a coordinate, which is several times as fast for thousands of landmarks as one row a landmark.
        points_c = pose.R_wc.T @ (self._positions_t - pose.position[:, None])
        x, _, z = points_c
        left, right = self._edges
        near = (z >= self.policy.nearest) & (z <= self.policy.farthest) & (x >= left * z) & (x <= right * z)
        candidates = near.nonzero()[0]
        uvd = self.camera.project(points_c.take(candidates, axis=1).T)
        inside = self.camera.in_view(uvd, self.policy.margin).nonzero()[0]
        return candidates[inside], uvd.take(inside, axis=0)

    def _draw(self, pose: Pose, candidates: IntArray, disparities: FloatArray, wanted: int) -> IntArray:
        """Choose up to `wanted` visible candidates without replacement, weighted by disparity.

        Sorting by exponential variates over the weights is that draw; only as many as needed are tested by rays.
        """
        order = candidates[np.argsort(self._choice_rng.exponential(size=len(candidates)) / disparities)]
        chosen: list[IntArray] = []
        while wanted > 0 and len(order):
            tested, order = order[: 2 * wanted], order[2 * wanted :]
            found = tested[self._visible(pose, self.landmarks.positions[tested])][:wanted]
            chosen.append(found)
            wanted -= len(found)
        return np.concatenate(chosen) if chosen else np.zeros(0, dtype=np.int64)


class OdometrySensor:
    """Measures the mean velocity of the left camera over a step, with noise of a sigma for each axis, m/s and rad/s."""

    def __init__(self, sigma_linear: float, sigma_angular: float) -> None:
        sigmas = [
            positive("odometry_sigma_linear", sigma_linear, allow_zero=True),
            positive("odometry_sigma_angular", sigma_angular, allow_zero=True),
        ]
        self._sigmas: FloatArray = np.repeat(sigmas, 3)
        self._covariance: FloatArray = np.diag(self._sigmas**2)
        self._covariance.flags.writeable = False

    def measure(self, before: Pose, velocity: Velocity, dt: float, rng: np.random.Generator) -> BodyVelocity:
        """Measure the step of `dt` s that left `before` with `velocity`.

        The linear part is in the camera frame half-way through the turn, as filters expect it.
        """
        half_way = before.R_wc @ rotations.exp(0.5 * dt * velocity.angular)
        true = np.concatenate([half_way.T @ velocity.linear, velocity.angular])
        measured = true + self._sigmas * rng.standard_normal(6)
        return unchecked(BodyVelocity, linear=measured[:3], angular=measured[3:], covariance=self._covariance)
