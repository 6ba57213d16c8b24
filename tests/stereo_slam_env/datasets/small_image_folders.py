"""Small folders in the published layouts, written from one short rendered drive whose every quantity is known."""

from __future__ import annotations

import struct
import zlib
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from filters import Pose, Start
from filters.geometry.camera import StereoCamera
from stereo_slam_env.recording.recording import SIMULATION, StereoPair
from stereo_slam_env.rendering.tiny import TinyRenderer
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.scene import Box, Ground, Material, Scene

CAMERA = StereoCamera(120.0, 120.0, 83.5, 55.25, 0.5, 160, 120)
FRAMES, DT = 6, 0.1
VELOCITY, TURN_RATE = 4.0, 0.3
R_UNIT_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera vectors (x right, y down, z forward) to those of a GPS/IMU unit (x forward, y left, z up)."""
EARTH_RADIUS = 6378137.0
LATITUDE, LONGITUDE = 49.01, 8.41


def true_poses() -> list[Pose]:
    """A gentle right turn, W = left camera at frame 0."""
    angles = TURN_RATE * DT * np.arange(FRAMES)
    radius = VELOCITY / TURN_RATE
    return [
        Pose(
            np.array([radius * (1 - np.cos(a)), 0.02 * k, radius * np.sin(a)]),
            Rotation.from_rotvec([0.01 * k, a, -0.005 * k]).as_quat(),
        )
        for k, a in enumerate(angles)
    ]


class Drive:
    """The rendered drive as an `ImageSequence`."""

    name, camera, start, source, skipped = "small", CAMERA, Start(), {"made": "for tests"}, {}
    truth_from = SIMULATION

    def __init__(self, pairs: list[StereoPair]) -> None:
        self._pairs = pairs

    def __len__(self) -> int:
        return len(self._pairs)

    def pairs(self):
        return iter(self._pairs)


@cache
def drive() -> Drive:
    walls = (
        Box((14.0, 5.0, 3.0), (30.0, 1.0, 6.0), 0.1, Material((0.9, 0.8, 0.7), "brick", (2.0, 2.0))),
        Box((20.0, -9.0, 3.0), (20.0, 2.0, 6.0), -0.3, Material((0.8, 0.9, 0.9), "office", (4.0, 4.0))),
        Box((9.0, -1.0, 0.8), (2.0, 1.0, 1.6), 0.6, Material((0.9, 0.3, 0.2), "bark", (1.0, 1.0))),
    )
    ground = Ground((-60.3, -60.3), (60.3, 60.3), Material((0.6, 0.6, 0.6), "paving", (1.5, 1.5)))
    scene = Scene(ground, walls, (), np.zeros((0, 3)))
    renderer = TinyRenderer(CAMERA, WorldFrame(1.65))
    try:
        renderer.build(scene)
        pairs = []
        for k, pose in enumerate(true_poses()):
            images = renderer.render_pair(pose)
            left, right = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (images.left, images.right))
            pairs.append(StereoPair(100.0 + k * DT, left, right, pose))
    finally:
        renderer.close()
    return Drive(pairs)


def write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def numbers(row) -> str:
    return " ".join(f"{x:.12e}" for x in np.ravel(row))


def projection(offset: float = 0.0) -> np.ndarray:
    """P = K [I | t] of a camera `-offset` m to the right of the reference."""
    K = np.array([[CAMERA.fx, 0.0, CAMERA.cx], [0.0, CAMERA.fy, CAMERA.cy], [0.0, 0.0, 1.0]])
    return np.column_stack([K, K @ [offset, 0.0, 0.0]])


def kitti_odometry(root: Path, *, truth: bool = True, cameras: tuple[int, int] = (0, 1), suffix: str = "png") -> Path:
    """`sequences/07` and `poses/07.txt`; the colour cameras are 6 cm to the left, as in the benchmark."""
    folder = root / "sequences" / "07"
    for k, pair in enumerate(drive().pairs()):
        for camera, image in zip(cameras, (pair.left, pair.right), strict=True):
            stored = image if cameras == (0, 1) else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
            write_png(folder / f"image_{camera}" / f"{k:06d}.{suffix}", stored)
    offsets = (0.0, -CAMERA.baseline, 0.06, 0.06 - CAMERA.baseline)
    lines = [f"P{n}: {numbers(projection(offset))}" for n, offset in enumerate(offsets)]
    (folder / "calib.txt").write_text("\n".join([*lines, f"Tr: {numbers(np.eye(4)[:3])}"]) + "\n")
    (folder / "times.txt").write_text("".join(f"{k * DT:.6e}\n" for k in range(FRAMES)))
    if truth:
        (root / "poses").mkdir(exist_ok=True)
        np.savetxt(root / "poses" / "07.txt", pose_rows())
    return folder


def pose_rows() -> np.ndarray:
    return np.array(
        [np.column_stack([Rotation.from_quat(p.orientation).as_matrix(), p.position]).ravel() for p in true_poses()]
    )


def kitti06(folder: Path) -> Path:
    for k, pair in enumerate(drive().pairs()):
        write_png(folder / "image_l" / f"{k:06d}.png", pair.left)
        write_png(folder / "image_r" / f"{k:06d}.png", pair.right)
    (folder / "calib.txt").write_text(f"{numbers(projection())}\n{numbers(projection(-CAMERA.baseline))}\n")
    np.savetxt(folder / "poses.txt", pose_rows())
    rows = np.zeros((FRAMES + 1, 7))
    rows[:, 0] = DT * np.arange(FRAMES + 1)
    rows[:, 1], rows[:, 6] = np.arange(FRAMES + 1), -TURN_RATE
    header = "t_s,vx,vy,vz,wx,wy,wz"
    np.savetxt(folder / "odometry_oxts.csv", rows, delimiter=",", header=header, comments="")
    return folder


# The GPS/IMU unit of the raw layout: behind and above the camera, a little tilted against it.
T_VELO_IMU = np.eye(4)
T_VELO_IMU[:3, :3] = Rotation.from_euler("xyz", [0.01, -0.02, 0.015]).as_matrix()
T_VELO_IMU[:3, 3] = [-0.81, 0.32, -0.8]
T_CAM_VELO = np.eye(4)
T_CAM_VELO[:3, :3] = R_UNIT_CAMERA.T @ Rotation.from_euler("xyz", [-0.01, 0.01, 0.0]).as_matrix()
T_CAM_VELO[:3, 3] = [-0.01, -0.06, -0.27]
R_RECT = Rotation.from_euler("xyz", [0.002, 0.004, -0.003]).as_matrix()


def unit_poses() -> tuple[np.ndarray, Rotation]:
    """Of the GPS/IMU unit in a frame x east, y north, z up, in which the drive starts towards north-east."""
    rectify = np.eye(4)
    rectify[:3, :3] = R_RECT
    T_ci = rectify @ T_CAM_VELO @ T_VELO_IMU
    start = np.eye(4)
    start[:3, :3] = Rotation.from_euler("ZYX", [0.8, 0.02, -0.03]).as_matrix() @ R_UNIT_CAMERA
    start[:3, 3] = [3.0, -2.0, 112.0]
    poses = []
    for pose in true_poses():
        T_wc = np.eye(4)
        T_wc[:3, :3], T_wc[:3, 3] = Rotation.from_quat(pose.orientation).as_matrix(), pose.position
        poses.append(start @ T_wc @ T_ci)
    poses = np.array(poses)
    return poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3])


def mercator_degrees(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Latitude and longitude whose Mercator image (scale of the first one) has these differences of position."""
    scale = np.cos(np.deg2rad(LATITUDE))
    y0 = scale * EARTH_RADIUS * np.log(np.tan(np.deg2rad(45.0 + LATITUDE / 2)))
    y = y0 + positions[:, 1] - positions[0, 1]
    latitude = 2 * np.rad2deg(np.arctan(np.exp(y / (scale * EARTH_RADIUS)))) - 90.0
    longitude = LONGITUDE + np.rad2deg((positions[:, 0] - positions[0, 0]) / (scale * EARTH_RADIUS))
    return latitude, longitude


def kitti_raw(root: Path, *, cameras: tuple[str, str] = ("00", "01"), oxts: bool = True) -> Path:
    date = root / "2011_09_26"
    folder = date / "2011_09_26_drive_0005_sync"
    stamps = [f"2011-09-26 13:02:{25.964389445 + k * DT:012.9f}" for k in range(FRAMES)]
    for k, pair in enumerate(drive().pairs()):
        for camera, image in zip(cameras, (pair.left, pair.right), strict=True):
            write_png(folder / f"image_{camera}" / "data" / f"{k:010d}.png", image)
            (folder / f"image_{camera}" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02"]
    for n, offset in enumerate((0.0, -CAMERA.baseline, 0.06, 0.06 - CAMERA.baseline)):
        lines += [f"S_rect_{n:02d}: {numbers([CAMERA.width, CAMERA.height])}", f"R_rect_{n:02d}: {numbers(R_RECT)}"]
        lines += [f"P_rect_{n:02d}: {numbers(projection(offset))}"]
    (date / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    for name, T in (("calib_imu_to_velo.txt", T_VELO_IMU), ("calib_velo_to_cam.txt", T_CAM_VELO)):
        text = f"calib_time: 25-May-2012 16:47:16\nR: {numbers(T[:3, :3])}\nT: {numbers(T[:3, 3])}\n"
        (date / name).write_text(text)
    if oxts:
        _write_oxts(folder / "oxts", stamps)
    return folder


def _write_oxts(folder: Path, stamps: list[str]) -> None:
    (folder / "data").mkdir(parents=True)
    (folder / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    (folder / "dataformat.txt").write_text("lat:   latitude of the oxts-unit (deg)\n")
    positions, R_wi = unit_poses()
    latitude, longitude = mercator_degrees(positions)
    yaw, pitch, roll = R_wi.as_euler("ZYX").T
    # Row k describes the step from k - 1 to k: mean rate, and mean velocity along forward, left and up of level ground.
    rates, level = np.zeros((FRAMES, 3)), np.zeros((FRAMES, 3))
    rates[1:] = (R_wi[:-1].inv() * R_wi[1:]).as_rotvec() / DT
    halfway = R_wi[:-1] * Rotation.from_rotvec(0.5 * DT * rates[1:])
    body = halfway.inv().apply(np.diff(positions, axis=0) / DT)
    level[1:] = Rotation.from_euler("YX", np.column_stack([pitch, roll])[1:]).apply(body)
    forces = R_wi.inv().apply([0.0, 0.0, 9.81])  # of a unit that is not accelerated
    for k in range(FRAMES):
        row = np.zeros(30)
        row[:6] = latitude[k], longitude[k], positions[k, 2], roll[k], pitch[k], yaw[k]
        row[8:11], row[11:14], row[17:20] = level[k], forces[k], rates[k]
        # The last five columns are integers in the published files.
        words = [*(f"{x:.17g}" for x in row[:25]), "4", "10", "4", "4", "0"]
        (folder / "data" / f"{k:010d}.txt").write_text(" ".join(words) + "\n")


def karlsruhe(root: Path, *, yaw: str = "east", first: int = 60) -> Path:
    """`2009_09_08_drive_0010` with frames from `first` on kept, `insdata.txt` whole, and the calibration beside it."""
    folder = root / "2009_09_08_drive_0010"
    for k, pair in enumerate(drive().pairs()):
        write_png(folder / f"I1_{first + k:06d}.png", pair.left)
        write_png(folder / f"I2_{first + k:06d}.png", pair.right)
    lines = ["calib_time: Tue Sep  8 13:12:21 2009", "corner_dist: 0.1", "roi: 0 0 160 120"]
    for n, offset in ((1, 0.0), (2, -CAMERA.baseline)):
        whole = projection(offset)
        whole[1, 2] += 33.0  # the principal point before the image was cut
        lines += [f"P{n}: {numbers(whole)}", f"P{n}_roi: {numbers(projection(offset))}"]
    (root / "2009_09_08_calib.txt").write_text("\n".join(lines) + "\n")
    # The reader takes the unit to be at the camera, so here it is.
    start = Rotation.from_euler("Z", 2.0) * Rotation.from_matrix(R_UNIT_CAMERA)
    positions = start.apply([pose.position for pose in true_poses()]) + np.array([5.0, 7.0, 110.0])
    R_wu = (
        start * Rotation.from_quat([pose.orientation for pose in true_poses()]) * Rotation.from_matrix(R_UNIT_CAMERA.T)
    )
    heading, pitch, roll = R_wu.as_euler("ZYX").T
    stored = {"east": heading, "north": np.pi / 2 - heading}.get(yaw, heading + 1.0)
    rows = np.zeros((first + FRAMES, 10))
    rows[:, 0] = 1252401141.0 + DT * np.arange(first + FRAMES)
    rows[:first, 4:7], rows[:first, 9] = positions[0], stored[0]
    rows[first:, 4:7] = positions
    rows[first:, 7:10] = np.column_stack([roll, pitch, stored])
    np.savetxt(folder / "insdata.txt", rows, fmt="%.12f")
    return folder


def cut_file(path: Path, share: float = 0.6) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])


def png_bomb(path: Path, width: int, height: int) -> None:
    """A tiny PNG whose header asks for a huge image."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b"\0" * 1000))
        + chunk(b"IEND", b"")
    )
