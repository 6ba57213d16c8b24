"""The poses of a reference, held against what the images say of the same steps.

A step of the reference carries the tracked points of a frame to where they should be in the next. So does the motion
that fits the tracks best. Where the reference puts most of them much farther from where they were seen, its step is
doubtful, however good its poses are on the whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from filters import StereoCamera
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.frontend.ego_motion import Pairs, Step, robust_step, transfer
from stereo_slam_env.frontend.track_noise import FIRST_GUESS
from stereo_slam_env.recording.recording import Recording

FACTOR, LEAST = 3.0, 0.5
"""A step is doubtful whose median residual is so many times that of the images, and larger by so many pixels: turns of
1 mrad a frame at the focal length of KITTI, which no mounting of a camera and no noise of a reference explain."""


@dataclass(frozen=True, eq=False)
class ReferenceAudit:
    """Residuals of the steps to K frames, and which of them speak against the reference."""

    frames: FloatArray
    """(K,): numbers of the frames that the steps lead to."""
    by_reference: FloatArray
    """(K,): median distance of tracks in the left image from where the step of the reference puts them, px."""
    by_images: FloatArray
    """(K,): that of the motion which fits the tracks best, px."""

    @property
    def doubtful(self) -> BoolArray:
        """(K,): whether the images contradict the step of the reference."""
        far: BoolArray = self.by_reference > np.maximum(FACTOR * self.by_images, self.by_images + LEAST)
        return far

    def __str__(self) -> str:
        frames = self.frames[self.doubtful].astype(int).tolist()
        if not len(self.frames):
            return "the images show no motion to hold it against"
        medians = np.median([self.by_reference, self.by_images], axis=1)
        residuals = f"median residual {medians[0]:.2f} px, by the images {medians[1]:.2f}"
        if not frames:
            return f"the images do not contradict it in {len(self.frames)} steps ({residuals})"
        listed = ", ".join(map(str, frames[:12])) + (", ..." if len(frames) > 12 else "")
        return (
            f"doubtful in {len(frames)} of {len(self.frames)} steps, where the images say otherwise: "
            f"to frames {listed} ({residuals})"
        )


def median_residual(camera: StereoCamera, pairs: Pairs, step: Step) -> float:
    """Median distance in the left image of points from where a step carries them, px."""
    off = (pairs.second - transfer(camera, pairs.first, step).uvd)[:, :2]
    return float(np.median(np.linalg.norm(off, axis=1)))


def audit_of(recording: Recording) -> ReferenceAudit:
    """Hold each step of the reference against the motion of the tracks, where both are known."""
    rows, found = [], None
    for k, (before, now) in enumerate(pairwise(recording.frames), start=1):
        pairs = Pairs.between(before.observation, now.observation, FIRST_GUESS)
        found = robust_step(recording.camera, pairs, None if found is None else found.step)
        if found is None or before.truth is None or now.truth is None:
            continue
        step = before.truth.inverse() @ now.truth
        by_reference = median_residual(recording.camera, pairs, Step(step.R_wc, step.position))
        rows.append((k, by_reference, median_residual(recording.camera, pairs, found.step)))
    return ReferenceAudit(*np.array(rows, dtype=np.float64).reshape(-1, 3).T)
