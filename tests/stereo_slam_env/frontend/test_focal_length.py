"""A focal length that is stated wrong shows where the camera turns."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stereo_slam_env.frontend.focal_length import focal_length_error
from stereo_slam_env.frontend.track_noise import with_measured_noise
from stereo_slam_env.recording.recording import SIMULATION, Recording

from .test_track_noise import CAMERA, drive


def stated(share: float, recording: Recording) -> Recording:
    """The drive by a camera whose focal length is stated too large."""
    camera = dataclasses.replace(CAMERA, fx=CAMERA.fx * (1.0 + share), fy=CAMERA.fy * (1.0 + share))
    return dataclasses.replace(recording, camera=camera)


@pytest.mark.parametrize("share", [-0.05, 0.0, 0.02])
def test_it_is_found_within_its_standard_error(share: float) -> None:
    found = [focal_length_error(stated(share, drive(white=0.1, seed=seed, turn=0.03))) for seed in range(4)]
    for value, sigma in found:
        assert sigma < 0.01
        assert abs(value - share) < 4.0 * sigma + 0.1 * abs(share)


def test_a_straight_drive_shows_a_tenth_of_it_at_most() -> None:
    """It is a stretch of the world there."""
    (_, turning), (_, straight) = (focal_length_error(drive(white=0.1, turn=turn)) for turn in (0.03, 0.0))
    assert straight > 10.0 * turning


def test_without_motions_nothing_is_known() -> None:
    assert focal_length_error(drive()[:1]) == (0.0, np.inf)


@pytest.mark.parametrize(("share", "warned"), [(0.1, True), (-0.1, True), (0.02, False)])
def test_a_focal_length_far_off_is_warned_of(share: float, warned: bool, caplog: pytest.LogCaptureFixture) -> None:
    recording = stated(share, drive(white=0.1, turn=0.03))
    with_measured_noise(recording)
    which = "shorter" if share > 0 else "longer"
    assert [f"% {which} than stated" in message for message in caplog.messages] == [True] * warned
    caplog.clear()
    with_measured_noise(dataclasses.replace(recording, truth_from=SIMULATION))
    assert not caplog.messages
