"""Stereo feature tracks with noisy velocities, as those over the whole of KITTI odometry 07 are stored.

Layout: `tracks.npz` (features, time_stamps, linear_velocity, rotational_velocity, K, b, cam_T_imu) and
`poses.txt` (T_world_cam of the left camera).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from filters import Pose, StereoCamera, StereoNoise
from stereo_slam_env.datasets.registry import known_by, reference_for
from stereo_slam_env.datasets.tracks import (
    ASSUMED_SIGMA_PX,
    camera_velocities,
    frames_of,
    stated_or_assumed,
    without_repeats,
)
from stereo_slam_env.files.readers import Shape, read_archive, read_poses
from stereo_slam_env.recording.recording import Recording

NAME = "kitti07_tracks"
FILES = (("tracks.npz", "poses.txt"),)
SHAPES: Mapping[str, Shape] = {
    "time_stamps": "k",
    "features": (4, "n", "k"),
    "linear_velocity": (3, "k"),
    "rotational_velocity": (3, "k"),
    "K": (3, 3),
    "b": 1,
    "cam_T_imu": (4, 4),
}
STATED = "poses.txt of the recording."
FACTS = {"image_size": (1226, 370), "sigma_px": ASSUMED_SIGMA_PX, "sigma_linear": 0.5, "sigma_angular": 0.05}
"""Of the public recording: rectified images of the drives of 2011_09_30; the archive does not hold any of it."""


def read(
    path: Path,
    *,
    sigma_px: float | None = None,
    sigma_linear: float | None = None,
    sigma_angular: float | None = None,
    image_size: tuple[int, int] | None = None,
    max_per_frame: int | None = None,
) -> Recording:
    """Read the folder.

    Parameters
    ----------
    path : Path
        Folder with the files named in `FILES`.
    sigma_px : float, optional
        Standard deviation of a pixel coordinate to assume, px. None: `ASSUMED`, of a stranger's with a line in the log.
    sigma_linear, sigma_angular : float, optional
        White noise of the velocities in the IMU frame, m/s and rad/s per axis. None: likewise.
    image_size : (int, int), optional
        Width and height of the images, px. None: of the public recording; of a stranger's the smallest that hold all
        measurements, with a line in the log.
    max_per_frame : int, optional
        Thin the tracks to so many landmarks at a time, long tracks first; None keeps all (25 to 120 a frame).

    Returns
    -------
    Recording
        W is the left camera at frame 0. Frames after the last pose have no truth. Measurements that repeat the frame
        before are left out and counted, and their tracks go on as new landmarks: see `without_repeats`.

    Raises
    ------
    ValueError
        A file is damaged, has the wrong shape, or holds NaN: the message names it.
    """
    arrays = read_archive(path / "tracks.npz", SHAPES)
    timestamps = arrays["time_stamps"]
    count = len(timestamps)
    positions, orientations = read_poses(path / "poses.txt")
    truth = [Pose(r, q) for r, q in zip(positions[:count], orientations[:count], strict=True)]
    K, T = arrays["K"], arrays["cam_T_imu"]
    fx, fy, cx, cy, baseline = (float(x) for x in (K[0, 0], K[1, 1], K[0, 2], K[1, 2], arrays["b"][0]))
    tracks, repeats = without_repeats(arrays["features"].transpose(0, 2, 1))
    known = known_by(positions)
    sigmas, size = stated_or_assumed(
        path,
        tracks,
        FACTS if known else None,
        sigma_px=sigma_px,
        sigma_linear=sigma_linear,
        sigma_angular=sigma_angular,
        image_size=image_size,
    )
    odometry = camera_velocities(
        arrays["linear_velocity"].T,
        arrays["rotational_velocity"].T,
        T[:3, :3],
        T[:3, 3],  # of this data set the camera position in the IMU frame, not a translation cam <- imu
        sigma_linear=sigmas["sigma_linear"],
        sigma_angular=sigmas["sigma_angular"],
    )
    usable = tracks.with_positive_disparity()
    source = {
        "reader": NAME,
        "path": str(path),
        "sigma_px": float(sigmas["sigma_px"]),
        "sigma_linear_m_s": float(sigmas["sigma_linear"]),
        "sigma_angular_rad_s": float(sigmas["sigma_angular"]),
        "max_per_frame": max_per_frame,
        "dropped_repeats": repeats,
        "dropped_non_positive_disparity": len(tracks) - len(usable),
        "frames_without_truth": count - len(truth),
    }
    unknown = [None] * (count - len(truth))
    return Recording(
        NAME if known else path.resolve().name,
        StereoCamera(fx, fy, cx, cy, baseline, *size),
        frames_of(usable.thinned(max_per_frame), timestamps, [*truth, *unknown], odometry),
        StereoNoise.independent_pixels(sigmas["sigma_px"]),
        source=source,
        truth_from=reference_for(positions, STATED),
    )
