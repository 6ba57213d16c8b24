"""Recording an episode."""

import json

import numpy as np
import pytest

from filters.contract.noise import StereoNoise
from stereo_slam_env.envs.recorder import record

QUICK = {"route": "right-turn", "rig": "qvga"}


def test_a_recording_holds_what_a_filter_and_a_judge_need():
    recording = record(QUICK, seed=3, frames=12)
    assert len(recording) == 12
    assert recording.noise == StereoNoise.independent_pixels(1.0)
    assert recording.camera.width == 320
    assert recording.start.covariance.shape == (12, 12)
    assert recording.frames[0].odometry is None
    assert all(frame.odometry is not None for frame in recording.frames[1:])
    assert all(frame.truth is not None and frame.truth_velocity is not None for frame in recording.frames)
    np.testing.assert_allclose([frame.timestamp for frame in recording.frames], 0.1 * np.arange(12))
    seen = np.unique(np.concatenate([frame.observation.ids for frame in recording.frames]))
    assert np.isin(seen, recording.landmarks.ids).all()


def test_the_source_says_how_to_make_it_again():
    recording = record({**QUICK, "noise": "uvd"}, seed=3, frames=4)
    source = json.loads(json.dumps(recording.source))
    again = record(source["arguments"], seed=source["seed"], frames=source["frames"])
    for one, two in zip(recording.frames, again.frames, strict=True):
        np.testing.assert_array_equal(one.observation.uvd, two.observation.uvd)
        np.testing.assert_array_equal(one.truth.position, two.truth.position)
    assert set(source["versions"]) == {"stereo-slam-env", "numpy", "pybullet", "gymnasium"}


def test_a_whole_route_is_recorded_with_progress():
    calls = []
    recording = record(QUICK, seed=0, progress=lambda done, total: calls.append((done, total)))
    assert len(recording) == 80
    assert calls[-1] == (80, None)
    assert len(calls) == 79


@pytest.mark.parametrize(
    ("kwargs", "frames", "message"),
    [
        ({"policy": "agent"}, None, "policy must be 'route'"),
        ({"route": "moon"}, None, "route must be one of"),
        (QUICK, 0, "frames must be at least 1, got 0"),
        (QUICK, 100, "frames must be at most 80 on route 'right-turn', got 100"),
    ],
)
def test_wrong_arguments(kwargs, frames, message):
    with pytest.raises(ValueError, match=message):
        record(kwargs, frames=frames)


@pytest.mark.parametrize("arguments", [{}, {"physics": "bullet"}])
def test_a_recording_says_which_physics_it_was_made_with(arguments):
    recording = record({"route": "right-turn", "rig": "qvga", "max_landmarks": 5, **arguments}, frames=3)
    assert recording.source["arguments"]["physics"] == arguments.get("physics", "exact")
