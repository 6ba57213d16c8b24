"""Stereo measurements of 20 surveyed landmarks by a camera in a motion-capture room, with velocities ("Starry Night").

The third data set of T. D. Barfoot's course on state estimation (University of Toronto). Layout: `starry_night.npz`
with the arrays of the original file, see `SHAPES`: k steps, n landmarks, i the room, v_k the vehicle at step k.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from filters import Pose, StereoCamera, StereoNoise
from filters.contract.validation import positive
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.registry import known_by, reference_for
from stereo_slam_env.datasets.tracks import camera_velocities, frames_of, stated_or_assumed, tracks_of_pixels
from stereo_slam_env.files.readers import Shape, read_archive, require_rotations
from stereo_slam_env.recording.recording import LandmarkTruth, Recording

NAME = "starry_night"
FILES = (("starry_night.npz",),)
SHAPES: Mapping[str, Shape] = {
    "t": "k",
    **dict.fromkeys(("r_i_vk_i", "theta_vk_i", "v_vk_vk_i", "w_vk_vk_i"), (3, "k")),
    "rho_i_pj_i": (3, "n"),
    "y_k_j": (4, "k", "n"),
    "C_c_v": (3, 3),
    "rho_v_c_v": 3,
    **dict.fromkeys(("fu", "fv", "cu", "cv", "b"), 1),
}
STATED = "The poses in starry_night.npz."
GYRO_DELAY = 0.11
"""Of the public recording, s."""
FACTS = {
    "image_size": (646, 480),
    "sigma_u": 6.5,
    "sigma_v": 12.8,
    "sigma_d": 1.9,
    "sigma_linear": 0.05,
    "sigma_angular": 0.1,
}
"""Of the public recording, where the archive does not say it. The images are the smallest that hold all measurements (u
up to 644.4). The pixel noise is the root mean square of the measurements used, against the projections of the surveyed
landmarks by motion capture: errors of motion capture, common to the landmarks of a frame, far more than of the camera.
With each pose fitted to its own frame, 0.4, 0.4 and 0.4 px are left (MAD). The noise of the velocities is what the
errors over 20 steps amount to: the published `v_var` and `w_var` are those of single steps, `w_var` with the wrong
sign."""


def read(
    path: Path,
    *,
    first: int | None = None,
    sigma_u: float | None = None,
    sigma_v: float | None = None,
    sigma_d: float | None = None,
    sigma_linear: float | None = None,
    sigma_angular: float | None = None,
    max_row_difference: float | None = 1.0,
    image_size: tuple[int, int] | None = None,
    gyro_delay: float | None = None,
) -> Recording:
    """Read the folder.

    Parameters
    ----------
    path : Path
        Folder with the files named in `FILES`.
    first : int, optional
        First step to use. None: 100 in the recording of the course, where the steps before it see almost nothing, else
        0.
    sigma_u, sigma_v, sigma_d : float, optional
        Standard deviations to assume of left pixel and disparity, independent, px. None: `FACTS` of the public
        recording, `ASSUMED` of a stranger's, with a line in the log.
    sigma_linear, sigma_angular : float, optional
        White noise of the velocities, m/s and rad/s per axis. None: likewise.
    max_row_difference : float, optional
        Measurements whose rows in the two images differ by more are left out and counted, px: there the two cameras
        took different points, and d is wrong by several px in half of them. None keeps all.
    image_size : (int, int), optional
        Width and height of the images, px. None: of the public recording; of a stranger's the smallest that hold all
        measurements, with a line in the log.
    gyro_delay : float, optional
        How late angular velocities are, s. None: `GYRO_DELAY` of the public recording, else 0.

    Returns
    -------
    Recording
        W is the left camera at the first step used, by motion capture. The odometry is that of the camera:
        `step_velocities` says which reading belongs to which step. Landmarks keep their ids (columns of `y_k_j`)
        when they are seen again.

    Raises
    ------
    ValueError
        A file is damaged, has the wrong shape, or holds NaN, or an option is impossible: the message names it.
    """
    archive = path / FILES[0][0]
    arrays = read_archive(archive, SHAPES)
    timestamps, vehicle_i = arrays["t"], arrays["r_i_vk_i"].T
    recording = known_by(vehicle_i)
    if first is None:
        first = 0 if recording is None else recording.first_scored
    require_rotations(archive, arrays["C_c_v"][None])
    if type(first) is not int or not 0 <= first <= len(timestamps) - 2:
        raise ValueError(f"first must be a whole number from 0 to {len(timestamps) - 2}, got {first!r}")

    R_cv, camera_v = arrays["C_c_v"], arrays["rho_v_c_v"]
    turn_iv = Rotation.from_rotvec(arrays["theta_vk_i"].T[first:])
    positions_i = vehicle_i[first:] + turn_iv.apply(camera_v)
    turn_ic = turn_iv * Rotation.from_matrix(R_cv.T)
    to_w = turn_ic[0].inv()
    positions_w = to_w.apply(positions_i - positions_i[0])
    truth = [Pose(r, q) for r, q in zip(positions_w, (to_w * turn_ic).as_quat(), strict=True)]
    points_w = to_w.apply(arrays["rho_i_pj_i"].T - positions_i[0])

    seen = tracks_of_pixels(arrays["y_k_j"][:, first:])
    used = seen
    if max_row_difference is not None:
        assert seen.v_right is not None
        used = seen.select(np.abs(seen.uvd[:, 1] - seen.v_right) <= positive("max_row_difference", max_row_difference))
    sigmas, size = stated_or_assumed(
        path,
        seen,
        None if recording is None else FACTS,
        sigma_u=sigma_u,
        sigma_v=sigma_v,
        sigma_d=sigma_d,
        sigma_linear=sigma_linear,
        sigma_angular=sigma_angular,
        image_size=image_size,
    )
    sigma_linear, sigma_angular = sigmas.pop("sigma_linear"), sigmas.pop("sigma_angular")
    noise = StereoNoise.diagonal(**sigmas)
    delay = 0.0 if gyro_delay is None and recording is None else GYRO_DELAY if gyro_delay is None else gyro_delay
    linear, angular = step_velocities(timestamps, arrays["v_vk_vk_i"].T, arrays["w_vk_vk_i"].T, delay)
    odometry = camera_velocities(
        linear, angular, R_cv, camera_v, sigma_linear=sigma_linear, sigma_angular=sigma_angular
    )
    fx, fy, cx, cy, baseline = (float(arrays[key][0]) for key in ("fu", "fv", "cu", "cv", "b"))
    return Recording(
        path.resolve().name if recording is None else NAME,
        StereoCamera(fx, fy, cx, cy, baseline, *size),
        frames_of(used, timestamps[first:], truth, [None, *odometry[first + 1 :]]),
        noise,
        landmarks=LandmarkTruth(np.arange(len(points_w)), points_w),
        source={
            "reader": NAME,
            "path": str(path),
            "first": first,
            "sigma_uvd_px": [float(sigma) for sigma in sigmas.values()],
            "sigma_linear_m_s": float(sigma_linear),
            "sigma_angular_rad_s": float(sigma_angular),
            "max_row_difference_px": max_row_difference,
            "dropped_row_difference": len(seen) - len(used),
            "gyro": f"sign turned, read {delay} s late, see step_velocities",
        },
        truth_from=reference_for(vehicle_i, STATED),
    )


def step_velocities(
    timestamps: FloatArray, linear_v: FloatArray, angular_v: FloatArray, delay: float = GYRO_DELAY
) -> tuple[FloatArray, FloatArray]:
    """Mean velocities (K, 3) over each step, out of the readings (K, 3) in the vehicle frame; row 0, of no step, is 0.

    Found out by residuals against motion capture (steps 100 to 1199): a linear reading describes the step that begins
    with it (over 20 steps 8 to 17 mm, taken with the attitude of motion capture; the reading at the end of the step
    24 to 38 mm). The angular readings have the opposite sign of the rotation (variance of the residual 0.003 to 0.009
    after turning it, 0.06 to 0.09 (rad/s)^2 before, which is where the published `w_var` comes from), and are
    `delay` late (the same in both halves).
    """
    late = np.stack([np.interp(timestamps + delay, timestamps, column) for column in angular_v.T], axis=1)
    linear, angular = np.zeros_like(linear_v), np.zeros_like(angular_v)
    linear[1:] = linear_v[:-1]
    angular[1:] = -0.5 * (late[:-1] + late[1:])
    return linear, angular
