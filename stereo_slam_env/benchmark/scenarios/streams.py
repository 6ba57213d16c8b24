"""Measurement streams of a scenario: recordings, images, episodes of policies, their keys and descriptions."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from filters.catalogue.registry import make_with_common_options
from filters.contract.inputs import StereoObservation
from filters.contract.noise import ColouredNoise, StereoNoise
from stereo_slam_env.benchmark.recordings.source import OpenedImages, Progress
from stereo_slam_env.benchmark.scenarios.recording_description import measurement_errors, noise_by_range
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.recording.recording import Recording, require_frames
from stereo_slam_env.sensing.corruptions import corrupted, make_corruption

if TYPE_CHECKING:
    from stereo_slam_env.policies.policy_rows import Episode


def make_recording(scenario: Scenario, seed: int | None, progress: Progress | None = None) -> Recording:
    """The measurement stream of `scenario` for `seed` (None for a real recording).

    Where it comes from images, `progress` is called with (pairs done, pairs) after each.

    Raises
    ------
    ValueError
        The source refuses its options or yields no frames: the message names what is wrong.
    """
    return _as_asked(scenario.source.record(seed, scenario.frames, progress), scenario, seed)


def make_recordings(
    scenario: Scenario, seeds: Sequence[int | None], progress: Progress | None = None
) -> list[Recording]:
    """`make_recording` for some seeds, by a source that makes them at once."""
    recordings = scenario.source.records(seeds, scenario.frames, progress)
    return [_as_asked(recording, scenario, seed) for recording, seed in zip(recordings, seeds, strict=True)]


def _as_asked(recording: Recording, scenario: Scenario, seed: int | None) -> Recording:
    """The frames that the scenario wants of a recording, with its corruptions; it states how filters are set up."""
    if scenario.frames is not None:
        recording = dataclasses.replace(recording, frames=recording.frames[: scenario.frames])
    if scenario.corruptions:
        recording = corrupted(recording, scenario.corruptions, seed or 0)
    require_frames(recording)
    return dataclasses.replace(recording, stated_setup=scenario.filter_setup)


def make_sequence(scenario: Scenario, seed: int | None) -> OpenedImages:
    """The images of a scenario, and the settings of the front end; a `ValueError` for one without images."""
    if not scenario.source.takes_images:
        raise ValueError(f"scenario {scenario.name!r} has no images: give sensor='images' or a recording of images")
    return scenario.source.sequence(seed, scenario.frames)


def without_measurements(recording: Recording) -> Recording:
    """Recording for filters that measure in the images themselves: no observations, and no true landmarks by id."""
    none = StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    return dataclasses.replace(recording.with_observations([none] * len(recording)), landmarks=None)


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
            f"scenario {scenario.name!r} must not assume a noise: in images each measurement comes with "
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
    """Episode of one of `scenario.competitors`: its policy turns the head, with its filter in the loop.

    The filter is made and told exactly what `run_filter` makes and tells it, so that a run over the recording says what
    the policy heard.
    """
    from stereo_slam_env.envs import BeliefObservation, BeliefPanorama
    from stereo_slam_env.policies import make_policy
    from stereo_slam_env.policies.policy_rows import run_episode

    assert choice.policy is not None
    core = scenario.source.make_environment()
    try:
        noise = scenario.assumed_noise(core.get_wrapper_attr("noise"))
        options = make_with_common_options(
            choice.name, core.get_wrapper_attr("camera"), noise, choice.options, scenario.common_options
        ).options
        env: Any = BeliefPanorama(
            BeliefObservation(
                core,
                filter=choice.name,
                options=options,
                noise=noise.R.tolist(),
                use_odometry=scenario.use_odometry,
            )
        )
        policy = make_policy(choice.policy.name, **choice.policy.options)
        about = {"policy": msgspec.to_builtins(choice.policy), "filter": {"name": choice.name, "options": options}}
        with threadpool_limits(limits=1):
            return run_episode(env, policy, seed, frames=scenario.frames, progress=progress, about=about)
    finally:
        core.close()


def drive_straight_ahead(scenario: Scenario, seed: int | None, progress: Progress | None = None) -> Episode:
    """Episode with a fixed head and without a filter."""
    from stereo_slam_env.policies.named_policies import FixedGaze
    from stereo_slam_env.policies.policy_rows import run_episode

    env = scenario.source.make_environment()
    try:
        return run_episode(env, FixedGaze(), seed or 0, frames=scenario.frames, progress=progress)
    finally:
        env.close()


def stream_key(scenario: Scenario, choice: FilterChoice | None = None) -> str:
    """Short name of a stream, for files: equal where the recordings of a seed are the same.

    Of a competitor that decides what it measures (`choice.policy`), with its label: what it and its filter are told
    decides, too.
    """
    source = scenario.source
    about = [source.kind, source.options, scenario.frames, [dict(entry) for entry in scenario.corruptions]]
    if choice is None or choice.policy is None:
        return _short_digest(about)
    setup = [scenario.noise and dict(scenario.noise), scenario.common_options, scenario.use_odometry]
    return f"{choice.label}-{_short_digest([*about, *setup, msgspec.to_builtins(choice)])}"


def _short_digest(about: list[Any]) -> str:
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:10]


# ---- descriptions of recordings -------------------------------------------------------------------------------------


def as_given(description: Mapping[str, Any], scenario: Scenario) -> dict[str, Any]:
    """Description of a recording that is kept with a trial, with the noise that was assumed."""
    about = {
        key: value for key, value in description.items() if key not in ("code", "plugin_code", "R", "audit", "words")
    }
    return {**about, "assumed_R": scenario.assumed_noise(StereoNoise(description["R"])).R.tolist()}


def pairing_digest(about: Mapping[str, Any]) -> str:
    """Digest that competitors must share to be compared: of the measurements, or with policies of the drive."""
    return str(about.get("drive_sha256") or about["stream_sha256"])


def seed_description(given: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Description of the recordings of a seed, from those of what each competitor was given."""
    first = dict(next(iter(given.values())))
    if "drive_sha256" not in first:
        return first
    del first["stream_sha256"]
    source = {key: value for key, value in first["source"].items() if key not in ("policy", "filter")}
    return {**first, "source": source, "streams": {label: about["stream_sha256"] for label, about in given.items()}}


def description_of(recording: Recording) -> dict[str, Any]:
    """Description of a recording that is kept beside it, JSON-able."""
    description: dict[str, Any] = {
        "name": recording.name,
        "frames": len(recording),
        "stream_sha256": stream_digest(recording),
        "R": recording.noise.R.tolist(),
        "coloured_noise": recording.noise.parts if isinstance(recording.noise, ColouredNoise) else None,
        "reference": dataclasses.asdict(recording.reference),
        "source": dict(recording.source),
    }
    if recording.reference.counts_as_truth and recording.reference.kind != "simulation":
        from stereo_slam_env.frontend.camera_motion import audit_of  # needs OpenCV, only where it is needed

        audit = audit_of(recording)
        description["audit"] = None if audit is None else audit.as_dict()
    if recording.truth_from.kind != "simulation":
        from stereo_slam_env.benchmark.scenarios.recording_description import recording_words

        description["words"] = recording_words(recording)
    from_images = any(frame.observation.R is not None for frame in recording.frames)
    if recording.landmarks is not None and from_images:
        rows = [dataclasses.asdict(row) for row in noise_by_range(measurement_errors(recording))]
        # The open end of the last range is null.
        description["sensor_noise"] = [
            {**row, "high": row["high"] if np.isfinite(row["high"]) else None} for row in rows
        ]
    return description


def stream_digest(recording: Recording) -> str:
    """SHA-256 of everything a filter is given: equal digests mean bit-identical input."""
    digest = hashlib.sha256(repr(recording.camera).encode())
    start = recording.start
    parts: list[Any] = [
        recording.noise.R,
        start.position,
        start.orientation,
        start.linear_velocity,
        start.angular_velocity,
        start.covariance,
    ]
    for frame in recording.frames:
        observation, odometry = frame.observation, frame.odometry
        parts += [np.float64(frame.timestamp), observation.ids, observation.uvd, observation.v_right, observation.R]
        parts += [None] if odometry is None else [odometry.linear, odometry.angular, odometry.covariance]
        if frame.inertial is not None:
            samples, unit = frame.inertial, frame.inertial.unit
            parts += [samples.times, samples.angular_rates, samples.specific_forces, unit.position, unit.orientation]
            parts += [unit.gyro_density, unit.accelerometer_density, unit.gyro_walk, unit.accelerometer_walk]
    if isinstance(recording.noise, ColouredNoise):
        digest.update(json.dumps(recording.noise.parts).encode())
    for part in parts:
        digest.update(b"-" if part is None else np.ascontiguousarray(part).tobytes() + b"|")
    return digest.hexdigest()
