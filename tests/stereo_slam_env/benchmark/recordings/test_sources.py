"""Scenario and seed to recording (5 s, most of it the street)."""

from dataclasses import replace

import numpy as np
import pytest

from filters import StereoObservation
from stereo_slam_env.benchmark.recordings.source import Source
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource, StreetSource, source_of
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.streams import make_recording, stream_digest
from stereo_slam_env.sensing.rigs import RIGS

from ...third_party import install
from ..small_recordings import small_recording


@pytest.mark.parametrize(
    "scenario",
    [
        Scenario("s", StreetSource({"route": "right-turn", "max_landmarks": 30}), frames=6),
        Scenario("s", ReferenceSource("short_turn"), frames=6),
        Scenario("s", ReferenceSource("relative_noise_loop", {"level": 0.05}), frames=6),
    ],
    ids=lambda scenario: scenario.source.options.get("name", "street"),
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
    ("kind", "options", "complaint"),
    [
        ("reference", {"name": "long_drvie"}, r"options\.name must be one of long_drive, .*did you mean 'long_drive'"),
        ("reference", {"name": "short_turn", "sgima": 1.0}, "short_turn has no option 'sgima', did you mean 'sigma'"),
        ("dataset", {}, "options must have path"),
        ("dataset", {"path": 3}, r"options\.path must be text, got 3"),
        ("factory", {"call": "nowhere"}, 'call must be "package.module:function"'),
        ("factory", {"call": "math:no_such"}, "got 'math:no_such'"),
        ("factory", {"call": "math"}, "got 'math': it cannot be called"),
        ("factory", {"call": "builtins:dict"}, "returned a dict, not a Recording"),
        ("street", {"rout": "town"}, "did you mean 'route'"),
        ("street", {"x": object()}, "options must consist of JSON values"),
        ("gaze", {}, "has no recording for all"),
        ("streat", {}, "kind must be one of street, .*, got 'streat', did you mean 'street'"),
    ],
)
def test_wrong_sources_are_named(kind, options, complaint):
    with pytest.raises(ValueError, match=complaint):
        source_of(kind, options).record(0)


class CannedSource(Source, tag="canned"):
    """A source of somebody else's: all there is to do is this class."""

    name: str
    length: int = 3

    def record(self, seed, frames=None, progress=None):
        return replace(small_recording(frames=self.length), name=f"{self.name}-{seed}")


def test_a_source_of_somebody_elses_is_one_class():
    data = {"name": "mine", "kind": "canned", "options": {"name": "x", "length": 5}, "frames": 4, "seeds": [2]}
    scenario = Scenario.from_dict(data)
    assert scenario.source == CannedSource("x", 5)
    assert Scenario.from_dict(scenario.as_dict()) == scenario
    recording = make_recording(scenario, 2)
    assert (recording.name, len(recording)) == ("x-2", 4)
    with pytest.raises(ValueError, match="kind 'canned' has no option 'lenght', did you mean 'length'"):
        source_of("canned", {"name": "x", "lenght": 5})
    with pytest.raises(ValueError, match=r"options\.length must be a whole number, got 'long'"):
        source_of("canned", {"name": "x", "length": "long"})


def test_an_installed_source_is_found_by_its_entry_point(tmp_path, monkeypatch):
    module = (
        "from stereo_slam_env.benchmark import ReferenceSource\nclass Mine(ReferenceSource, tag='mine'):\n    pass\n"
    )
    points = {"mine": "Mine", "broken": "Nothing"}
    install(tmp_path, "my_source_package", module, points, group="stereo_slam.sources")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert source_of("mine", {"name": "short_turn"}).record(0, frames=2).name == "short-turn"
    with pytest.raises(ValueError, match=r"kind 'broken' \(my_source_package.*\) cannot be loaded: AttributeError"):
        source_of("broken", {})


def test_options_are_what_was_given_and_key_the_same_whatever_their_order():
    first, second = source_of("street", {"route": "town", "sigma": 2.0}), StreetSource({"sigma": 2.0, "route": "town"})
    assert first.options == {"route": "town", "sigma": 2.0}
    assert first.key == second.key != source_of("street", {"route": "town"}).key
    assert source_of("gaze", {"route": "town", "sigma": 2.0}).key != first.key
    assert first.replaced(sigma=3.0).options == {"route": "town", "sigma": 3.0}
    assert StreetSource({"rig": RIGS["vga"]}).options["rig"]["width"] == 640


@pytest.mark.parametrize("noise", ["heavy-tailed", "quantised"])
@pytest.mark.parametrize(
    "scenario",
    [
        Scenario("s", StreetSource({"route": "right-turn", "max_landmarks": 30}), frames=3),
        Scenario("s", ReferenceSource("short_turn"), frames=3),
    ],
    ids=lambda scenario: scenario.source.kind,
)
def test_noise_that_is_not_gaussian_disturbs_the_same_drive(scenario, noise):
    """Nothing but the errors of the measurements differs from the drive with Gaussian noise."""
    other = scenario.replaced(source=scenario.source.replaced(noise=noise, sigma=0.5))
    gaussian, disturbed = (make_recording(s, 1) for s in (scenario, other))
    for a, b in zip(gaussian.frames, disturbed.frames, strict=True):
        np.testing.assert_array_equal(a.truth.position, b.truth.position)
        np.testing.assert_array_equal(a.observation.ids, b.observation.ids)
        assert (a.observation.uvd != b.observation.uvd).any()
    assert np.isclose(disturbed.noise.R[1, 1], 0.25 + (1 / 12 if noise == "quantised" else 0))
