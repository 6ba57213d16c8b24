"""Stereo measurements of a cloud of points before and after a known motion."""

from dataclasses import dataclass

import numpy as np

from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from stereo_slam_env.frontend.ego_motion import Pairs, Step
from stereo_slam_env.frontend.tracks import new_tracks

CAMERA = StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, 1344, 391)
STEP = Step(rotations.exp([0.004, 0.03, -0.002]), np.array([0.05, -0.02, 0.9]))


def tracks_of(first, R):
    """Landmarks that were measured for the first time in the pair before."""
    patches = np.zeros((len(first), 23, 23), dtype=np.float32)
    ids = np.arange(10, 10 + len(first), dtype=np.int64)
    return new_tracks(ids, patches, first, R, np.eye(3), np.zeros(3)).next_pair()


@dataclass
class Cloud:
    """Points in the second camera, `pairs` measured with `sigma` px; the first `moved` points shift by `shift` m."""

    count: int = 80
    moved: int = 0
    shift: tuple = (0.4, 0.0, 0.8)
    sigma: float = 0.2
    seed: int = 0

    def pairs(self):
        rng = np.random.default_rng(self.seed)
        uvd = np.column_stack([
            rng.uniform(50, 1290, self.count), rng.uniform(30, 360, self.count),
            CAMERA.disparity_constant / rng.uniform(6.0, 50.0, self.count),
        ])  # fmt: skip
        p_before = CAMERA.backproject(uvd)
        if self.moved:  # a car: points within 1.5 m of each other, 15 m ahead
            p_before[: self.moved] = np.array([-3.0, 0.5, 15.0]) + rng.uniform(-0.7, 0.7, (self.moved, 3))
        p_now = (p_before - STEP.t) @ STEP.R
        p_now[: self.moved] += self.shift
        first, second = (
            CAMERA.project(p) + self.sigma * rng.standard_normal((self.count, 3)) for p in (p_before, p_now)
        )
        R = np.tile(self.sigma**2 * np.eye(3), (self.count, 1, 1))
        return Pairs(first, second, R, R)
