"""KITTI 00 with its inertial samples: all frames, and three seconds without images at five places.

python benchmarks/kitti00_inertial.py DATA/kitti00_stereo_tracks      # a minute
"""

from __future__ import annotations

import numpy as np

from filters import StereoObservation
from harness import arguments, show
from stereo_slam_env import evaluate, load
from stereo_slam_env.recording.recording import Recording

OPEN = {"name": "strapdown", "sigma_mounting": 0.02}
FILTERS = {
    "right-invariant": ("right-invariant", {}),
    "inertial": ("inertial", {}),
    "inertial, errors taken for white": ("inertial", {"drift": None, "gauge_walk": 0.0, "measurement": "joint"}),
    "inertial, open mounting": ("inertial", {"motion": OPEN}),
    "msckf, open mounting": ("msckf", {"motion": OPEN}),
    "coloured-noise": ("coloured-noise", {}),
}
FROM, SECONDS = (None, 30, 50, 60, 70, 80), 3.0
NOTHING = StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))


def dark(recording: Recording, first: int | None) -> Recording:
    """The recording with no measurements for `SECONDS` from a frame on."""
    if first is None:
        return recording
    begin = recording.frames[first].timestamp
    return recording.with_observations(
        NOTHING if begin <= frame.timestamp < begin + SECONDS else frame.observation for frame in recording.frames
    )


def main() -> None:
    """Rows of filters, columns of gaps: ATE, m, rotation, mrad, NEES/6."""
    recording = load(arguments(__doc__, "folder", folder=str).folder, inertial=True)
    rows = []
    for label, (name, options) in FILTERS.items():
        cells = []
        for first in FROM:
            figures = evaluate(name, dark(recording, first), **options).figures
            mrad = 1000.0 * np.deg2rad(figures.rotation_rmse_deg)
            cells.append(f"{figures.ate_rigid_m:.3f} ({mrad:.0f}) {figures.pose_anees / 6.0:.1f}")
        rows.append([label, *cells])
    show(
        "ATE, m (rotation, mrad) NEES/6",
        ["filter", *("all" if first is None else f"from {first}" for first in FROM)],
        rows,
    )


if __name__ == "__main__":
    main()
