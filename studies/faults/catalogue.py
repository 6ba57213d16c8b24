"""The faults, by name: what goes wrong in a drive, when, and for how long.

To add one: a line in `FAULTS`, and where it is something new a corruption (see `stereo_slam_env.sensing.Corruption`)
or, for what only images show, another drive.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from filters import Pose, StereoCamera, StereoObservation
from stereo_slam_env import Frame, LandmarkTruth, Recording, record
from stereo_slam_env.benchmark import long_drive
from stereo_slam_env.sensing import (
    Blackouts,
    Corruption,
    DroppedFrames,
    DuplicatedFrames,
    Latency,
    MisscaledNoise,
    MissedDetections,
    OfMeasurements,
    Outliers,
    WrongCalibration,
    WrongIds,
    known_world,
    moved_on,
)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
NOMINAL = "nominal"
LANDMARKS = 30
_ONSET = 8.0
_MOST_FRAMES = 200


def reference_drive(seed: int, frames: int) -> Recording:
    """The reference drive of a seed: pure geometry, 30 landmarks."""
    return long_drive(seed, frames=frames, landmarks=LANDMARKS)


def rendered_drive(surroundings: str, seed: int, frames: int, blank_from: float | None) -> Recording:
    """Drive round a block in small rendered images, measured by the front end; the first turn is from 7 to 13 s.

    Look and cameras are drawn from the seed; from `blank_from` s on nothing has a texture. The cameras are noisy on
    purpose: without noise, corners are found where two walls differ by one grey level. There is no odometry, as in the
    reference drive: it would carry a filter on.
    """
    images: dict[str, Any] = {"rig": "qvga", "sensor": "images", "renderer": "tiny", "randomise": True}
    drive = record(seed=seed, frames=frames, route="loop", surroundings=surroundings, blank_from=blank_from, **images)
    return replace(drive, frames=tuple(replace(frame, odometry=None) for frame in drive.frames))


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong in a drive."""

    line: str  # what, in one line
    # How it changes the stream; None: not at all, beyond what is wrong with the drive itself.
    corruption: Corruption | None
    begins: float = _ONSET  # when, s; before that the drive is as it should be
    lasts: float = math.inf  # how long, s
    frames: int = 200  # of the drive
    # Why the measurements agree with each other all the same, where they do: no monitor of innovations can tell.
    hidden: str = ""
    driven: Callable[[int, int], Recording] = reference_drive  # (seed, frames) -> the drive; same seed, same bits

    def drive(self, seed: int) -> Recording:
        """The drive of a seed with this fault; same seed, same bits."""
        recording = self.driven(seed, self.frames)
        if self.corruption is None:
            return recording
        ends = self.begins + self.lasts
        before = tuple(frame for frame in recording.frames if frame.timestamp < self.begins)
        during = tuple(frame for frame in recording.frames if self.begins <= frame.timestamp < ends)
        after = tuple(frame for frame in recording.frames if frame.timestamp >= ends)
        wrong = self.corruption.applied_to(replace(recording, frames=during), np.random.default_rng([seed, 1]))
        return replace(wrong, frames=(*before, *wrong.frames, *after))


# Corruptions that no scenario file needs: streams that are illegal by contract, out of order, or of another place.


@dataclass(frozen=True)
class Reordered:
    """Frames that the next one overtakes, with this probability: they arrive with a time that has passed."""

    probability: float

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`."""
        late = rng.random(len(recording)) < self.probability
        order = np.argsort(np.arange(len(recording)) + 1.5 * late, kind="stable")
        return replace(recording, frames=tuple(recording.frames[k] for k in order))


@dataclass(frozen=True)
class BadNumbers(OfMeasurements):
    """Numbers that no camera measures, NaN and infinity among them, which are illegal by contract.

    `value` is written over each u, v or d with probability `share`, in frames that are drawn with probability `frames`.
    """

    value: float
    frames: float = 0.3
    share: float = 0.2

    def changed(self, seen: StereoObservation, camera: StereoCamera, rng: np.random.Generator) -> StereoObservation:
        """See `OfMeasurements`; the observations are as a camera driver hands them out: not checked."""
        hit = (rng.random(seen.uvd.shape) < self.share) & (rng.random() < self.frames)
        wrong = copy.copy(seen)
        object.__setattr__(wrong, "uvd", np.where(hit, self.value, wrong.uvd))  # its constructor would refuse it
        return wrong


@dataclass(frozen=True)
class NoDisparity(OfMeasurements):
    """Landmarks for which the two images do not agree: each with probability `share` has d <= 0, which is legal."""

    share: float

    def changed(self, seen: StereoObservation, camera: StereoCamera, rng: np.random.Generator) -> StereoObservation:
        """See `OfMeasurements`."""
        uvd = seen.uvd.copy()
        hit = rng.random(len(uvd)) < self.share
        uvd[hit, 2] = -rng.integers(0, 3, int(hit.sum()))
        return replace(seen, uvd=uvd)


@dataclass(frozen=True)
class Kidnapped:
    """From one frame to the next, in no time, the camera is where it would be so many `seconds` later."""

    seconds: float

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`; nothing is random."""
        there = recording.frames[0].timestamp + self.seconds
        after = [frame for frame in recording.frames if frame.timestamp >= there - 1e-9]
        moved = (replace(frame, timestamp=frame.timestamp - self.seconds, odometry=None) for frame in after)
        return replace(recording, frames=tuple(moved))


@dataclass(frozen=True)
class TimeSteps:
    """The same drive at steps of any length between `shortest` and `longest`, s, drawn evenly in their logarithm."""

    shortest: float
    longest: float

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
            seen = _measured(recording, landmarks, nearest.observation.ids, pose, rng)
            frames.append(Frame(float(time), seen, truth=pose))
        return replace(recording, frames=tuple(frames))


@dataclass(frozen=True)
class MovingTruck:
    """Something large fills the view and drives off, in the direction in which the camera looks at first.

    A `share` of the landmarks is on it, of those that come into view one after the other, evenly. It reaches its
    `speed`, m/s, at a constant `acceleration`, m/s^2.
    """

    share: float
    speed: float
    acceleration: float

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`: a landmark is on the truck from where it is first seen."""
        on_truck = self._on_truck(recording, known_world(recording), rng)
        begins, forward = recording.frames[0].timestamp, _true_pose(recording.frames[0]).R_wc[:, 2]

        def moved(time: float, boarded: FloatArray, index: IntArray) -> FloatArray:
            return np.asarray((self._driven(time - begins) - self._driven(boarded - begins))[:, None] * forward)

        return moved_on(recording, on_truck, moved)

    def _on_truck(self, recording: Recording, landmarks: LandmarkTruth, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Which landmarks (N,): in every view about that share, not none or all by chance."""
        ids = np.concatenate([frame.observation.ids for frame in recording.frames])
        seen, first = np.unique(ids, return_index=True)
        count = np.floor(self.share * np.arange(len(seen) + 1) + rng.random())
        on_truck = np.zeros(len(landmarks.ids), dtype=bool)
        on_truck[np.searchsorted(landmarks.ids, seen[np.argsort(first)])] = np.diff(count) > 0
        return on_truck

    def _driven(self, seconds: ArrayLike) -> FloatArray:
        """Metres after that time."""
        speeding = np.minimum(seconds, self.speed / self.acceleration)
        return np.asarray(0.5 * self.acceleration * speeding**2 + self.speed * (seconds - speeding))


def _true_pose(frame: Frame) -> Pose:
    assert frame.truth is not None
    return frame.truth


def _between(frames: tuple[Frame, ...], times: NDArray[np.float64], time: float) -> Pose:
    """The pose at `time`, straight and at an even turn from the frame before to the one after."""
    after = min(max(int(np.searchsorted(times, time)), 1), len(frames) - 1)
    first, last = _true_pose(frames[after - 1]), _true_pose(frames[after])
    share = (time - times[after - 1]) / (times[after] - times[after - 1])
    turn = (first.inverse() @ last).log()[3:]
    orientation = (first @ Pose.exp([0.0, 0.0, 0.0, *(share * turn)])).orientation
    return Pose((1.0 - share) * first.position + share * last.position, orientation)


def _measured(
    recording: Recording, landmarks: LandmarkTruth, ids: NDArray[np.int64], pose: Pose, rng: np.random.Generator
) -> StereoObservation:
    """Measurements of those landmarks by the recording's camera at a pose."""
    points_c = pose.to_camera(landmarks.positions[np.searchsorted(landmarks.ids, ids)])
    ids, points_c = ids[points_c[:, 2] > 0], points_c[points_c[:, 2] > 0]
    errors = rng.multivariate_normal(np.zeros(3), recording.noise.R, len(ids))
    uvd = recording.camera.project(points_c) + errors
    visible = recording.camera.in_view(uvd)
    return StereoObservation(ids[visible], uvd[visible])


_SCALE = "scales map and drive alike"
_AFFINE = "shears or squeezes map and drive alike, as long as the camera does not turn"
_TURN, _WHOLE = 400, 800


def _gone_blank(surroundings: str) -> Mapping[str, Any]:
    """Another drive, whose world loses its texture."""
    return {"corruption": None, "frames": 130, "driven": partial(rendered_drive, surroundings, blank_from=_ONSET)}


def _miscalibrated(*percent: float, turns: bool = False) -> Mapping[str, Any]:
    """Focal length, baseline and principal point told wrong by so many per cent, from the start."""
    about: dict[str, Any] = {"frames": _TURN, "hidden": _AFFINE} if turns else {"hidden": _SCALE}
    return {"corruption": WrongCalibration(*percent), "begins": 0.0, **about}


FAULTS: Mapping[str, Fault] = {
    NOMINAL: Fault("nothing is wrong", None, begins=0.0),
    "dropped-frames": Fault("30 % of the frames never arrive", DroppedFrames(0.3)),
    "duplicated-frames": Fault("30 % of the frames show the picture before", DuplicatedFrames(0.3)),
    "reordered-frames": Fault("30 % of the frames are overtaken by the next", Reordered(0.3)),
    "late-frames": Fault("pictures are 0.3 s old and taken for new ones", Latency(3)),
    "empty-frames": Fault("30 % of the frames show nothing", Blackouts(0.3, 0.05)),
    "dark-60s": Fault("nothing is measured for 60 s", Blackouts(1.0, 0.05), lasts=60.0, frames=_WHOLE),
    "sparse": Fault("3 % of the landmarks are found", MissedDetections(0.97)),
    "no-texture": Fault("a street loses its texture: images, corners of shapes only", **_gone_blank("street")),
    "blank-corridor": Fault("a corridor loses its texture: images, hardly a corner", **_gone_blank("corridor")),
    "outliers-10": Fault("10 % of the measurements are anywhere", Outliers(0.1)),
    "outliers-30": Fault("30 % of the measurements are anywhere", Outliers(0.3)),
    "outliers-50": Fault("50 % of the measurements are anywhere", Outliers(0.5)),
    "swapped-ids": Fault("20 % of the measurements start an exchange of ids", WrongIds(0.2)),
    "nan": Fault("30 % of the frames hold NaN", BadNumbers(math.nan)),
    "infinity": Fault("30 % of the frames hold infinity", BadNumbers(math.inf)),
    "huge": Fault("30 % of the frames hold 1e300 px", BadNumbers(1e300)),
    "no-disparity": Fault("half of the measurements have d <= 0", NoDisparity(0.5)),
    "focal-1": Fault("focal length told 1 % wrong", **_miscalibrated(1.0, turns=True)),
    "focal-5": Fault("focal length told 5 % wrong", **_miscalibrated(5.0, turns=True)),
    "baseline-1": Fault("baseline told 1 % wrong", **_miscalibrated(0.0, 1.0)),
    "baseline-5": Fault("baseline told 5 % wrong", **_miscalibrated(0.0, 5.0)),
    "centre-1": Fault("principal point told 1 % wrong", **_miscalibrated(0.0, 0.0, 1.0, turns=True)),
    "centre-5": Fault("principal point told 5 % wrong", **_miscalibrated(0.0, 0.0, 5.0, turns=True)),
    "noise-0.3": Fault("noise told 0.3 times what it is", MisscaledNoise(0.3), begins=0.0),
    "noise-3": Fault("noise told 3 times what it is", MisscaledNoise(3.0), begins=0.0),
    "steps-1ms": Fault("a frame every millisecond", TimeSteps(0.001, 0.001)),
    "steps-mixed": Fault("steps of 1 ms to 10 s", TimeSteps(0.001, 10.0), frames=_WHOLE),
    "steps-10s": Fault("a frame every 10 s", TimeSteps(10.0, 10.0), frames=_WHOLE),
    "truck-starts": Fault("90 % of the view is a truck that is off at 5 m/s at once", MovingTruck(0.9, 5.0, 1e3)),
    "truck-smooth": Fault(
        "all of the view is a truck that gathers 5 m/s at 1 m/s²",
        MovingTruck(1.0, 5.0, 1.0),
        hidden="the camera could move like this",
    ),
    "kidnapped": Fault("the camera is set down 5 s further on", Kidnapped(5.0)),
}
"""By name; the first is the drive as it should be."""


def find_fault(name: str) -> Fault:
    """The fault of that name; raises a `ValueError` that lists them."""
    if name not in FAULTS:
        raise ValueError(f"there is no fault {name!r}. Known: {', '.join(FAULTS)}")
    return FAULTS[name]
