"""Errors of a stereo rig that a drive shows: the offset of the disparities, yaw and roll of the right camera."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from filters import ColouredNoise, StereoEKF
from stereo_slam_env.loop import run
from stereo_slam_env.recording.recording import Recording

SHOWN = ("disparity_offset", "right_yaw", "right_roll")
"""Those of `ColouredNoise` that images can show, in the order of the variable "calibration"."""


def rig_errors(recording: Recording) -> Mapping[str, tuple[float, float]]:
    """Estimates and their standard errors after the drive, px and rad, by "coloured-noise" with vision only.

    Only what the noise of the recording has a prior for is estimated; nothing where it has none.
    """
    noise = recording.noise
    names = [name for name in SHOWN if getattr(noise, name)] if isinstance(noise, ColouredNoise) else []
    if not names or not recording.frames:
        return {}
    *_, last = run("coloured-noise", recording, use_odometry=False)
    assert isinstance(last.slam, StereoEKF)
    found = last.slam.belief("calibration")
    sigmas = np.sqrt(np.diag(found.covariance))
    return {name: (float(x), float(s)) for name, x, s in zip(names, found.value, sigmas, strict=True)}
