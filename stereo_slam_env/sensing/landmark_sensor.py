"""The landmark sensor: which landmarks a stereo front end would track, and where it would measure them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from filters.camera import StereoCamera
from filters.interface import StereoObservation
from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.recording import LandmarkTruth, Pose
from stereo_slam_env.sensing.pixel_noise import PixelNoise

Occlusion = Callable[[Pose, FloatArray], BoolArray]
"""(left camera pose, points in W (N, 3)) -> which points both eyes see (N,)."""


@dataclass(frozen=True)
class TrackingPolicy:
    """How many landmarks are tracked, and which can be.

    Attributes
    ----------
    max_landmarks : int
        Most landmarks in one frame.
    refill_below : int
        New ones are only taken up, to `max_landmarks`, when fewer than this are left.
    nearest, farthest : float
        Range of depths z, m.
    margin : float
        Distance to the edge of both images, px.
    revisit : bool
        Whether a lost landmark may be tracked again, under its old id.
    """

    max_landmarks: int = 90
    refill_below: int = 65
    nearest: float = 4.0
    farthest: float = 150.0
    margin: float = 2.0
    revisit: bool = False


class LandmarkSensor:
    """Tracks landmarks from frame to frame and measures them with noise.

    A landmark is kept as long as both eyes see it. New ones are drawn with a probability proportional to their
    disparity, so near ones are preferred.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    noise : PixelNoise
        Noise of the measurements.
    landmarks : LandmarkTruth
        All landmarks of the scene.
    visible : callable
        Whether anything is in between, see `Occlusion`.
    policy : TrackingPolicy
        What is tracked.
    rng : numpy.random.Generator
        Source of the choice and of the noise.
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
        self._tracked = np.zeros(len(landmarks.ids), dtype=bool)
        self._lost = np.zeros(len(landmarks.ids), dtype=bool)

    def observe(self, pose: Pose) -> StereoObservation:
        """Track to the frame taken from `pose` and measure; ids ascend."""
        uvd = self.project(pose)
        in_range = self._in_view(uvd)
        kept = np.flatnonzero(self._tracked & in_range)
        kept = kept[self._visible(pose, self.landmarks.positions[kept])]
        tracked = np.zeros_like(self._tracked)
        tracked[kept] = True
        if not self.policy.revisit:
            self._lost |= self._tracked & ~tracked
        if len(kept) < self.policy.refill_below:
            candidates = np.flatnonzero(in_range & ~self._tracked & ~self._lost)
            tracked[self._draw(pose, candidates, uvd[candidates, 2], self.policy.max_landmarks - len(kept))] = True
        self._tracked = tracked
        measured, v_right = self.noise.corrupt(uvd[tracked], self._noise_rng)
        return StereoObservation(self.landmarks.ids[tracked], measured, v_right)

    def project(self, pose: Pose) -> FloatArray:
        """True (u, v, d) of every landmark, visible or not; (N, 3) px."""
        return self.camera.project(pose.to_camera(self.landmarks.positions))

    def _in_view(self, uvd: FloatArray) -> BoolArray:
        constant = self.camera.disparity_constant
        d = uvd[:, 2]
        in_view: BoolArray = (d >= constant / self.policy.farthest) & (d <= constant / self.policy.nearest)
        in_view[in_view] = self.camera.in_view(uvd[in_view], self.policy.margin)
        return in_view

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
