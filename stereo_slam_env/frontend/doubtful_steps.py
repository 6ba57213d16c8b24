"""The poses of a reference, held against what the images say of the same steps.

A step of the reference carries the tracked points of a frame to where they should be in the next. So does the motion
that fits the tracks best. Where the reference puts most of them much farther from where they were seen, its step is
doubtful, however good its poses are on the whole.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from filters import StereoCamera
from stereo_slam_env.evaluation.reference_audit import ReferenceAudit
from stereo_slam_env.frontend.camera_motion import camera_steps
from stereo_slam_env.frontend.ego_motion import Pairs, Step, transfer
from stereo_slam_env.recording.recording import Recording


def median_residual(camera: StereoCamera, pairs: Pairs, step: Step) -> float:
    """Median distance in the left image of points from where a step carries them, px."""
    off = (pairs.second - transfer(camera, pairs.first, step).uvd)[:, :2]
    return float(np.median(np.linalg.norm(off, axis=1)))


def audit_of(recording: Recording) -> ReferenceAudit | None:
    """Hold each step of the reference against the motion of the tracks, where both are known.

    None where there is no reference, an exact one, or one that is an odometry of the same images.
    """
    reference = recording.reference
    if not reference.counts_as_truth or reference.kind == "simulation":
        return None
    rows = []
    steps = camera_steps(recording.camera, recording.frames)
    for k, ((before, now), found) in enumerate(zip(pairwise(recording.frames), steps, strict=True), start=1):
        if found is None or before.truth is None or now.truth is None:
            continue
        true = before.truth.inverse() @ now.truth
        of_both = (Step(true.R_wc, true.position), found.step)
        rows.append((k, *(median_residual(recording.camera, found.pairs, step) for step in of_both)))
    return ReferenceAudit(*np.array(rows, dtype=np.float64).reshape(-1, 3).T)
