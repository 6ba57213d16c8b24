"""Stereo tracks of KITTI that come inside the `gtsam` wheel, so that anybody can replay a real drive.

Asked for by name instead of a folder: `gtsam` or `gtsam:kitti00` (135 frames, 110 m, one 90 degree turn).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from filters.extras import install_command
from filters.known_names import require_known
from stereo_slam_env.datasets.kitti00_stereo_tracks import (
    IMAGE_SIZE,
    odometry_truth,
    read_odometry_poses,
    tracks_recording,
)
from stereo_slam_env.datasets.tracks import ASSUMED_SIGMA_PX
from stereo_slam_env.recording.recording import Recording, Reference

PREFIX = "gtsam"
REFERENCE = Reference(
    "odometry from the same images", "The stereo odometry that comes with the tracks and was fitted to the same pixels."
)
FRAME_INTERVAL = 0.1037  # s, of KITTI odometry 00; the wheel holds no times


@dataclass(frozen=True)
class Example:
    """File names inside the wheel."""

    stereo_factors: str
    calibration: str
    poses: str
    image_size: tuple[int, int]


EXAMPLES = {
    "kitti00": Example("VO_stereo_factors00.txt", "VO_calibration00.txt", "VO_camera_poses00.txt", IMAGE_SIZE),
}


def read(name: str = "kitti00", *, sigma_px: float = ASSUMED_SIGMA_PX, max_per_frame: int | None = 100) -> Recording:
    """Read one of the examples.

    Parameters
    ----------
    name : str
        A key of `EXAMPLES`.
    sigma_px, max_per_frame
        As for `kitti00_stereo_tracks.read`.

    Returns
    -------
    Recording
        The wheel has no ground truth: the reference is the stereo odometry that comes with the tracks, which was
        fitted to the same pixels. It shows gross errors, not which filter is better by centimetres.

    Raises
    ------
    ValueError
        No such example.
    ImportError
        gtsam is not installed.
    """
    require_known("there is no example", [f"{PREFIX}:{name}"], [f"{PREFIX}:{known}" for known in EXAMPLES])
    example = EXAMPLES[name]
    frame_ids, poses = read_odometry_poses(_find(example.poses))
    return tracks_recording(
        f"{PREFIX}_{name}",
        stereo_factors=_find(example.stereo_factors),
        calibration=_find(example.calibration),
        frame_ids=frame_ids,
        timestamps=FRAME_INTERVAL * frame_ids.astype(np.float64),
        truth=odometry_truth(poses),
        image_size=example.image_size,
        sigma_px=sigma_px,
        max_per_frame=max_per_frame,
        source={"reader": f"{PREFIX}:{name}", "frame_interval_s": FRAME_INTERVAL},
        truth_from=REFERENCE,
    )


def _find(file_name: str) -> Path:
    try:
        import gtsam
    except ImportError as error:
        raise ImportError(f"gtsam is not installed: {install_command('gtsam')}") from error
    try:
        return Path(str(gtsam.findExampleDataFile(file_name)))  # type: ignore[no-untyped-call,unused-ignore]
    except (FileNotFoundError, RuntimeError) as error:
        raise ValueError(f"the installed gtsam has no example file {file_name}: install gtsam 4.3 or newer") from error
