"""The faults, by name: what goes wrong, when, and for how long.

To add one: a line in `FAULTS`, and where it is something new a `Corruption` (`streams.py`) or, for what only images
show, another drive (`rendered.py`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from filters.known_names import require_known
from stereo_slam_env.benchmark.recordings.reference_problem import long_drive
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.sensing import corruptions
from stereo_slam_env.sensing.corrupted_measurements import (
    MisscaledNoise,
    MissedDetections,
    Outliers,
    WrongCalibration,
    WrongIds,
)
from stereo_slam_env.sensing.corruptions import Blackouts, DroppedFrames, DuplicatedFrames, Latency
from stereo_slam_env.studies.faults import streams
from stereo_slam_env.studies.faults.rendered import drawn_drive

NOMINAL = "nominal"
LANDMARKS = 30
_ONSET = 8.0


def reference_drive(seed: int, frames: int) -> Recording:
    """The reference drive of a seed: pure geometry, 30 landmarks."""
    return long_drive(seed, frames=frames, landmarks=LANDMARKS)


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong in a drive.

    Attributes
    ----------
    line : str
        What, in one line.
    corruption : Corruption, optional
        How it changes the stream; None: not at all, beyond what is wrong with the drive itself.
    begins : float
        When, s; before that the drive is as it should be.
    lasts : float
        How long, s.
    frames : int
        Of the drive.
    hidden : str
        Why the measurements agree with each other all the same, where they do: no monitor of innovations can tell.
    driven : callable
        (seed, frames) -> the drive; same seed, same bits.
    """

    line: str
    corruption: corruptions.Corruption | None
    begins: float = _ONSET
    lasts: float = math.inf
    frames: int = 200
    hidden: str = ""
    driven: Callable[[int, int], Recording] = reference_drive

    def drive(self, seed: int) -> Recording:
        """The drive of a seed with this gone wrong; same seed, same bits."""
        recording = self.driven(seed, self.frames)
        if self.corruption is None:
            return recording
        ends = self.begins + self.lasts
        before = tuple(frame for frame in recording.frames if frame.timestamp < self.begins)
        during = tuple(frame for frame in recording.frames if self.begins <= frame.timestamp < ends)
        after = tuple(frame for frame in recording.frames if frame.timestamp >= ends)
        part = dataclasses.replace(recording, frames=during)
        wrong = self.corruption.applied_to(part, np.random.default_rng([seed, 1]))
        return dataclasses.replace(wrong, frames=(*before, *wrong.frames, *after))


_SCALE = "scales map and drive alike"
_AFFINE = "shears or squeezes map and drive alike, as long as the camera does not turn"
_TURN, _WHOLE, _DRAWN = 400, 800, 130


def _gone_blank(surroundings: str) -> Callable[[int, int], Recording]:
    return partial(drawn_drive, surroundings, blank_from=_ONSET)


FAULTS: Mapping[str, Fault] = {
    NOMINAL: Fault("nothing is wrong", None, begins=0.0),
    "dropped-frames": Fault("30 % of the frames never arrive", DroppedFrames(0.3)),
    "duplicated-frames": Fault("30 % of the frames show the picture before", DuplicatedFrames(0.3)),
    "reordered-frames": Fault("30 % of the frames are overtaken by the next", streams.Reordered(0.3)),
    "late-frames": Fault("pictures are 0.3 s old and taken for new ones", Latency(3)),
    "empty-frames": Fault("30 % of the frames show nothing", Blackouts(0.3, 0.05)),
    "dark-60s": Fault("nothing is measured for 60 s", Blackouts(1.0, 0.05), lasts=60.0, frames=_WHOLE),
    "sparse": Fault("3 % of the landmarks are found", MissedDetections(0.97)),
    "no-texture": Fault(
        "a street loses its texture: images, corners of shapes only", None, frames=_DRAWN, driven=_gone_blank("street")
    ),
    "blank-corridor": Fault(
        "a corridor loses its texture: images, hardly a corner", None, frames=_DRAWN, driven=_gone_blank("corridor")
    ),
    "outliers-10": Fault("10 % of the measurements are anywhere", Outliers(0.1)),
    "outliers-30": Fault("30 % of the measurements are anywhere", Outliers(0.3)),
    "outliers-50": Fault("50 % of the measurements are anywhere", Outliers(0.5)),
    "swapped-ids": Fault("20 % of the measurements start an exchange of ids", WrongIds(0.2)),
    "nan": Fault("30 % of the frames hold NaN", streams.BadNumbers(math.nan)),
    "infinity": Fault("30 % of the frames hold infinity", streams.BadNumbers(math.inf)),
    "huge": Fault("30 % of the frames hold 1e300 px", streams.BadNumbers(1e300)),
    "no-disparity": Fault("half of the measurements have d <= 0", streams.NoDisparity(0.5)),
    "focal-1": Fault("focal length told 1 % wrong", WrongCalibration(1.0), 0.0, frames=_TURN, hidden=_AFFINE),
    "focal-5": Fault("focal length told 5 % wrong", WrongCalibration(5.0), 0.0, frames=_TURN, hidden=_AFFINE),
    "baseline-1": Fault("baseline told 1 % wrong", WrongCalibration(0.0, 1.0), 0.0, hidden=_SCALE),
    "baseline-5": Fault("baseline told 5 % wrong", WrongCalibration(0.0, 5.0), 0.0, hidden=_SCALE),
    "centre-1": Fault(
        "principal point told 1 % wrong", WrongCalibration(0.0, 0.0, 1.0), 0.0, frames=_TURN, hidden=_AFFINE
    ),
    "centre-5": Fault(
        "principal point told 5 % wrong", WrongCalibration(0.0, 0.0, 5.0), 0.0, frames=_TURN, hidden=_AFFINE
    ),
    "noise-0.3": Fault("noise told 0.3 times what it is", MisscaledNoise(0.3), begins=0.0),
    "noise-3": Fault("noise told 3 times what it is", MisscaledNoise(3.0), begins=0.0),
    "steps-1ms": Fault("a frame every millisecond", streams.TimeSteps(0.001, 0.001)),
    "steps-mixed": Fault("steps of 1 ms to 10 s", streams.TimeSteps(0.001, 10.0), frames=_WHOLE),
    "steps-10s": Fault("a frame every 10 s", streams.TimeSteps(10.0, 10.0), frames=_WHOLE),
    "truck-starts": Fault(
        "90 % of the view is a truck that is off at 5 m/s at once", streams.MovingTruck(0.9, 5.0, 1e3)
    ),
    "truck-smooth": Fault(
        "all of the view is a truck that gathers 5 m/s at 1 m/s²",
        streams.MovingTruck(1.0, 5.0, 1.0),
        hidden="the camera could move like this",
    ),
    "kidnapped": Fault("the camera is set down 5 s further on", streams.Kidnapped(5.0)),
}
"""By name; the first is the drive as it should be."""


def find_fault(name: str) -> Fault:
    """The fault of that name; raises a `ValueError` that lists them."""
    require_known("there is no fault", [name], FAULTS)
    return FAULTS[name]
