"""Direction of travel by the motions between two frames, against that of the reference, without any filter.

    python benchmarks/calibration_by_steps.py DATA                               # a minute
    python benchmarks/calibration_by_steps.py DATA --recordings kitti06_stereo51

DATA is the folder that holds the recordings of `benchmarks/real_covariances.py`. The direction is that by the tracks
minus that by the reference, in the frame of the left camera: the median over the steps of more than 0.3 m, its standard
error, and the medians of the thirds of the drive. What stays the same there is how the camera is turned in
the body of the reference, or its principal point; no estimate from images can mend it.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

import stereo_slam_env as sse
from changed_recordings import RECORDINGS
from filters.geometry.arrays import FloatArray
from harness import arguments, show
from stereo_slam_env.frontend.camera_motion import camera_steps
from stereo_slam_env.recording.recording import Recording

LEAST_STEP = 0.3
"""Step forward, m, that shows a direction."""


def directions(drive: Recording) -> FloatArray:
    """(K, 2): direction of travel by the tracks minus that by the reference, sideways and down, mrad."""
    rows = []
    for (before, now), found in zip(pairwise(drive.frames), camera_steps(drive.camera, drive.frames), strict=True):
        if found is None or before.truth is None or now.truth is None:
            continue
        true, seen = (before.truth.inverse() @ now.truth).position, found.step.t
        if min(true[2], seen[2]) > LEAST_STEP:
            rows.append(1e3 * (seen[:2] / seen[2] - true[:2] / true[2]))
    return np.array(rows).reshape(-1, 2)


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, "data", data=Path, recordings=list(RECORDINGS))
    rows = []
    for name in given.recordings:
        drive = sse.load(given.data / name)[: RECORDINGS[name]]
        off = directions(drive)
        cells = ["–", "–"]
        if len(off):
            middle, thirds = np.median(off, axis=0), [np.median(part, axis=0) for part in np.array_split(off, 3)]
            errors = 1.25 * 1.48 * np.median(np.abs(off - middle), axis=0) / np.sqrt(len(off))
            cells = [
                f"{middle[i]:.1f} ± {errors[i]:.1f} ({', '.join(f'{third[i]:.1f}' for third in thirds)})"
                for i in (0, 1)
            ]
        rows.append((name, *cells))
    heads = ("", "sideways, mrad (thirds)", "down, mrad (thirds)")
    show("by the motions between two frames", heads, rows)


if __name__ == "__main__":
    main()
