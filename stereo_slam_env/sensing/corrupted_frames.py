"""Corruptions of whole frames, see `stereo_slam_env.sensing.corruptions`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from filters import rotations
from filters.interface import BodyVelocity, StereoObservation
from filters.validation import FloatArray, positive, probability
from stereo_slam_env.recording.recording import Frame, Recording, Velocity


@dataclass(frozen=True)
class Blackouts:
    """For a while nothing at all is measured: glare, a dark tunnel, a blank wall.

    Parameters
    ----------
    probability : float
        Of each frame to begin one.
    seconds : float
        How long each lasts, s; those that overlap are one.
    """

    probability: float
    seconds: float

    def __post_init__(self) -> None:
        probability("probability", self.probability)
        positive("seconds", self.seconds)

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
class DroppedFrames:
    """Frames that never arrive; the step over the gap is longer, and its odometry is that of the whole step.

    Parameters
    ----------
    probability : float
        Of each frame but the first to be missing.
    """

    probability: float

    def __post_init__(self) -> None:
        probability("probability", self.probability)

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`."""
        arrives = rng.random(len(recording)) >= self.probability
        arrives[:1] = True
        kept = np.flatnonzero(arrives).tolist()
        later = (_after_gap(recording.frames[before : k + 1]) for before, k in pairwise(kept))
        return replace(recording, frames=(*recording.frames[:1], *later))


@dataclass(frozen=True)
class DuplicatedFrames:
    """The camera delivers the picture before once more, as if it were new.

    Parameters
    ----------
    probability : float
        Of each frame but the first to show the measurements of the one before.
    """

    probability: float

    def __post_init__(self) -> None:
        probability("probability", self.probability)

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`; time, odometry and truth go on."""
        fresh = rng.random(len(recording)) >= self.probability
        fresh[:1] = True
        shown = np.maximum.accumulate(np.where(fresh, np.arange(len(recording)), 0))
        return recording.with_observations(recording.frames[k].observation for k in shown)


@dataclass(frozen=True)
class Latency:
    """Measurements arrive late and are taken for current ones.

    Parameters
    ----------
    frames : int
        By how many frames.
    """

    frames: int

    def __post_init__(self) -> None:
        if type(self.frames) is not int or self.frames < 0:
            raise ValueError(f"frames must be a whole number >= 0, got {self.frames!r}")

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
    return replace(last, odometry=odometry, truth_velocity=velocity)


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
