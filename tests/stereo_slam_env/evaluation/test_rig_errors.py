"""What a drive shows of the errors of its rig."""

from __future__ import annotations

import dataclasses

import numpy as np

import stereo_slam_env as sse
from filters import ColouredNoise
from stereo_slam_env.evaluation.audits import rig_errors
from stereo_slam_env.recording.recording import Recording


def told(recording: Recording, **priors: float) -> Recording:
    """The drive with priors of the rig's errors."""
    return dataclasses.replace(recording, noise=ColouredNoise(recording.noise.R, **priors))


def test_an_offset_of_the_disparities_is_found_within_its_standard_error() -> None:
    exact = sse.make_recording("reference-turn", 0)
    offset = np.array([0.0, 0.0, 0.8])
    seen = [frame.observation for frame in exact.frames]
    moved = exact.with_observations(dataclasses.replace(one, uvd=one.uvd + offset) for one in seen)
    found = {name: rig_errors(told(drive, disparity_offset=1.0)) for name, drive in (("0", exact), ("1", moved))}
    for name, true in (("0", 0.0), ("1", 0.8)):
        value, sigma = found[name]["disparity_offset"]
        assert sigma < 0.8
        assert abs(value - true) < 3.0 * sigma


def test_only_what_has_a_prior_is_found() -> None:
    drive = sse.make_recording("reference-turn", 0)
    assert rig_errors(drive) == {}
    assert list(rig_errors(told(drive, right_roll=0.01, disparity_offset=0.5))) == ["disparity_offset", "right_roll"]
    assert all(np.isfinite(value) for value in rig_errors(told(drive, right_yaw=0.01))["right_yaw"])
