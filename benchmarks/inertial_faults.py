"""Faults, fog and darkness with and without an inertial unit, paired on the same smooth drives.

    python benchmarks/inertial_faults.py      # 20 drives, five minutes

12 s, 25 tracks, an ADIS16448, a gate of 0.99. What is wrong is the same for all filters of a drive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from harness import arguments, show
from stereo_slam_env import Recording, evaluate
from stereo_slam_env.benchmark.recordings.inertial_problem import inertial_drive
from stereo_slam_env.sensing.corrupted_measurements import BiasedDisparity, MissedDetections, Outliers
from stereo_slam_env.sensing.corruptions import Blackouts, Corruption, DroppedFrames, DuplicatedFrames, Latency

FRAMES, LANDMARKS, DRAWS = 120, 25, 10_000
FILTERS = {
    "images": ("right-invariant", False),
    "wheels": ("right-invariant", True),
    "samples": ("inertial", False),
    "both": ("inertial", True),
}


@dataclass(frozen=True)
class Fog:
    """Nothing is measured beyond `visibility`, m."""

    visibility: float

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`; nothing is random."""
        least = recording.camera.disparity_constant / self.visibility
        return recording.with_observations(
            frame.observation.select(frame.observation.uvd[:, 2] > least) for frame in recording.frames
        )


@dataclass(frozen=True)
class Dark:
    """Nothing is measured from 5 s on for so many seconds."""

    seconds: float

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """See `Corruption`; nothing is random."""
        return recording.with_observations(
            frame.observation.select(np.full(len(frame.observation), not 5.0 <= frame.timestamp < 5.0 + self.seconds))
            for frame in recording.frames
        )


JOINT = "the same, joint test"
"""The fault whose filters have `consensus=True`."""
FAULTS: dict[str, Corruption | None] = {
    "none": None,
    "fog, 12 m": Fog(12.0),
    "dark for 1 s": Dark(1.0),
    "dark for 3 s": Dark(3.0),
    "dark for 0.3 s, again and again": Blackouts(0.05, 0.3),
    "a third of the frames dropped": DroppedFrames(0.33),
    "a tenth of the frames shown twice": DuplicatedFrames(0.1),
    "half of the detections missed": MissedDetections(0.5),
    "a fifth of the pixels random": Outliers(0.2),
    JOINT: Outliers(0.2),
    "images one frame late": Latency(1),
    "disparities 0.5 px too large": BiasedDisparity(0.5),
}


def main() -> None:
    """Rows of faults: RMS position error over all drives, m, median NEES/6; samples over images with 95 %."""
    given, rows = arguments(__doc__, seeds=20, faults=list(FAULTS)), []
    drives = [inertial_drive(seed, frames=FRAMES, landmarks=LANDMARKS) for seed in range(given.seeds)]
    drawn = np.random.default_rng(0).integers(0, given.seeds, (DRAWS, given.seeds))
    for label in given.faults:
        fault, squares, cells = FAULTS[label], {}, []
        faulty = [d if fault is None else fault.applied_to(d, np.random.default_rng(s)) for s, d in enumerate(drives)]
        for what, (name, wheels) in FILTERS.items():
            options: dict[str, Any] = {"gate": 0.99, "consensus": label == JOINT, "use_odometry": wheels}
            runs = [evaluate(name, drive, **options).figures for drive in faulty]
            squares[what] = np.array([run.position_rmse_m for run in runs]) ** 2
            nees = np.median([run.pose_anees / 6.0 for run in runs])
            cells.append(f"{np.sqrt(squares[what].mean()):.3f}, {nees:.2g}")
        ratio = np.sqrt(squares["samples"][drawn].mean(axis=1) / squares["images"][drawn].mean(axis=1))
        low, middle, high = np.quantile(ratio, [0.025, 0.5, 0.975])
        rows.append([label, *cells, f"{middle:.2f} ({low:.2f} to {high:.2f})"])
    show(
        f"{given.seeds} drives of {FRAMES / 10:.0f} s: position error, m, NEES/6",
        ["fault", *FILTERS, "samples over images"],
        rows,
    )


if __name__ == "__main__":
    main()
