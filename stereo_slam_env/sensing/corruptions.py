"""Corruptions: faults between the world and a filter, applied to a `Recording` after the fact.

A corruption is a small frozen dataclass with one method; any number of them can be applied one after the other. They
change what a filter is given (measurements, what it is told about them, the order of frames) and never the truth of the
drive, so runs with and without one are paired.

To add one: a class with `applied_to`, listed in `CORRUPTIONS`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from filters import BodyVelocity, StereoObservation
from filters.contract.validation import positive, probability, require_known, whole_number
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.recording.inertial import joined
from stereo_slam_env.recording.recording import Frame, Recording, Velocity
from stereo_slam_env.sensing.corrupted_measurements import (
    BiasedDisparity,
    Checked,
    MisscaledNoise,
    MissedDetections,
    MovingLandmarks,
    Outliers,
    WrongCalibration,
    WrongIds,
    checked,
)


@dataclass(frozen=True)
class Blackouts(Checked):
    """For a while nothing at all is measured: glare, a dark tunnel, a blank wall.

    Parameters
    ----------
    probability : float
        Of each frame to begin one.
    seconds : float
        How long each lasts, s; those that overlap are one.
    """

    probability: float = checked(probability)
    seconds: float = checked(positive)

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`."""
        times = np.array([frame.timestamp for frame in recording.frames])
        begins = rng.random(len(times)) < self.probability
        last_begin = np.maximum.accumulate(np.where(begins, times, -np.inf))
        dark = times - last_begin < self.seconds
        return recording.with_observations(
            _nothing(frame.observation) if black else frame.observation
            for frame, black in zip(recording.frames, dark, strict=True)
        )


@dataclass(frozen=True)
class DroppedFrames(Checked):
    """Frames that never arrive; the step over the gap is longer, its odometry and samples are of the whole step.

    Parameters
    ----------
    probability : float
        Of each frame but the first to be missing.
    """

    probability: float = checked(probability)

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`."""
        arrives = rng.random(len(recording)) >= self.probability
        arrives[:1] = True
        kept = np.flatnonzero(arrives).tolist()
        later = (_after_gap(recording.frames[before : k + 1]) for before, k in pairwise(kept))
        return replace(recording, frames=(*recording.frames[:1], *later))


@dataclass(frozen=True)
class DuplicatedFrames(Checked):
    """The camera delivers the picture before once more, as if it were new.

    Parameters
    ----------
    probability : float
        Of each frame but the first to show the measurements of the one before.
    """

    probability: float = checked(probability)

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`; time, odometry and truth go on."""
        fresh = rng.random(len(recording)) >= self.probability
        fresh[:1] = True
        shown = np.maximum.accumulate(np.where(fresh, np.arange(len(recording)), 0))
        return recording.with_observations(recording.frames[k].observation for k in shown)


@dataclass(frozen=True)
class Latency(Checked):
    """Measurements arrive late and are taken for current ones.

    Parameters
    ----------
    frames : int
        By how many frames.
    """

    frames: int = checked(partial(whole_number, low=0))

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`; nothing is random. Before the first measurements arrive there are none."""
        seen = [frame.observation for frame in recording.frames]
        none = [_nothing(observation) for observation in seen[: self.frames]]
        return recording.with_observations([*none, *seen[: len(seen) - len(none)]])


def _nothing(seen: StereoObservation) -> StereoObservation:
    return seen.select(np.zeros(len(seen), dtype=np.bool_))


def _after_gap(frames: tuple[Frame, ...]) -> Frame:
    """The last of the frames, with velocities of the whole step from the first one on."""
    first, last = frames[0], frames[-1]
    if len(frames) == 2:
        return last
    durations = np.diff([frame.timestamp for frame in frames])
    steps = [frame.odometry for frame in frames[1:]]
    odometry = None if any(step is None for step in steps) else _mean_odometry([s for s in steps if s], durations)
    velocity = None
    if last.truth_velocity is not None and first.truth is not None and last.truth is not None:
        turn = rotations.log(rotations.matrix(rotations.between(first.truth.orientation, last.truth.orientation)))
        whole = float(durations.sum())
        velocity = Velocity((last.truth.position - first.truth.position) / whole, turn / whole)
    inertial = joined([frame.inertial for frame in frames[1:]], durations)
    return replace(last, odometry=odometry, truth_velocity=velocity, inertial=inertial)


def _mean_odometry(steps: list[BodyVelocity], durations: FloatArray) -> BodyVelocity:
    """One step that leads where the `steps` lead; its linear part in the camera half-way through the turn."""
    r, R = np.zeros(3), np.eye(3)
    covariance = np.zeros((6, 6))
    for step, dt in zip(steps, durations, strict=True):
        turn = dt * step.angular
        r = r + dt * R @ rotations.exp(0.5 * turn) @ step.linear
        R = R @ rotations.exp(turn)
        covariance += dt**2 * step.covariance
    whole = float(durations.sum())
    angular = rotations.log(R) / whole
    linear = rotations.exp(0.5 * whole * angular).T @ r / whole
    return BodyVelocity(linear, angular, covariance / whole**2)


class Corruption(Protocol):
    """One fault."""

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """The recording with this fault, everything random from `rng`; `recording` itself stays as it was.

        A `ValueError` where the recording lacks what is needed, such as the truth.
        """


CORRUPTIONS: Mapping[str, type[Any]] = {
    "outliers": Outliers,
    "wrong-ids": WrongIds,
    "missed-detections": MissedDetections,
    "blackouts": Blackouts,
    "dropped-frames": DroppedFrames,
    "duplicated-frames": DuplicatedFrames,
    "latency": Latency,
    "moving-landmarks": MovingLandmarks,
    "wrong-calibration": WrongCalibration,
    "biased-disparity": BiasedDisparity,
    "misscaled-noise": MisscaledNoise,
}
"""By the name they have in scenario files; each is a frozen dataclass and a `Corruption`."""


def make_corruption(entry: Mapping[str, Any]) -> Corruption:
    """A corruption from its JSON form: `kind`, a key of `CORRUPTIONS`, and the fields of that class.

    A `ValueError` names an unknown kind, an unknown or missing field, or an impossible value.
    """
    if not isinstance(entry, Mapping) or "kind" not in entry:
        raise ValueError(f"a corruption must have a kind, one of {', '.join(CORRUPTIONS)}, got {entry!r}")
    kind = entry["kind"]
    require_known("there is no corruption", [kind], CORRUPTIONS)
    given = {name: value for name, value in entry.items() if name != "kind"}
    fields = dataclasses.fields(CORRUPTIONS[kind])
    require_known(f"corruption {kind!r} has no field", given, [field.name for field in fields])
    for field in fields:
        if field.default is dataclasses.MISSING and field.name not in given:
            raise ValueError(f"corruption {kind!r} needs the field {field.name}")
    try:
        made: Corruption = CORRUPTIONS[kind](**given)
    except ValueError as error:
        raise ValueError(f"corruption {kind!r}: {error}") from error
    return made


def corrupted(recording: Recording, entries: Sequence[Mapping[str, Any]], seed: int) -> Recording:
    """The recording with everything in `entries` gone wrong, in that order.

    Parameters
    ----------
    recording : Recording
        What was measured; it stays as it was.
    entries : sequence of mapping
        JSON forms, see `make_corruption`.
    seed : int
        Same seed, same bits. Each entry has a random stream of its own, so one added at the end changes nothing of
        what those before it do.

    Returns
    -------
    Recording
        `source["corruptions"]` says what was done.

    Raises
    ------
    ValueError
        An entry is wrong, or needs something that the recording does not have. Entries are all checked first.
    """
    corruptions = [make_corruption(entry) for entry in entries]
    if not corruptions:
        return recording
    streams = np.random.default_rng(seed).spawn(len(corruptions))
    result = recording
    for entry, corruption, rng in zip(entries, corruptions, streams, strict=True):
        try:
            result = corruption.applied_to(result, rng)
        except ValueError as error:
            raise ValueError(f"corruption {entry['kind']!r} of {recording.name!r}: {error}") from error
    done = [{"kind": e["kind"], **vars(c), "seed": seed} for e, c in zip(entries, corruptions, strict=True)]
    before = recording.source.get("corruptions", [])
    return dataclasses.replace(result, source={**result.source, "corruptions": [*before, *done]})
