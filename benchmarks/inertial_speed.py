"""Cost of `inertial` and `msckf` over that of `right-invariant`, on the same smooth drive.

    python benchmarks/inertial_speed.py      # half a minute

Processor time of a whole drive of 60 frames, in turns in one process; 20 samples a frame, tracks that end by chance.
The smallest of the rounds counts: each drive is the same work.
"""

from __future__ import annotations

from collections.abc import Callable

from threadpoolctl import threadpool_limits

from filters import StereoEKF, make_filter
from harness import arguments, in_turns, show
from stereo_slam_env import Recording
from stereo_slam_env.benchmark.recordings.inertial_problem import inertial_drive

STRAPDOWN = {"motion": "strapdown"}
FILTERS = {
    "right-invariant": ("right-invariant", {}),
    "inertial": ("inertial", {}),
    "msckf": ("msckf", {}),
    "msckf, no map": ("msckf", {"map_landmarks": 0}),
    "msckf, inertial": ("msckf", STRAPDOWN),
    "msckf, inertial, no map": ("msckf", {"map_landmarks": 0, **STRAPDOWN}),
}


def drive(slam: StereoEKF, recording: Recording, samples: bool) -> None:
    """All frames through a filter."""
    slam.reset(recording.start)
    for k, frame in enumerate(recording.frames):
        if k:
            slam.predict(0.1, inertial=frame.inertial if samples else None)
        slam.update(frame.observation)


def calls(landmarks: int) -> dict[str, Callable[[], None]]:
    """A drive by each filter."""
    recording, made = inertial_drive(0, frames=60, landmarks=landmarks), {}
    for label, (name, options) in FILTERS.items():
        slam = make_filter(name, camera=recording.camera, noise=recording.noise, gate=None, **options)
        made[label] = lambda slam=slam, samples="inertial" in label: drive(slam, recording, samples)
    return made


def main() -> None:
    """Rows of filters: ms a frame, and over `right-invariant`."""
    given, rows = arguments(__doc__, landmarks=[40, 100], rounds=8), {label: [label] for label in FILTERS}
    with threadpool_limits(1):
        for landmarks in given.landmarks:
            times = {label: min(each) / 60 for label, each in in_turns(calls(landmarks), given.rounds).items()}
            for label, time in times.items():
                rows[label].append(f"{1e3 * time:.3f} ms, {time / times['right-invariant']:.2f}")
    show("a frame, and over right-invariant", ["filter", *(f"{n} tracks" for n in given.landmarks)], rows.values())


if __name__ == "__main__":
    main()
