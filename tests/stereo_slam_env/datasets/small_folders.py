"""Small folders in the layouts of the readers, with known content."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

FRAMES, DT = 8, 0.1
FOCAL, CENTRE, BASELINE = 700.0, (600.0, 180.0), 0.5
# The camera looks along the IMU's x, sits 1 m ahead of it, 0.3 m to the right and 0.8 m up.
R_CI = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
P_I = np.array([1.0, -0.3, 0.8])
LINEAR_I, ANGULAR_I = np.array([5.0, 0.2, -0.1]), np.array([0.02, -0.03, 0.4])


def pose_rows(positions: np.ndarray, rotations: Rotation) -> np.ndarray:
    """KITTI rows of 12 numbers."""
    return np.concatenate([rotations.as_matrix(), positions[:, :, None]], axis=2).reshape(-1, 12)


def imu_drive() -> tuple[np.ndarray, Rotation]:
    """Camera poses of an IMU that moves with constant velocities in its own frame, in W (camera at frame 0)."""
    x, y, z = ANGULAR_I
    twist = np.zeros((4, 4))
    twist[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    twist[:3, 3] = LINEAR_I
    poses = np.array([expm(twist * DT * k) for k in range(FRAMES)])
    rotations = Rotation.from_matrix(poses[:, :3, :3])
    camera_positions = poses[:, :3, 3] + rotations.apply(P_I)
    camera_rotations = rotations * Rotation.from_matrix(R_CI.T)
    first = camera_rotations[0].inv()
    return first.apply(camera_positions - camera_positions[0]), first * camera_rotations


def kitti07(folder: Path, **changes: np.ndarray) -> Path:
    """Four landmarks: seen always, seen in frames 2-4, seen with d <= 0 in frame 5, never seen."""
    folder.mkdir(parents=True, exist_ok=True)
    features = np.full((4, 4, FRAMES), -1.0)
    k = np.arange(FRAMES)
    features[:, 0] = [500.0 + k, 150.0 + k, 480.0 + k, 150.5 + k]
    features[:, 1, 2:5] = [[700.0] * 3, [200.0] * 3, [690.0] * 3, [199.0] * 3]
    features[:, 2, 5] = [650.0, 170.0, 651.0, 170.0]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R_CI, P_I
    arrays = {
        "features": features,
        "time_stamps": 1e9 + DT * k[None],
        # Column k + 1 describes the step k -> k + 1, so column 0 is of no step here.
        "linear_velocity": np.column_stack([np.full(3, 99.0), *[LINEAR_I] * (FRAMES - 1)]),
        "rotational_velocity": np.column_stack([np.full(3, 99.0), *[ANGULAR_I] * (FRAMES - 1)]),
        "K": np.array([[FOCAL, 0.0, CENTRE[0]], [0.0, FOCAL, CENTRE[1]], [0.0, 0.0, 1.0]]),
        "b": np.array(BASELINE),
        "cam_T_imu": T,
    }
    np.savez(folder / "tracks.npz", **(arrays | changes))
    positions, rotations = imu_drive()
    np.savetxt(folder / "poses.txt", pose_rows(positions, rotations)[:-2])
    return folder


def kitti00(folder: Path, frame_ids: tuple[int, ...] = (*range(18), 19, 20)) -> Path:
    """A straight drive; odometry and truth differ by a rigid motion; frame 18 is absent."""
    folder.mkdir(parents=True, exist_ok=True)
    count = max(frame_ids) + 1
    positions = np.column_stack([np.zeros(count), np.zeros(count), 0.7 * np.arange(count)])
    bent = positions + np.column_stack([0.01 * np.arange(count) ** 2, np.zeros(count), np.zeros(count)])
    tilted = Rotation.from_euler("y", 5.0, degrees=True)
    np.savetxt(folder / "poses.txt", pose_rows(tilted.apply(bent), Rotation.concatenate([tilted] * count)))
    np.savetxt(folder / "times.txt", 0.1 * np.arange(count))
    vo = [[k, 1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1] for k, (x, y, z) in enumerate(positions)]
    np.savetxt(folder / "vo_poses.txt", [row for row in vo if row[0] in frame_ids])
    (folder / "calibration.txt").write_text(f"{FOCAL} {FOCAL} 0.0 {CENTRE[0]} {CENTRE[1]} {BASELINE}\n")
    rows = []
    for landmark, depth in enumerate((30.0, 45.0, 60.0)):
        for k in frame_ids:
            z = depth - 0.7 * k
            rows.append([k, landmark, 650.0, 650.0 - FOCAL * BASELINE / z, 190.0, 0.0, 0.0, z])
    np.savetxt(folder / "stereo_factors.txt", rows)
    return folder


def starry_night(folder: Path, **changes: np.ndarray | None) -> Path:
    """12 steps of a vehicle that turns steadily and changes its speed from step to step, before 3 landmarks.

    Landmark 0 is seen always, 1 in steps 2 to 5 and again from 9 on, 2 by eyes that disagree on the row in step 4.
    """
    folder.mkdir(parents=True, exist_ok=True)
    steps, rate = 12, np.array([0.1, -0.2, 0.3])
    linear = np.array([0.5, 0.1, -0.2]) + 0.05 * np.arange(steps)[:, None] * [1.0, -1.0, 0.5]
    turns = Rotation.from_rotvec(DT * np.arange(steps)[:, None] * rate) * Rotation.from_rotvec([0.3, -0.2, 0.5])
    half_way = turns * Rotation.from_rotvec(0.5 * DT * turns[0].inv().apply(rate))
    moves = DT * half_way.apply(linear)
    positions = np.array([1.0, 2.0, 0.5]) + np.vstack([np.zeros(3), np.cumsum(moves[:-1], axis=0)])
    camera = positions + turns.apply(P_I), turns * Rotation.from_matrix(R_CI.T)
    ahead = np.array([[0.3, 0.2, 4.0], [-0.5, 0.1, 5.0], [0.1, -0.4, 3.0]])
    points = camera[0][5] + camera[1][5].apply(ahead)
    pixels = np.full((4, steps, 3), -1.0)
    for j, seen in enumerate((range(steps), (2, 3, 4, 5, 9, 10, 11), (3, 4))):
        for k in seen:
            x, y, z = camera[1][k].inv().apply(points[j] - camera[0][k])
            u, v = FOCAL * x / z + CENTRE[0], FOCAL * y / z + CENTRE[1]
            pixels[:, k, j] = [u, v, u - FOCAL * BASELINE / z, v + (3.0 if (j, k) == (2, 4) else 0.0)]
    arrays = {
        "t": 20.0 + DT * np.arange(steps)[None],
        "r_i_vk_i": positions.T,
        "theta_vk_i": turns.as_rotvec().T,
        "v_vk_vk_i": linear.T,
        # Of the opposite sign, as in the source.
        "w_vk_vk_i": -np.tile(turns[0].inv().apply(rate), (steps, 1)).T,
        "rho_i_pj_i": points.T,
        "y_k_j": pixels,
        "C_c_v": R_CI,
        "rho_v_c_v": P_I[:, None],
        **{name: np.array([[value]]) for name, value in zip(("fu", "fv"), (FOCAL, FOCAL), strict=True)},
        **{name: np.array([[value]]) for name, value in zip(("cu", "cv", "b"), (*CENTRE, BASELINE), strict=True)},
    }
    kept = {name: value for name, value in (arrays | changes).items() if value is not None}
    np.savez(folder / "starry_night.npz", **kept)
    return folder
