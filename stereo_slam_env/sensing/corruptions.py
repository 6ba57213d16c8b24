"""Corruptions: faults between the world and a filter, applied to a `Recording` after the fact.

A corruption is a small frozen dataclass with one method; any number of them can be applied one after the other. They
change what a filter is given (measurements, what it is told about them, the order of frames) and never the truth of the
drive, so runs with and without one are paired.

To add one: a class with `applied_to`, listed in `CORRUPTIONS`.

Noise models of stereo measurements, each with its covariance R.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, Literal, Protocol

import numpy as np

from filters import BodyVelocity, StereoNoise, StereoObservation
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
    """Gaps in which nothing at all is measured: glare, a dark tunnel, a blank wall.

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
        arrives = rng.random(len(recording)) >= self.probability
        arrives[:1] = True
        arrived = np.flatnonzero(arrives).tolist()
        later = (_after_gap(recording.frames[before : k + 1]) for before, k in pairwise(arrived))
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
        """Time, odometry and truth go on."""
        fresh = rng.random(len(recording)) >= self.probability
        fresh[:1] = True
        frame_shown = np.maximum.accumulate(np.where(fresh, np.arange(len(recording)), 0))
        return recording.with_observations(recording.frames[k].observation for k in frame_shown)


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
        """Nothing is random. Before the first measurements arrive there are none."""
        observations = [frame.observation for frame in recording.frames]
        none = [_nothing(observation) for observation in observations[: self.frames]]
        return recording.with_observations([*none, *observations[: len(observations) - len(none)]])


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
        total = float(durations.sum())
        velocity = Velocity((last.truth.position - first.truth.position) / total, turn / total)
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
    total = float(durations.sum())
    angular = rotations.log(R) / total
    linear = rotations.exp(0.5 * total * angular).T @ r / total
    return BodyVelocity(linear, angular, covariance / total**2)


class Corruption(Protocol):
    """Fault of a stream of measurements."""

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
    options = {name: value for name, value in entry.items() if name != "kind"}
    fields = dataclasses.fields(CORRUPTIONS[kind])
    require_known(f"corruption {kind!r} has no field", options, [field.name for field in fields])
    for field in fields:
        if field.default is dataclasses.MISSING and field.name not in options:
            raise ValueError(f"corruption {kind!r} needs the field {field.name}")
    try:
        corruption: Corruption = CORRUPTIONS[kind](**options)
    except ValueError as error:
        raise ValueError(f"corruption {kind!r}: {error}") from error
    return corruption


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


class PixelNoise(Protocol):
    """Model of the noise of measurements."""

    @property
    def stereo_noise(self) -> StereoNoise:
        """Covariance of the (u, v, d) that `corrupt` returns."""

    @property
    def largest_error(self) -> float:
        """No error of u, v or d is ever that large, px."""

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray | None]:
        """Add noise to true measurements (M, 3), px: left pixel and disparity.

        Returns the measured ones, and the rows (M,) measured in the right image where the model has such, else None.
        """


class IndependentPixels:
    """u_l, v_l, u_r and v_r independent, `sigma` px each; d = u_l - u_r, v = v_l."""

    def __init__(self, sigma: float) -> None:
        self.sigma = positive("sigma", sigma)
        self.stereo_noise = StereoNoise.independent_pixels(sigma)
        self.largest_error = 10.0 * self.sigma

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """`v_right` is measured."""
        u_left, v_left, u_right, v_right = self._errors(rng, (4, len(uvd)))
        return uvd + np.stack([u_left, v_left, u_left - u_right], axis=1), uvd[:, 1] + v_right

    def _errors(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        return self.sigma * rng.standard_normal(shape)


class IndependentUvd:
    """u, v and d independent, `sigma` px each: the paper's assumption."""

    def __init__(self, sigma: float) -> None:
        self.sigma = positive("sigma", sigma)
        self.stereo_noise = StereoNoise.diagonal(sigma, sigma, sigma)
        self.largest_error = 10.0 * self.sigma

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, None]:
        """There is no `v_right`."""
        return uvd + self.sigma * rng.standard_normal((len(uvd), 3)), None


class HeavyTailedPixels(IndependentPixels):
    """Independent errors of a correlation matcher in each coordinate: sharp, with rare mismatches.

    The shape is that of `matching_errors`, scaled so that its standard deviation is `sigma`; R is then that of
    `IndependentPixels`, so that only the shape differs: at 1 px, 60 % of the errors have 0.03 px, 36 % 0.19 px, and 4 %
    are anywhere up to 8.6 px. The size as it was measured is `sigma = MATCHING_SIGMA`, 2.3 px.
    """

    def __init__(self, sigma: float) -> None:
        super().__init__(sigma)
        self.largest_error = 20.0 * self.sigma

    def _errors(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        return self.sigma / MATCHING_SIGMA * matching_errors(rng, shape)


_WEIGHTS, _SIGMAS, _REACH = (0.60, 0.36, 0.04), (0.07, 0.45), 20.0

MATCHING_SIGMA = math.sqrt(sum(w * s**2 for w, s in zip(_WEIGHTS, (*_SIGMAS, _REACH / math.sqrt(3.0)), strict=True)))
"""Standard deviation of `matching_errors`, px; 99 % of the variance is that of the mismatches."""


def matching_errors(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Errors of corners matched in rendered images, px.

    A mixture fitted to the disparities that normalised correlation and one Lucas-Kanade step found in OpenGL images of
    1344x391 pixels: 60 % have sigma 0.07 px, 36 % 0.45 px, and 4 % are uniform over +-20 px.
    """
    part = rng.choice(3, shape, p=_WEIGHTS)
    gaussian = rng.standard_normal(shape) * np.array([*_SIGMAS, 0.0])[part]
    return np.where(part == 2, rng.uniform(-_REACH, _REACH, shape), gaussian)


class QuantisedPixels(IndependentPixels):
    """Independent errors in four coordinates, which are then rounded to whole pixels, so that d is whole, too.

    Rounding adds 1/12 px^2 to each, independent of the rest as long as landmarks fall anywhere between pixels.
    """

    def __init__(self, sigma: float) -> None:
        super().__init__(sigma)
        self.stereo_noise = StereoNoise.independent_pixels(float(np.sqrt(self.sigma**2 + 1.0 / 12.0)))
        self.largest_error += 1.0

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """`v_right` is measured."""
        measured, v_right = super().corrupt(uvd, rng)
        u_left, v_left, u_right = np.rint([measured[:, 0], measured[:, 1], measured[:, 0] - measured[:, 2]])
        return np.stack([u_left, v_left, u_left - u_right], axis=1), np.rint(v_right)


NoiseName = Literal["pixels", "uvd", "heavy-tailed", "quantised"]
NOISE_MODELS: Mapping[str, Callable[[float], PixelNoise]] = {
    "pixels": IndependentPixels,
    "uvd": IndependentUvd,
    "heavy-tailed": HeavyTailedPixels,
    "quantised": QuantisedPixels,
}
