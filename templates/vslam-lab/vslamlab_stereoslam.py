"""One run for VSLAM-LAB: a filter on the pairs of an experiment, its trajectory as NNNNN_KeyFrameTrajectory.csv."""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import stereo_slam_env as sse
from filters import Pose
from stereo_slam_env.datasets import open_for_front_end
from stereo_slam_env.frontend import record_tracks, set_up_for_tracks

HEADER = ("ts (ns)", "tx (m)", "ty (m)", "tz (m)", "qx", "qy", "qz", "qw")


def main(arguments: list[str] | None = None) -> None:
    """Track the pairs, run the filter, and write the poses of the left camera as it is mounted."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("sequence_path", "calibration_yaml", "rgb_csv", "exp_folder"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--exp_it", required=True)
    parser.add_argument("--filter", default="coloured-noise")
    given, _ = parser.parse_known_args(arguments)
    files = {"rgb_csv": str(given.rgb_csv), "calibration": str(given.calibration_yaml)}
    sequence, settings = open_for_front_end(given.sequence_path, use_truth=False, **files)
    recording = set_up_for_tracks(record_tracks(sequence, settings))
    epoch = round(1e9 * sequence.source["epoch_s"])
    turn = Pose(np.zeros(3), Rotation.from_matrix(sequence.R_left).as_quat())
    with (given.exp_folder / f"{given.exp_it.zfill(5)}_KeyFrameTrajectory.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for moment in sse.run(given.filter, recording):
            pose = Pose(moment.slam.pose.position, moment.slam.pose.orientation) @ turn
            writer.writerow([epoch + round(1e9 * moment.time), *pose.position.tolist(), *pose.orientation.tolist()])


if __name__ == "__main__":
    main()
