"""Tracks of one camera with an inertial unit: `tracks.csv`, `imu.csv` and `recording.toml`.

`tracks.csv` has a line of names, then t, id, u, v: times of the images, s, and undistorted pixels. `imu.csv` has a line
of names, then t, wx, wy, wz, ax, ay, az: rad/s and m/s^2, on the same clock. `recording.toml`:

    camera = { fx = 458.0, fy = 457.0, cx = 367.0, cy = 248.0, width = 752, height = 480 }
    sigma_px = 1.0            # of a pixel coordinate
    truth = "truth.tum"       # optional: a trajectory of the camera, on the same clock
    reference = "surveyed"    # optional: what the truth is
    [unit]
    position = [0.0, 0.0, 0.0]             # of the accelerometers in the camera frame, m
    orientation = [0.0, 0.0, 0.0, 1.0]     # xyzw, takes vectors of the unit to the camera frame
    gyro_density = 1.7e-4                  # white noise per root of a hertz, and walks per root of a second
    accelerometer_density = 2e-3
    gyro_walk = 1.9e-5
    accelerometer_walk = 3e-3

No disparity is measured and none is made up: filters need measurement="left" and the samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from filters import InertialUnit, Pose, StereoCamera, StereoNoise, StereoObservation
from filters.contract.validation import first_line, positive, require_known
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.layouts import reference_for
from stereo_slam_env.datasets.restated import pose_at
from stereo_slam_env.files.opening import require_inside
from stereo_slam_env.files.readers import parse_toml, read_table, read_text
from stereo_slam_env.recording.filter_setup import FilterSetup
from stereo_slam_env.recording.inertial import samples_of_steps
from stereo_slam_env.recording.recording import NO_REFERENCE, Frame, Recording, Reference
from stereo_slam_env.recording.trajectory_files import load_trajectory
from stereo_slam_env.recording.trajectory_layouts import require_rate

NAME = "mono_tracks"
TRACKS, SAMPLES, ABOUT = "tracks.csv", "imu.csv", "recording.toml"
FILES = ((TRACKS, SAMPLES, ABOUT),)
_KEYS = ("camera", "sigma_px", "truth", "reference", "unit")
_CAMERA = ("fx", "fy", "cx", "cy", "width", "height")
_UNIT = ("position", "orientation", "gyro_density", "accelerometer_density", "gyro_walk", "accelerometer_walk")
_BASELINE = 1.0
"""m, of the camera that is not there: nothing depends on it."""


def read(path: Path, *, use_truth: bool = True) -> Recording:
    """Read the folder.

    Parameters
    ----------
    path : Path
        Folder with the files named in `FILES`.
    use_truth : bool
        Whether to read the trajectory that the file names, if it does, and to leave out the frames before it.

    Returns
    -------
    Recording
        W is the camera at the first frame. The measurements have no disparity.

    Raises
    ------
    ValueError
        A file is damaged, an entry is missing, or the samples do not cover the frames: the message names it.
    """
    path = path.resolve()
    about = _table(path / ABOUT)
    camera, sigma = about["camera"], positive("sigma_px", about.get("sigma_px"))
    try:
        rig, unit = StereoCamera(**camera, baseline=_BASELINE), InertialUnit(**about["unit"])
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path / ABOUT}: {first_line(error)}: correct it") from error
    table, rows = (read_table(path / file, n, delimiter=",", header_lines=1) for file, n in ((TRACKS, 4), (SAMPLES, 7)))
    if not (np.abs(table[:, 1]) < 2.0**53).all() or (table[:, 1] % 1.0 != 0.0).any():
        raise ValueError(f"{path / TRACKS} has ids that are no whole numbers: write t, id, u, v")
    times, at = np.unique(table[:, 0], return_inverse=True)
    require_rate(times, str(path / TRACKS))
    steps = samples_of_steps(path / SAMPLES, rows[:, 0] - times[0], rows[:, 1:], times - times[0], unit)
    truth, reference = _truth(path, about, times) if use_truth else ([None] * len(times), NO_REFERENCE)
    begin = next((k for k, pose in enumerate(truth) if pose is not None), 0)
    bare = next((k for k in range(begin + 1, len(steps)) if steps[k] is None), None)
    if bare is not None:
        raise ValueError(f"{path / SAMPLES} does not cover the step to the frame at {times[bare]:.9g} s: cut {TRACKS}")
    frames, origin = [], truth[begin]
    for k in range(begin, len(times)):
        rows_of_frame, pose = table[at == k], truth[k]
        pixels = StereoObservation.of_left(
            rows_of_frame[:, 1].astype(np.int64), rows_of_frame[:, 2:], sigma**2 * np.eye(2)
        )
        relative = None if origin is None or pose is None else origin.inverse() @ pose
        frames.append(Frame(times[k] - times[begin], pixels, None, relative, inertial=steps[k] if k > begin else None))
    source = {"reader": NAME, "path": str(path), "sigma_px": sigma, "epoch_s": float(times[begin])}
    noise, setup = StereoNoise.independent_pixels(sigma), FilterSetup()
    return Recording(path.name, rig, tuple(frames), noise, source=source, truth_from=reference, stated_setup=setup)


def _table(path: Path) -> Mapping[str, Any]:
    """Entries of `recording.toml`, all of those that must be there."""
    try:
        about = parse_toml(read_text(path))
    except ValueError as error:
        raise ValueError(f"{path} is no TOML ({first_line(error)}): correct it") from error
    require_known(f"{path} has no entry", about, _KEYS)
    for name, keys in (("camera", _CAMERA), ("unit", _UNIT)):
        entries = about.get(name)
        if not isinstance(entries, Mapping) or set(entries) != set(keys):
            raise ValueError(f"{path}: {name} must be a table of {', '.join(keys)}, got {entries!r}")
    if not isinstance(about.get("sigma_px"), int | float):
        raise ValueError(f"{path}: sigma_px must be the deviation of a pixel, px, got {about.get('sigma_px')!r}")
    return about


def _truth(path: Path, about: Mapping[str, Any], times: FloatArray) -> tuple[list[Pose | None], Reference]:
    """True poses of the camera at the times, None where there is none, and what they are."""
    if "truth" not in about:
        return [None] * len(times), NO_REFERENCE
    file = require_inside(path / str(about["truth"]), path)
    trajectory = load_trajectory(str(file))
    if trajectory.timestamps is None:
        raise ValueError(f"{file} has no times, so that no pose belongs to a frame: give a TUM file")
    poses = [pose_at(trajectory, time) for time in times.tolist()]
    if not any(pose is not None for pose in poses):
        raise ValueError(f"{file} covers none of the frames, which begin at {times[0]:.9g} s: give times of one clock")
    reference = reference_for(trajectory.positions, f"The poses of the camera in {file.name}.")
    return poses, replace(reference, kind=about["reference"]) if "reference" in about else reference
