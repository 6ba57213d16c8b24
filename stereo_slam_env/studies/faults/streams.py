"""Faults that no scenario file needs: streams that are illegal by contract, out of order, or of another place.

Each is a `Corruption` (see `stereo_slam_env.sensing.corruptions`) and is given the frames in which it lasts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from filters import rotations
from filters.interface import StereoObservation
from filters.validation import BoolArray, FloatArray, IntArray, positive, probability, unchecked
from stereo_slam_env.recording.recording import Frame, LandmarkTruth, Pose, Recording
from stereo_slam_env.sensing.corrupted_measurements import known_world, seen_elsewhere

_MOST_FRAMES = 200


@dataclass(frozen=True)
class Reordered:
    """Frames that are overtaken by the one behind them: they arrive with a time that has passed.

    Parameters
    ----------
    probability : float
        Of each frame to be overtaken.
    """

    probability: float

    def __post_init__(self) -> None:
        probability("probability", self.probability)

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`."""
        late = rng.random(len(recording)) < self.probability
        order = np.argsort(np.arange(len(recording)) + 1.5 * late, kind="stable")
        return replace(recording, frames=tuple(recording.frames[k] for k in order))


@dataclass(frozen=True)
class BadNumbers:
    """Now and then a frame has numbers that no camera measures.

    Parameters
    ----------
    value : float
        Written over u, v or d; NaN and infinity are illegal by contract, everything else is not.
    frames : float
        Probability of each frame to have some.
    share : float
        Probability of each number of such a frame.
    """

    value: float
    frames: float = 0.3
    share: float = 0.2

    def __post_init__(self) -> None:
        probability("frames", self.frames)
        probability("share", self.share)

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`; the observations are as a driver hands them out, so not checked."""
        observations = []
        for frame in recording.frames:
            seen = frame.observation
            hit = (rng.random(seen.uvd.shape) < self.share) & (rng.random() < self.frames)
            observations.append(
                unchecked(StereoObservation, **{**vars(seen), "uvd": np.where(hit, self.value, seen.uvd)})
            )
        return recording.with_observations(observations)


@dataclass(frozen=True)
class NoDisparity:
    """Landmarks for which the two images do not agree: d is 0 or less, which is legal.

    Parameters
    ----------
    share : float
        Probability of each measurement.
    """

    share: float

    def __post_init__(self) -> None:
        probability("share", self.share)

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`."""
        observations = []
        for frame in recording.frames:
            uvd = frame.observation.uvd.copy()
            hit = rng.random(len(uvd)) < self.share
            uvd[hit, 2] = -rng.integers(0, 3, int(hit.sum()))
            observations.append(replace(frame.observation, uvd=uvd))
        return recording.with_observations(observations)


@dataclass(frozen=True)
class Kidnapped:
    """From one frame to the next the camera is further on along its road.

    Parameters
    ----------
    seconds : float
        Of the drive that are missing; no time passes.
    """

    seconds: float

    def __post_init__(self) -> None:
        positive("seconds", self.seconds)

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`; nothing is random."""
        there = recording.frames[0].timestamp + self.seconds
        after = [frame for frame in recording.frames if frame.timestamp >= there - 1e-9]
        moved = (replace(frame, timestamp=frame.timestamp - self.seconds, odometry=None) for frame in after)
        return replace(recording, frames=tuple(moved))


@dataclass(frozen=True)
class TimeSteps:
    """The same drive at steps of any length, drawn evenly in their logarithm.

    Parameters
    ----------
    shortest, longest : float
        Of the steps, s.
    """

    shortest: float
    longest: float

    def __post_init__(self) -> None:
        if positive("longest", self.longest) < positive("shortest", self.shortest):
            raise ValueError(f"longest must not be below shortest, got {self.longest!r} and {self.shortest!r}")

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`: the pose between two frames is interpolated, and what the nearest shows is measured."""
        landmarks = known_world(recording)
        first, times = recording.frames[0], np.array([frame.timestamp for frame in recording.frames])
        steps = np.exp(rng.uniform(np.log(self.shortest), np.log(self.longest), _MOST_FRAMES))
        arrive = first.timestamp + np.cumsum(steps)
        frames = [first]
        for time in arrive[arrive <= times[-1]]:
            pose = _between(recording.frames, times, time)
            nearest = recording.frames[int(np.abs(times - time).argmin())]
            frames.append(
                Frame(float(time), _measured(recording, landmarks, nearest.observation.ids, pose, rng), truth=pose)
            )
        return replace(recording, frames=tuple(frames))


@dataclass(frozen=True)
class MovingTruck:
    """Something large fills the view and drives off, in the direction in which the camera looks at first.

    Parameters
    ----------
    share : float
        Of the landmarks that are on it: of those that come into view one after the other, evenly.
    speed : float
        That it reaches, m/s.
    acceleration : float
        Until then, m/s^2.
    """

    share: float
    speed: float
    acceleration: float

    def __post_init__(self) -> None:
        probability("share", self.share)
        positive("speed", self.speed)
        positive("acceleration", self.acceleration)

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`: a landmark is on the truck from where it is first seen."""
        landmarks = known_world(recording)
        on_truck = self._on_truck(recording, landmarks, rng)
        begins, forward = recording.frames[0].timestamp, _pose(recording.frames[0]).R_wc[:, 2]
        boarded = np.full(len(landmarks.ids), np.nan)
        observations = []
        for frame in recording.frames:
            place = np.searchsorted(landmarks.ids, frame.observation.ids)
            concerned = on_truck[place]
            those = place[concerned]
            driven = self._driven(frame.timestamp - begins)
            boarded[those] = np.fmin(boarded[those], driven)
            static = landmarks.positions[those]
            moved = static + (driven - boarded[those])[:, None] * forward
            observations.append(seen_elsewhere(frame, recording.camera, concerned, static, moved))
        return recording.with_observations(observations)

    def _on_truck(self, recording: Recording, landmarks: LandmarkTruth, rng: np.random.Generator) -> BoolArray:
        """Which landmarks (N,): in every view about that share, not none or all by chance."""
        seen, first = np.unique(
            np.concatenate([frame.observation.ids for frame in recording.frames]), return_index=True
        )
        count = np.floor(self.share * np.arange(len(seen) + 1) + rng.random())
        on_truck = np.zeros(len(landmarks.ids), dtype=bool)
        on_truck[np.searchsorted(landmarks.ids, seen[np.argsort(first)])] = np.diff(count) > 0
        return on_truck

    def _driven(self, seconds: float) -> float:
        """Metres after that time."""
        speeding = min(seconds, self.speed / self.acceleration)
        return 0.5 * self.acceleration * speeding**2 + self.speed * (seconds - speeding)


def _pose(frame: Frame) -> Pose:
    assert frame.truth is not None
    return frame.truth


def _between(frames: tuple[Frame, ...], times: FloatArray, time: float) -> Pose:
    """The pose at `time`, straight and at an even turn from the frame before to the one after."""
    after = min(max(int(np.searchsorted(times, time)), 1), len(frames) - 1)
    first, last = _pose(frames[after - 1]), _pose(frames[after])
    share = (time - times[after - 1]) / (times[after] - times[after - 1])
    turn = share * rotations.log(rotations.matrix(rotations.between(first.orientation, last.orientation)))
    orientation = rotations.multiply(first.orientation, rotations.exp_quaternion(turn))
    return Pose((1.0 - share) * first.position + share * last.position, orientation)


def _measured(
    recording: Recording, landmarks: LandmarkTruth, ids: IntArray, pose: Pose, rng: np.random.Generator
) -> StereoObservation:
    points_c = pose.to_camera(landmarks.positions[np.searchsorted(landmarks.ids, ids)])
    ids, points_c = ids[points_c[:, 2] > 0], points_c[points_c[:, 2] > 0]
    errors = rng.multivariate_normal(np.zeros(3), recording.noise.R, len(ids))
    uvd = recording.camera.project(points_c) + errors
    visible = recording.camera.in_view(uvd)
    return StereoObservation(ids[visible], uvd[visible])
