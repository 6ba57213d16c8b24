"""What tells streams of measurements apart: a name before they are recorded, a digest and a description afterwards."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from filters.noise import StereoNoise
from stereo_slam_env.benchmark.recordings.sensor_noise import noise_of_images
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.recording.recording import Recording


def stream_key(scenario: Scenario, choice: FilterChoice | None = None) -> str:
    """Equal for scenarios whose recordings of a seed are the same, a short name for files.

    Of a competitor that decides what it measures (`choice.policy`), with its label: what it and its filter are told
    decides, too.
    """
    about = [scenario.kind, dict(scenario.options), scenario.frames, [dict(entry) for entry in scenario.corruptions]]
    if choice is None or choice.policy is None:
        return _short_digest(about)
    told = [scenario.noise and dict(scenario.noise), scenario.common_options, scenario.use_odometry]
    return f"{choice.label}-{_short_digest([*about, *told, dataclasses.asdict(choice)])}"


def _short_digest(about: list[Any]) -> str:
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:10]


def description_of(recording: Recording) -> dict[str, Any]:
    """What is kept of a recording beside it; JSON-able."""
    description: dict[str, Any] = {
        "name": recording.name,
        "frames": len(recording),
        "stream_sha256": stream_digest(recording),
        "R": recording.noise.R.tolist(),
        "reference": dataclasses.asdict(recording.reference),
        "source": dict(recording.source),
    }
    measured = noise_of_images(recording)
    return description if measured is None else {**description, "sensor_noise": measured}


def as_given(description: Mapping[str, Any], scenario: Scenario) -> dict[str, Any]:
    """What is kept of a recording with a trial on it: its description, and the noise that is assumed of it."""
    about = {key: value for key, value in description.items() if key not in ("code", "R")}
    return {**about, "assumed_R": scenario.assumed_noise(StereoNoise(description["R"])).R.tolist()}


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
        seen, odometry = frame.observation, frame.odometry
        parts += [np.float64(frame.timestamp), seen.ids, seen.uvd, seen.v_right, seen.R]
        parts += [None] if odometry is None else [odometry.linear, odometry.angular, odometry.covariance]
    for part in parts:
        digest.update(b"-" if part is None else np.ascontiguousarray(part).tobytes() + b"|")
    return digest.hexdigest()
