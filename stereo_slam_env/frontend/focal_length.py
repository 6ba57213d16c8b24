"""Error of the stated focal length, from the turns of a drive.

While a camera goes straight on, a focal length that is wrong stretches the world along the optical axis, and no image
shows it. In a turn the axis turns, too, and no stretch of one world fits all frames.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from stereo_slam_env.frontend.camera_motion import camera_steps
from stereo_slam_env.frontend.ego_motion import MIN_POINTS, transfer
from stereo_slam_env.recording.recording import Recording

_PROBE = 1e-4
"""Share of the focal length by which residuals are differentiated."""
_OUTLIER = 4.0
"""Robust standard deviations beyond which a residual is a mismatch or a moving object."""


def focal_length_error(recording: Recording) -> tuple[float, float]:
    """Share by which the stated focal length is too large, and its standard error, from frame to frame.

    Least squares over the tracks of each two frames that follow each other, with a motion of the camera for each two
    and one focal length for all. The standard error is infinite where no frame shows it. Tracks that slide look like a
    focal length that is wrong by some percent.
    """
    camera = recording.camera
    longer = dataclasses.replace(camera, fx=camera.fx * (1.0 + _PROBE), fy=camera.fy * (1.0 + _PROBE))
    sums = []  # (information, information times the share) of each step
    for found in camera_steps(camera, recording.frames):
        if found is None:
            continue
        first, second = found.pairs.first, found.pairs.second
        expected = transfer(camera, first, found.step)
        residuals = second - expected.uvd
        by_share = (expected.uvd - transfer(longer, first, found.step).uvd) / _PROBE
        sizes = 1.4826 * np.median(np.abs(residuals), axis=0) + 1e-9
        near = np.all(np.abs(residuals) <= _OUTLIER * sizes, axis=1) & np.isfinite(by_share).all(axis=1)
        if near.sum() < MIN_POINTS:
            continue
        Q, _ = np.linalg.qr((expected.by_step[near] / sizes[:, None]).reshape(-1, 6))
        x, y = ((part[near] / sizes).ravel() for part in (by_share, residuals))
        x = x - Q @ (Q.T @ x)  # what no motion explains
        sums.append((x @ x, x @ y))
    information, weighted = np.array(sums).reshape(-1, 2).T
    if not information.sum() > 0.0:
        return 0.0, np.inf
    share = weighted.sum() / information.sum()
    return float(share), float(np.linalg.norm(weighted - share * information) / information.sum())
