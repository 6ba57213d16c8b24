"""Measurement streams of a scenario: recordings, images, episodes of policies, and the keys they are kept under."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from filters.common_options import make_with_common_options
from filters.interface import StereoObservation
from filters.noise import StereoNoise
from stereo_slam_env.benchmark.recordings.source import OpenedImages, Progress
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.sensing.corruptions import corrupted, make_corruption

if TYPE_CHECKING:
    from stereo_slam_env.policies.episode import Episode


def make_recording(scenario: Scenario, seed: int | None, progress: Progress | None = None) -> Recording:
    """The measurement stream of `scenario` for `seed` (None for a real recording).

    Where it comes from images, `progress` is called with (pairs done, pairs) after each.

    Raises
    ------
    ValueError
        The source refuses its options or yields no frames: the message names what is wrong.
    """
    recording = scenario.source.record(seed, scenario.frames, progress)
    if scenario.frames is not None:
        recording = dataclasses.replace(recording, frames=recording.frames[: scenario.frames])
    if scenario.corruptions:
        recording = corrupted(recording, scenario.corruptions, seed or 0)
    if len(recording) == 0:
        raise ValueError(f"recording {recording.name!r} has no frames")
    return recording


def make_sequence(scenario: Scenario, seed: int | None) -> OpenedImages:
    """The images of a scenario that has them, and the settings of the front end for them.

    Raises
    ------
    ValueError
        The scenario has no images, or its options are refused.
    """
    if not scenario.source.takes_images:
        raise ValueError(f"scenario {scenario.name!r} has no images: give sensor='images' or a recording of images")
    return scenario.source.sequence(seed, scenario.frames)


def without_measurements(recording: Recording) -> Recording:
    """The drive as filters know it that measure for themselves; ids of landmarks are theirs then, so truth has none."""
    none = StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    frames = tuple(dataclasses.replace(frame, observation=none) for frame in recording.frames)
    return dataclasses.replace(recording, frames=frames, landmarks=None)


def check_source(scenario: Scenario) -> None:
    """Raise a `ValueError` for a source that cannot be used as the scenario says, before any work is done."""
    source = scenario.source
    sees = source.takes_images
    if scenario.search == "forecast" and source.for_policies:
        raise ValueError(
            f"search 'forecast' does not go with kind {source.kind!r}: its environments have their own front end"
        )
    if scenario.search == "forecast" and not sees:
        raise ValueError(f"search 'forecast' needs images: scenario {scenario.name!r} has none")
    if scenario.noise is not None and sees:
        raise ValueError(
            f"scenario {scenario.name!r} must not assume a noise (--sigma-px): in images each measurement comes with "
            f"its own covariance"
        )
    for corruption in scenario.corruptions:
        make_corruption(corruption)
    source.check(scenario.frames)
    if scenario.policies:
        from stereo_slam_env.policies import make_policy

        for choice in scenario.policies:
            make_policy(choice.name, **choice.options)


def drive_episode(
    scenario: Scenario, seed: int, choice: FilterChoice, progress: Callable[[int, int], None] | None = None
) -> Episode:
    """The episode in which the policy of a competitor looks, with its filter in the loop.

    The filter is made and told exactly what `run_filter` makes and tells it, so that a run over the recording says what
    the policy heard.

    Parameters
    ----------
    scenario : Scenario
        One with policies.
    seed : int
        Of the episode.
    choice : FilterChoice
        One of `scenario.competitors`.
    progress : callable, optional
        Called with (frames done, frames) after each.
    """
    from stereo_slam_env.policies import make_policy
    from stereo_slam_env.policies.episode import run_episode
    from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama

    assert choice.policy is not None
    core = scenario.source.make_environment()
    try:
        noise = scenario.assumed_noise(core.get_wrapper_attr("noise"))
        options = make_with_common_options(
            choice.name, core.get_wrapper_attr("camera"), noise, choice.options, scenario.common_options
        ).options
        env = BeliefPanorama(
            BeliefObservation(
                core,
                filter=choice.name,
                options=options,
                noise=noise.R.tolist(),
                use_odometry=scenario.use_odometry,
            )
        )
        policy = make_policy(choice.policy.name, **choice.policy.options)
        about = {"policy": dataclasses.asdict(choice.policy), "filter": {"name": choice.name, "options": options}}
        with threadpool_limits(limits=1):
            return run_episode(env, policy, seed, frames=scenario.frames, progress=progress, about=about)
    finally:
        core.close()


def drive_straight_ahead(scenario: Scenario, seed: int) -> Episode:
    """The episode of a fixed head and no filter."""
    from stereo_slam_env.policies.episode import run_episode
    from stereo_slam_env.policies.open_loop import FixedGaze

    env = scenario.source.make_environment()
    try:
        return run_episode(env, FixedGaze(), seed, frames=scenario.frames)
    finally:
        env.close()


def stream_key(scenario: Scenario, choice: FilterChoice | None = None) -> str:
    """Equal for scenarios whose recordings of a seed are the same, a short name for files.

    Of a competitor that decides what it measures (`choice.policy`), with its label: what it and its filter are told
    decides, too.
    """
    source = scenario.source
    about = [source.kind, source.options, scenario.frames, [dict(entry) for entry in scenario.corruptions]]
    if choice is None or choice.policy is None:
        return _short_digest(about)
    told = [scenario.noise and dict(scenario.noise), scenario.common_options, scenario.use_odometry]
    return f"{choice.label}-{_short_digest([*about, *told, dataclasses.asdict(choice)])}"


def _short_digest(about: list[Any]) -> str:
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:10]


def as_given(description: Mapping[str, Any], scenario: Scenario) -> dict[str, Any]:
    """What is kept of a recording with a trial on it: its description, and the noise that is assumed of it."""
    about = {key: value for key, value in description.items() if key not in ("code", "R")}
    return {**about, "assumed_R": scenario.assumed_noise(StereoNoise(description["R"])).R.tolist()}


def pairing_digest(about: Mapping[str, Any]) -> str:
    """What must be the same for competitors to be compared: the measurements, or the drive where each one looks."""
    return str(about.get("drive_sha256") or about["stream_sha256"])


def seed_description(given: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Description of the recordings of a seed, from those of what each competitor was given."""
    first = dict(next(iter(given.values())))
    if "drive_sha256" not in first:
        return first
    del first["stream_sha256"]
    source = {key: value for key, value in first["source"].items() if key not in ("policy", "filter")}
    return {**first, "source": source, "streams": {label: about["stream_sha256"] for label, about in given.items()}}
