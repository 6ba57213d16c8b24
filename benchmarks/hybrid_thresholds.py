"""When may a landmark change from inverse depth to XYZ? Consistency, error and size against the threshold.

    python benchmarks/hybrid_thresholds.py --seeds 50      # 800 frames, 350 m, pixel noise: half an hour on two cores

The default of `Hybrid` is the largest linearity index with which the pose stays in its 95 % band in at least 90 % of
the frames.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from filters import StereoEKF
from filters.checks.consistency import nees
from filters.landmarks.inverse_depth import Hybrid
from harness import arguments, by_seed, show
from stereo_slam_env.benchmark.recordings.reference_problem import long_drive
from stereo_slam_env.evaluation.bands import mean_band, share_inside
from stereo_slam_env.recording.recording import Recording

LIMITS = (0.02, 0.03, 0.05, 0.1)


class OwnAnchors(Hybrid):
    """Every landmark that is not XYZ has an anchor of its own."""

    shares_anchors: ClassVar[bool] = False


CASES: dict[str, dict[str, Any]] = {
    "inverse depth": {"landmark": "shared-anchor"},
    **{f"index < {limit:g}": {"landmark": Hybrid(limit)} for limit in LIMITS},
    "index < 0.03, an anchor each": {"landmark": OwnAnchors(0.03)},
}


def run(recording: Recording, options: dict[str, Any]) -> tuple[np.ndarray, float, float]:
    """Pose NEES of each frame, end error in % of the way, and the mean number of states."""
    slam = StereoEKF(recording.camera, recording.noise, gate=None, **options)
    begin = recording.start
    slam.reset(begin)
    values, sizes, positions = [], [], []
    for number, frame in enumerate(recording.frames):
        if number:
            slam.predict(frame.timestamp - recording.frames[number - 1].timestamp)
        slam.update(frame.observation)
        error, covariance = slam.pose_error(frame.truth.position, frame.truth.orientation)
        values.append(nees(error, covariance))
        sizes.append(slam.state_size)
        positions.append(frame.truth.position)
    length = np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()
    return np.array(values[1:]), 100.0 * np.linalg.norm(error[:3]) / length, float(np.mean(sizes))


def run_seed(seed: int, frames: int, cases: list[str]) -> list[tuple[np.ndarray, float, float]]:
    """Some cases on one recording."""
    recording = long_drive(seed, "pixels", frames=frames)
    return [run(recording, CASES[case]) for case in cases]


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, seeds=50, frames=800, jobs=2, only=list(CASES))
    runs = by_seed(run_seed, given.seeds, given.jobs, given.frames, given.only)
    band = mean_band(6, given.seeds)
    rows = []
    for number, label in enumerate(given.only):
        values, drift, size = (list(part) for part in zip(*(of[number] for of in runs), strict=True))
        by_frame = np.mean(values, axis=0)
        inside = 100 * share_inside(by_frame, band)
        means = (f"{inside:.0f} %", f"{np.mean(drift):.4f}", f"{np.mean(size):.0f}")
        rows.append((label, f"{by_frame.mean() / 6:.3f}", *means))
    title = f"long drive, {given.seeds} seeds; ANEES/6 band [{band[0] / 6:.2f}, {band[1] / 6:.2f}]"
    show(title, ("landmarks", "ANEES/6", "in band", "drift %", "states"), rows)


if __name__ == "__main__":
    main()
