"""Small valid files of what is handed in from outside: bags, calibrations, layouts of others, packets, bodies."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fuzz import seeds
from fuzz.seeds import CAMERA, DT, FRAMES, Files, image, row, rows
from stereo_slam_env.benchmark.campaign import run_benchmark
from stereo_slam_env.benchmark.packets import packet_of, write_packet
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.datasets import open_image_sequence

_STAMP = 1403636579763555584


def made_by(write: Callable[[Path], object]) -> Files:
    """The files that a function leaves in a folder."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        write(folder)
        return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# ---- bags ------------------------------------------------------------------------------------------------------------


def _write_poses(folder: Path, plugin: str, mode: str | None = None) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    kinds, kind = types.types, "geometry_msgs/msg/PoseStamped"
    writer = Writer(folder, version=8, storage_plugin=StoragePlugin[plugin])
    if mode is not None:
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/pose", kind, typestore=types)
        for k in range(5):
            header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](k, 0), "w")
            point = kinds["geometry_msgs/msg/Point"](0.1 * k, 0.0, 1.0 * k)
            pose = kinds["geometry_msgs/msg/Pose"](point, kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0))
            writer.write(connection, k * 10**9, types.serialize_cdr(kinds[kind](header, pose), kind))


@cache
def bags() -> Files:
    """Poses in a database and its folder, and in an MCAP with packed chunks."""

    def write(folder: Path) -> None:
        _write_poses(folder / "database", "SQLITE3")
        _write_poses(folder / "chunks", "MCAP", "STORAGE")
        next((folder / "chunks").glob("*.mcap")).rename(folder / "poses.mcap")
        (folder / "chunks" / "metadata.yaml").unlink()
        (folder / "chunks").rmdir()

    return made_by(write)


@cache
def bag_of_images() -> Files:
    """Stereo images with their calibration, as `convert` writes them."""

    def write(folder: Path) -> None:
        from stereo_slam_env.datasets import write_recording

        for name, content in seeds.kitti06().items():
            (folder / "in" / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / "in" / name).write_bytes(content)
        write_recording(open_image_sequence(folder / "in"), folder / "images.mcap")

    return {"images.mcap": made_by(write)["images.mcap"]}


# ---- calibrations ----------------------------------------------------------------------------------------------------


def _list(numbers: object) -> str:
    return f"[{', '.join(row(numbers).split())}]"


def _matrix(name: str, numbers: object, tag: str = "") -> str:
    table = np.atleast_2d(np.asarray(numbers))
    return f"{name}:{tag}\n   rows: {table.shape[0]}\n   cols: {table.shape[1]}\n   dt: d\n   data: {_list(table)}\n"


def rigs() -> Files:
    """One rig in every format."""
    K = [[CAMERA.fx, 0.0, CAMERA.cx], [0.0, CAMERA.fy, CAMERA.cy], [0.0, 0.0, 1.0]]
    four, size = _list([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy]), _list([CAMERA.width, CAMERA.height])
    lens = "distortion_model: radtan\n  distortion_coeffs: [-0.01, 0.01, 0.0, 0.0]"
    T = np.eye(4)
    T[0, 3] = -CAMERA.baseline
    chain = "".join(
        f"cam{n}:\n" + (f"  T_cn_cnm1: [{', '.join(map(_list, T))}]\n" if n else "") +
        f"  camera_model: pinhole\n  {lens}\n  intrinsics: {four}\n  resolution: {size}\n"
        for n in range(2)
    )  # fmt: skip
    tag = " !!opencv-matrix"
    opencv = "%YAML:1.0\n---\n"
    opencv += "".join(_matrix(f"M{n}", K, tag) + _matrix(f"D{n}", [[0.01, 0, 0, 0, 0]], tag) for n in (1, 2))
    opencv += _matrix("R", np.eye(3), tag) + _matrix("T", [[-CAMERA.baseline], [0], [0]], tag)
    orb = {"Camera.type": "Rectified", "Camera.bf": CAMERA.disparity_constant, "Camera.width": 32, "Camera.height": 24}
    orb |= {f"Camera.{key}": getattr(CAMERA, key) for key in ("fx", "fy", "cx", "cy")}
    files = {"camchain.yaml": chain, "opencv.yml": opencv}
    files["orb.yaml"] = "%YAML:1.0\n" + "".join(f"{key}: {value}\n" for key, value in orb.items())
    files["orb.json"] = json.dumps(orb)
    for n, name in enumerate(("left", "right")):
        text = f"image_width: {CAMERA.width}\nimage_height: {CAMERA.height}\ncamera_name: {name}\n"
        text += _matrix("camera_matrix", K) + "distortion_model: plumb_bob\n"
        text += _matrix("distortion_coefficients", np.zeros(5))
        P = seeds.projection(-CAMERA.baseline * n)
        files[f"info/{name}.yaml"] = text + _matrix("rectification_matrix", np.eye(3)) + _matrix("projection_matrix", P)
    entries = "".join(f"P{n}: {row(seeds.projection(-CAMERA.baseline * n))}\n" for n in range(2))
    return {**{name: text.encode() for name, text in files.items()}, "calib.txt": entries.encode()}


# ---- layouts of others -----------------------------------------------------------------------------------------------


def tartanair() -> Files:
    """Version 2."""
    poses = np.column_stack([0.7 * np.arange(FRAMES), np.zeros((FRAMES, 5)), np.ones(FRAMES)])
    return {
        **{f"image_{e}cam_front/{k:06d}_{e}cam_front.png": image(".png") for e in "lr" for k in range(FRAMES)},
        "pose_lcam_front.txt": rows(poses),
        "imu/cam_time.txt": rows(DT * np.arange(FRAMES)[:, None]),
    }


def vslam_lab() -> Files:
    """Images, their list, a calibration of two pinholes, and truth."""
    T = np.eye(4)
    sheet = "cameras:\n"
    for n in range(2):
        T[0, 3] = 0.5 * n
        sheet += f"  - cam_name: rgb_{n}\n    cam_model: radtan4\n    focal_length: [30.0, 30.0]\n"
        sheet += "    principal_point: [15.5, 11.5]\n    distortion_coefficients: [-0.01, 0.01, 0.0, 0.0]\n"
        sheet += f"    image_dimension: [32, 24]\n    fps: 10.0\n    T_BS: {_list(T)}\n"
    times = [_STAMP + k * 10**8 for k in range(FRAMES)]
    listing = "ts_rgb_0 (ns),path_rgb_0,ts_rgb_1 (ns),path_rgb_1\n"
    listing += "".join(f"{t},rgb_0/{k}.png,{t},rgb_1/{k}.png\n" for k, t in enumerate(times))
    truth = "ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw\n"
    truth += "".join(f"{t},{0.3 * k},0,0,0,0,0,1\n" for k, t in enumerate(times))
    return {
        **{f"rgb_{n}/{k}.png": image(".png") for n in range(2) for k in range(FRAMES)},
        "rgb.csv": listing.encode(),
        "calibration.yaml": sheet.encode(),
        "groundtruth.csv": truth.encode(),
    }


def measured_tracks() -> Files:
    """Measurements of another program: with a line of names and deviations, and with triangles of covariances."""
    named = "# d,v,u,id,frame,su,sv,sd\n" + "".join(
        f"4.5,{5 + j},{10 + k},{j},{k},0.5,0.5,0.7\n" for k in range(FRAMES) for j in range(2)
    )
    plain = "".join(f"{k} {j} {10 + k} {5 + j} 4.5 1 0 1 1 0 2\n" for k in range(FRAMES) for j in range(2))
    return {"named.csv": named.encode(), "plain.txt": plain.encode()}


def mono_tracks() -> Files:
    """Tracks of one camera, and samples of an inertial unit."""
    unit = "position = [0, 0, 0]\norientation = [0, 0, 0, 1]\ngyro_density = 1e-4\naccelerometer_density = 1e-3\n"
    about = "camera = { fx = 30.0, fy = 30.0, cx = 15.5, cy = 11.5, width = 32, height = 24 }\nsigma_px = 1.0\n"
    about += 'truth = "truth.tum"\nreference = "surveyed"\n'
    truth = "".join(f"{DT * k:.1f} 0 0 {0.7 * k:.1f} 0 0 0 1\n" for k in range(FRAMES))
    tracks = "".join(f"{DT * k:.1f},{j},{10 + k},{5 + j}\n" for k in range(FRAMES) for j in range(2))
    samples = "".join(f"{0.02 * k:.2f},0,0,0,0,-9.81,0\n" for k in range(5 * FRAMES))
    return {
        "recording.toml": f"{about}[unit]\n{unit}gyro_walk = 1e-5\naccelerometer_walk = 1e-4\n".encode(),
        "tracks.csv": f"t,id,u,v\n{tracks}".encode(),
        "imu.csv": f"t,wx,wy,wz,ax,ay,az\n{samples}".encode(),
        "truth.tum": truth.encode(),
    }


def stereo_folder() -> Files:
    """A plain folder that says what it is."""
    numbers = "fx = 30.0, fy = 30.0, cx = 15.5, cy = 11.5, baseline = 0.5, width = 32, height = 24"
    about = f'rig = {{ {numbers} }}\ntimes = "times.txt"\ntruth = "truth.tum"\n'
    about += 'reference = "surveyed"\nbody = "body.json"\n'
    truth = "".join(f"{DT * k:.1f} 0 0 {0.7 * k:.1f} 0 0 0 1\n" for k in range(FRAMES))
    return {
        **{f"{eye}/{k:03d}.png": image(".png") for eye in ("left", "right") for k in range(FRAMES)},
        "recording.toml": about.encode(),
        "times.txt": rows(DT * np.arange(FRAMES)[:, None]),
        "truth.tum": truth.encode(),
        "body.json": body()["body.json"],
    }


# ---- what is handed in -----------------------------------------------------------------------------------------------


def body() -> Files:
    """The pose of a body in another."""
    return {"body.json": json.dumps({"R": np.eye(3).tolist(), "t": [0.1, 0.0, 0.2]}).encode()}


def bodies() -> Files:
    """A robot of two links, with a mesh."""
    mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1/1 2/2 4/3\n"
    shapes = '<collision><geometry><mesh filename="mesh.obj" scale="1 1 2"/></geometry></collision>'
    shapes += '<collision><origin xyz="0 0 1"/><geometry><box size="1 2 3"/></geometry></collision>'
    joint = '<joint name="j" type="fixed"><parent link="a"/><child link="b"/><origin xyz="1 0 0" rpy="0 0 1"/></joint>'
    other = '<link name="b"><collision><geometry><sphere radius="0.5"/></geometry></collision></link>'
    robot = f'<?xml version="1.0"?>\n<robot name="r"><link name="a">{shapes}</link>{other}{joint}</robot>\n'
    return {"robot.urdf": robot.encode(), "mesh.obj": mesh.encode()}


@cache
def packets() -> Files:
    """What `submit` makes of a run."""

    def write(folder: Path) -> None:
        choice = FilterChoice("a", "euclidean")
        scenario = Scenario("one", ReferenceSource("short_turn"), (choice,), frames=4, metrics=())
        run_benchmark(scenario, folder / "run", jobs=1)
        write_packet(folder / "packet.json", packet_of(folder / "run"))

    return {"packet.json": made_by(write)["packet.json"]}
