"""Scenario and seed to recording (5 s, most of it the street)."""

from dataclasses import replace

import numpy as np
import pytest

from filters import StereoObservation
from stereo_slam_env.benchmark.recordings.sources import make_recording
from stereo_slam_env.benchmark.recordings.stream_identity import stream_digest
from stereo_slam_env.benchmark.scenarios.scenario import Scenario

from ..small_recordings import small_recording


@pytest.mark.parametrize(
    "scenario",
    [
        Scenario("s", "street", {"route": "right-turn", "max_landmarks": 30}, frames=6),
        Scenario("s", "reference", {"name": "short_turn"}, frames=6),
        Scenario("s", "reference", {"name": "relative_noise_loop", "level": 0.05}, frames=6),
    ],
    ids=lambda scenario: scenario.options.get("name", scenario.kind),
)
def test_the_same_seed_gives_the_same_stream_and_another_one_another(scenario):
    first, again, other = (make_recording(scenario, seed) for seed in (3, 3, 4))
    assert len(first) == 6
    assert stream_digest(first) == stream_digest(again)
    assert stream_digest(first) != stream_digest(other)


def test_every_part_of_the_input_is_in_the_digest():
    recording = small_recording()
    digest = stream_digest(recording)
    frame = recording.frames[3]
    moved = frame.observation.uvd.copy()
    moved[0, 0] += 1e-9
    for changed in (
        replace(frame, observation=StereoObservation(frame.observation.ids, moved)),
        replace(frame, timestamp=frame.timestamp + 1e-9),
        replace(frame, odometry=None),
        replace(frame, observation=replace(frame.observation, v_right=np.ones(len(frame.observation)))),
    ):
        frames = (*recording.frames[:3], changed, *recording.frames[4:])
        assert stream_digest(replace(recording, frames=frames)) != digest


@pytest.mark.parametrize(
    ("scenario", "complaint"),
    [
        (
            Scenario("s", "reference", {"name": "long_way"}),
            "must be one of long_drive, short_turn, relative_noise_loop, got",
        ),
        (Scenario("s", "dataset"), "needs the option path"),
        (Scenario("s", "factory", {"call": "nowhere"}), 'call must be "package.module:function"'),
        (Scenario("s", "factory", {"call": "math:no_such"}), "got 'math:no_such'"),
        (Scenario("s", "factory", {"call": "builtins:dict"}), "returned a dict, not a Recording"),
        (Scenario("s", "street", {"rout": "town"}), "did you mean 'route'"),
    ],
)
def test_wrong_sources_are_named(scenario, complaint):
    with pytest.raises(ValueError, match=complaint):
        make_recording(scenario, 0)


@pytest.mark.parametrize("noise", ["heavy-tailed", "quantised"])
@pytest.mark.parametrize(
    "scenario",
    [
        Scenario("s", "street", {"route": "right-turn", "max_landmarks": 30}, frames=3),
        Scenario("s", "reference", {"name": "short_turn"}, frames=3),
    ],
    ids=lambda scenario: scenario.kind,
)
def test_noise_that_is_not_gaussian_disturbs_the_same_drive(scenario, noise):
    """Nothing but the errors of the measurements differs from the drive with Gaussian noise."""
    other = replace(scenario, options={**scenario.options, "noise": noise, "sigma": 0.5})
    gaussian, disturbed = (make_recording(s, 1) for s in (scenario, other))
    for a, b in zip(gaussian.frames, disturbed.frames, strict=True):
        np.testing.assert_array_equal(a.truth.position, b.truth.position)
        np.testing.assert_array_equal(a.observation.ids, b.observation.ids)
        assert (a.observation.uvd != b.observation.uvd).any()
    assert np.isclose(disturbed.noise.R[1, 1], 0.25 + (1 / 12 if noise == "quantised" else 0))
