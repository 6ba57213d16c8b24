"""Jitter of published true poses, from the poses themselves.

    python benchmarks/reference_jitter.py DATA                 # seconds

A body with mass moves smoothly over a few samples: what is left of three differences of its poses is their noise, and
of a car in part the road. White noise of variance s^2 leaves 20 s^2 (1, 3, 3, 1). Robust (MAD), for each axis of the
body. These are lower ends: a truth that was smoothed with an IMU shows no jitter, whatever its errors are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from harness import arguments, show
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import load_trajectory

FILES = (
    *(f"kitti_poses/{name}.txt" for name in ("00", "02", "04", "05", "06", "07", "08", "09")),
    "field/tumvi_gt/dataset-room1_512_16.csv",
    "field/trajectories/euroc_v102/V102_groundtruth.csv",
    "field/trajectories/openvins_mh04/MH_04_difficult.txt",
)


def jitter(poses: Trajectory) -> np.ndarray:
    """Standard deviations (6,) of the noise of each pose: x, y, z of the position, m, and of the rotation, rad."""
    R = Rotation.from_quat(poses.orientations)
    steps = np.hstack([R[:-1].inv().apply(np.diff(poses.positions, axis=0)), (R[:-1].inv() * R[1:]).as_rotvec()])
    left = np.diff(steps, n=2, axis=0)
    return np.asarray(1.4826 * np.median(np.abs(left - np.median(left, axis=0)), axis=0) / np.sqrt(20.0))


def main() -> None:
    """Run and print."""
    data = arguments(__doc__, "data", data=Path).data
    rows = []
    for file in FILES:
        if (data / file).is_file():
            poses = load_trajectory(data / file)
            rows.append((file, str(len(poses)), *(f"{1e3 * sigma:.2f}" for sigma in jitter(poses))))
    heads = ("", "poses", "x, mm", "y", "z", "about x, mrad", "y", "z")
    show("jitter of published poses", heads, rows)


if __name__ == "__main__":
    main()
