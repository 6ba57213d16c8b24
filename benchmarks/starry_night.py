"""Real measurements of surveyed landmarks: what the data say about themselves, and how far off filters are.

    python benchmarks/starry_night.py DATA/starry_night_a        # 2 min

First which reading of the velocities belongs to which step, with which sign, and how late: every reading is carried
over 20 steps and compared with motion capture. Then the measurements against the projections of the surveyed landmarks
by the poses of motion capture, and what is left of that when each pose is fitted to its own frame: the errors of the
camera, without those of motion capture. Then filters. Landmark errors are relative to the camera (median over frames),
and in W at the end of the run, where the map is still held.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from filters.catalogue.registry import make_with_common_options
from harness import arguments, show
from stereo_slam_env.datasets import load
from stereo_slam_env.datasets.single_data_sets import GYRO_DELAY, STARRY_NIGHT
from stereo_slam_env.datasets.track_files import step_velocities
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.files.readers import read_archive
from stereo_slam_env.recording.recording import Recording

FIRST, SPAN = 100, 20
# A camera in a hand turns more abruptly than a car.
SETTINGS: dict[str, Any] = {"gate": 0.99, "motion": {"sigma_acceleration": 3.0, "sigma_angular_acceleration": 3.0}}
FILTERS: dict[str, tuple[str, dict[str, Any]]] = {
    "inverse-depth": ("inverse-depth", {}),
    "dual-bearing": ("dual-bearing", {}),
    "euclidean": ("euclidean", {}),
    "inverse-depth, map kept": ("inverse-depth", {"drop_unseen": False}),
    "euclidean, map kept": ("euclidean", {"drop_unseen": False}),
    "submaps": ("submaps", {}),
}


def over_steps(arrays: dict[str, np.ndarray], linear: np.ndarray, angular: np.ndarray) -> tuple[float, float]:
    """RMS error of `SPAN` steps: m, with the attitudes of motion capture, and degrees."""
    times, positions = arrays["t"].reshape(-1), arrays["r_i_vk_i"].T
    turns = Rotation.from_rotvec(arrays["theta_vk_i"].T)
    dt = np.diff(times)
    moved = np.vstack([np.zeros(3), np.cumsum(turns[:-1].apply(linear[1:]) * dt[:, None], axis=0)])
    starts = np.arange(FIRST, len(times) - SPAN, SPAN)
    off = (moved[starts + SPAN] - moved[starts]) - (positions[starts + SPAN] - positions[starts])
    angles = []
    for k in starts:
        turn = turns[k]
        for j in range(k, k + SPAN):
            turn = turn * Rotation.from_rotvec(dt[j] * angular[j + 1])
        angles.append((turn.inv() * turns[k + SPAN]).magnitude())
    rms = np.sqrt((np.array(angles) ** 2).mean())
    return float(np.sqrt((off**2).sum(axis=1).mean())), float(np.degrees(rms))


def readings(arrays: dict[str, np.ndarray]) -> None:
    """Print which reading belongs to which step."""
    times, v, w = arrays["t"].reshape(-1), arrays["v_vk_vk_i"].T, arrays["w_vk_vk_i"].T
    late = np.vstack([v[:1], v[:-1]])
    ours = step_velocities(times, v, w, GYRO_DELAY)
    choices = [
        ("of the end of the step", v, "as stored, of its beginning", np.vstack([w[:1], w[:-1]])),
        ("of its beginning (used)", late, "sign turned", -np.vstack([w[:1], w[:-1]])),
        ("", late, "sign turned, 0.11 s late (used)", ours[1]),
    ]
    rows = []
    for linear_label, linear, angular_label, angular in choices:
        metres, degrees = over_steps(arrays, linear, angular)
        rows.append((linear_label, f"{metres:.3f}" if linear_label else "", angular_label, f"{degrees:.1f}"))
    show(f"velocities carried over {SPAN} steps", ("linear", "error m", "angular", "error deg"), rows)


def dead_reckoning(recording: Recording, sign: float = 1.0) -> float:
    """Distance to the truth at the end, m, by the odometry alone."""
    r, R = np.zeros(3), np.eye(3)
    for before, frame in pairwise(recording.frames):
        assert frame.odometry is not None
        dt, turn = frame.timestamp - before.timestamp, sign * np.array(frame.odometry.angular)
        r = r + dt * R @ Rotation.from_rotvec(0.5 * dt * turn).as_matrix() @ frame.odometry.linear
        R = R @ Rotation.from_rotvec(dt * turn).as_matrix()
    truth = recording.frames[-1].truth
    assert truth is not None
    return float(np.linalg.norm(r - truth.position))


def residuals(recording: Recording, fitted: bool) -> np.ndarray:
    """Measured minus projected, (n, 3) px; `fitted`: by poses fitted to each frame of 6 landmarks or more."""
    found = []
    assert recording.landmarks is not None
    for frame in recording.frames:
        seen = frame.observation
        assert frame.truth is not None
        points_c = frame.truth.to_camera(recording.landmarks.positions[seen.ids])

        def errors(change: np.ndarray, points_c: np.ndarray = points_c, uvd: np.ndarray = seen.uvd) -> np.ndarray:
            moved = (points_c - change[:3]) @ Rotation.from_rotvec(change[3:]).as_matrix()
            return np.asarray(uvd - recording.camera.project(moved)).ravel()

        if not fitted:
            found.append(errors(np.zeros(6)))
        elif len(seen) >= 6:
            best = least_squares(errors, np.zeros(6), loss="soft_l1")
            found.append(errors(best.x) / np.sqrt(1.0 - 2.0 / len(seen)))
    return np.concatenate(found).reshape(-1, 3)


def measurements(folder: Path) -> None:
    """Print how well measurements fit the truth."""
    rows = []
    everything, used = load(folder, max_row_difference=None), load(folder)
    for label, errors in (
        ("all, by motion capture", residuals(everything, False)),
        ("used (rows agree to 1 px), by motion capture", residuals(used, False)),
        ("all, each pose fitted", residuals(everything, True)),
        ("used, each pose fitted", residuals(used, True)),
    ):
        mad = 1.4826 * np.median(np.abs(errors - np.median(errors, axis=0)), axis=0)
        figures = np.sqrt((errors**2).mean(axis=0)), mad, errors.mean(axis=0)
        rows.append((f"{label} ({len(errors)})", *(" ".join(f"{x:.2f}" for x in figure) for figure in figures)))
    show("measurements", ("residuals px of u, v, d", "rms", "MAD sigma", "mean"), rows)


def map_error(recording: Recording, name: str, own: dict[str, Any], odometry: bool) -> str:
    """RMS error in W of the landmarks in the map at the end, m, and how many those are."""
    slam = make_with_common_options(name, recording.camera, recording.noise, own, SETTINGS).filter
    slam.reset(recording.start)
    slam.update(recording.frames[0].observation)
    for before, frame in pairwise(recording.frames):
        slam.predict(frame.timestamp - before.timestamp, frame.odometry if odometry else None)
        slam.update(frame.observation)
    held = slam.landmarks
    if not len(held.ids):
        return "-"
    assert recording.landmarks is not None
    off = np.linalg.norm(held.positions - recording.landmarks.positions[held.ids], axis=1)
    return f"{np.sqrt((off**2).mean()):.3f} ({len(off)})"


def filters(recording: Recording) -> None:
    """Print how far off filters are."""
    heads = ("odometry", "filter", "position m", "end m", "rotation deg", "NEES/6", "NIS/dof", "landmarks m", "in W m")
    rows: list[tuple[str, ...]] = []
    for odometry in (True, False):
        for label, (name, own) in FILTERS.items():
            run = run_filter(recording, name, own, common_options=SETTINGS, use_odometry=odometry)
            if run.failure:
                rows.append(("yes" if odometry else "no", label, run.failure))
                continue
            position = np.linalg.norm(run.true_positions - run.positions, axis=1)
            turned = Rotation.from_quat(run.orientations).inv() * Rotation.from_quat(run.true_orientations)
            rows.append(
                (
                    "yes" if odometry else "no",
                    label,
                    f"{np.sqrt((position**2).mean()):.3f}",
                    f"{position[-1]:.3f}",
                    f"{np.degrees(np.sqrt((turned.magnitude() ** 2).mean())):.1f}",
                    f"{np.nanmean(run.pose_nees) / 6:.1f}",
                    f"{run.nis.sum() / run.nis_dof.sum():.2f}",
                    f"{np.nanmedian(run.landmark_rmse):.3f}",
                    map_error(recording, name, own, odometry),
                )
            )
    show(f"filters, {SETTINGS}", heads, rows)


def main() -> None:
    """Run and print."""
    folder = arguments(__doc__, "folder", folder=Path).folder
    recording = load(folder)
    readings(read_archive(folder / "starry_night.npz", STARRY_NIGHT.arrays))
    print(
        f"dead reckoning ends {dead_reckoning(recording):.2f} m off, "
        f"{dead_reckoning(recording, -1.0):.2f} m with the sign as stored"
    )
    measurements(folder)
    filters(recording)


if __name__ == "__main__":
    main()
