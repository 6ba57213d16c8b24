"""Small valid folders in every layout that is read, as bytes: what mutations start from."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from filters import ConstantVelocity
from filters.geometry.camera import StereoCamera
from stereo_slam_env.benchmark.recordings.reference_problem import short_turn
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.benchmark.scenarios.streams import description_of
from stereo_slam_env.benchmark.scenarios.study import Study
from stereo_slam_env.benchmark.storage.code_identity import code_digest
from stereo_slam_env.benchmark.storage.run_files import packed_bound, packed_run
from stereo_slam_env.benchmark.storage.store import prepared_study
from stereo_slam_env.evaluation.cramer_rao import cramer_rao_bound
from stereo_slam_env.evaluation.drift_model import DriftModel, claim
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.policies.named_policies import Network
from stereo_slam_env.policies.ppo import LearningCurve
from stereo_slam_env.policies.registered_task import PolicyEvaluation
from stereo_slam_env.recording.archive import packed_recording
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import save_trajectory

Files = Mapping[str, bytes]

FRAMES, DT = 3, 0.1
CAMERA = StereoCamera(30.0, 30.0, 15.5, 11.5, 0.5, 32, 24)
_STAMP = 1403636579763555584


def row(numbers: object) -> str:
    """Numbers on one line."""
    return " ".join(f"{x:.9g}" for x in np.ravel(np.asarray(numbers, dtype=np.float64)))


def rows(table: object) -> bytes:
    """One line a row."""
    return "".join(f"{row(line)}\n" for line in np.asarray(table)).encode()


def projection(offset: float) -> np.ndarray:
    """P = K [I | t] of a camera `-offset` m to the right of the reference."""
    K = np.array([[CAMERA.fx, 0.0, CAMERA.cx], [0.0, CAMERA.fy, CAMERA.cy], [0.0, 0.0, 1.0]])
    return np.column_stack([K, K @ [offset, 0.0, 0.0]])


def poses() -> np.ndarray:
    """A straight drive, (K, 12)."""
    return np.array([np.column_stack([np.eye(3), [0.0, 0.0, 0.7 * k]]).ravel() for k in range(FRAMES)])


@cache
def image(ending: str) -> bytes:
    """A small picture."""
    picture = np.random.default_rng(0).integers(0, 256, (CAMERA.height, CAMERA.width), dtype=np.uint8)
    return bytes(cv2.imencode(ending, picture)[1])


def archive(**arrays: object) -> bytes:
    """An npz file."""
    stream = io.BytesIO()
    np.savez(stream, **{name: np.asarray(value) for name, value in arrays.items()})
    return stream.getvalue()


def kitti07() -> Files:
    """Tracks of two landmarks."""
    features = np.full((4, 2, FRAMES), -1.0)
    features[:, 0] = np.array([500.0, 150.0, 480.0, 150.0])[:, None] + np.arange(FRAMES)
    T = np.eye(4)
    T[:3, :3] = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
    tracks = archive(
        features=features,
        time_stamps=DT * np.arange(FRAMES)[None],
        linear_velocity=np.ones((3, FRAMES)),
        rotational_velocity=np.zeros((3, FRAMES)),
        K=[[700.0, 0.0, 600.0], [0.0, 700.0, 180.0], [0.0, 0.0, 1.0]],
        b=0.5,
        cam_T_imu=T,
    )
    return {"tracks.npz": tracks, "poses.txt": rows(poses())}


def kitti00() -> Files:
    """Stereo factors of two landmarks over 18 frames, two of which are scored."""
    positions = np.column_stack([np.zeros(18), np.zeros(18), 0.7 * np.arange(18)])
    vo = [[k, 1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1] for k, (x, y, z) in enumerate(positions)]
    factors = [[k, j, 650.0, 640.0 - k, 190.0, 0.0, 0.0, 30.0] for j in range(2) for k in range(18)]
    return {
        "stereo_factors.txt": rows(factors),
        "calibration.txt": b"700 700 0 600 180 0.5\n",
        "vo_poses.txt": rows(vo),
        "poses.txt": rows([[1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z] for x, y, z in positions]),
        "times.txt": rows(DT * np.arange(18)[:, None]),
    }


def starry_night() -> Files:
    """Two landmarks over 104 steps, as far as the reader's first one and some more."""
    steps, still = 104, np.zeros((3, 104))
    arrays = {
        "t": DT * np.arange(steps)[None],
        **dict.fromkeys(("r_i_vk_i", "theta_vk_i", "v_vk_vk_i", "w_vk_vk_i"), still),
        "rho_i_pj_i": np.array([[0.3, -0.5], [0.2, 0.1], [4.0, 5.0]]),
        "y_k_j": np.tile(np.array([330.0, 240.0, 320.0, 240.0])[:, None, None], (1, steps, 2)),
        "C_c_v": np.eye(3),
        "rho_v_c_v": np.zeros((3, 1)),
        **{name: np.array([[value]]) for name, value in (("fu", 480.0), ("fv", 480.0), ("b", 0.24))},
        **{name: np.array([[value]]) for name, value in (("cu", 320.0), ("cv", 240.0))},
    }
    return {"starry_night.npz": archive(**arrays)}


def kitti06() -> Files:
    """Images, velocities and poses."""
    velocities = np.column_stack([DT * np.arange(FRAMES + 1), np.ones((FRAMES + 1, 6))])
    table = "t_s,vx,vy,vz,wx,wy,wz\n" + "".join(",".join(row(line).split()) + "\n" for line in velocities)
    return {
        **{f"image_{eye}/{k:06d}.png": image(".png") for eye in "lr" for k in range(FRAMES)},
        "calib.txt": rows([projection(0.0).ravel(), projection(-CAMERA.baseline).ravel()]),
        "poses.txt": rows(poses()),
        "odometry_oxts.csv": table.encode(),
    }


def kitti_odometry() -> Files:
    """PNG on the left, JPEG on the right."""
    entries = "".join(f"P{n}: {row(projection(-CAMERA.baseline * n))}\n" for n in range(2))
    return {
        **{f"sequences/07/image_0/{k:06d}.png": image(".png") for k in range(FRAMES)},
        **{f"sequences/07/image_1/{k:06d}.jpg": image(".jpg") for k in range(FRAMES)},
        "sequences/07/calib.txt": entries.encode(),
        "sequences/07/times.txt": rows(DT * np.arange(FRAMES)[:, None]),
        "poses/07.txt": rows(poses()),
    }


def kitti_raw() -> Files:
    """Images and packets of the GPS/IMU unit."""
    drive = "2011_09_26/2011_09_26_drive_0005_sync"
    stamps = "".join(f"2011-09-26 13:02:{25.964389445 + k * DT:012.9f}\n" for k in range(FRAMES)).encode()
    calibration = "calib_time: 09-Jan-2012\n" + "".join(
        f"R_rect_{n:02d}: {row(np.eye(3))}\nP_rect_{n:02d}: {row(projection(-CAMERA.baseline * n))}\n" for n in range(2)
    )
    packet = np.zeros(30)
    packet[:3] = 49.01, 8.41, 112.0
    return {
        **{f"{drive}/image_{n}/data/{k:010d}.png": image(".png") for n in ("00", "01") for k in range(FRAMES)},
        **{f"{drive}/image_{n}/timestamps.txt": stamps for n in ("00", "01")},
        **{f"{drive}/oxts/data/{k:010d}.txt": rows([packet]) for k in range(FRAMES)},
        "2011_09_26/calib_cam_to_cam.txt": calibration.encode(),
        "2011_09_26/calib_imu_to_velo.txt": f"R: {row(np.eye(3))}\nT: {row([-0.8, 0.3, -0.8])}\n".encode(),
        "2011_09_26/calib_velo_to_cam.txt": f"R: {row(np.eye(3))}\nT: {row([0.0, -0.1, -0.3])}\n".encode(),
    }


def karlsruhe() -> Files:
    """Images and the table of the GPS/IMU unit, calibration beside them."""
    table = np.zeros((FRAMES, 10))
    table[:, 0], table[:, 4] = DT * np.arange(FRAMES), 0.7 * np.arange(FRAMES)
    entries = "".join(f"P{n + 1}_roi: {row(projection(-CAMERA.baseline * n))}\n" for n in range(2))
    drive = "2009_09_08_drive_0010"
    return {
        **{f"{drive}/I{eye}_{k:06d}.png": image(".png") for eye in "12" for k in range(FRAMES)},
        f"{drive}/insdata.txt": rows(table),
        "2009_09_08_calib.txt": entries.encode(),
    }


def euroc() -> Files:
    """Two cameras, listings and truth."""
    files: dict[str, bytes] = {}
    listing = "#timestamp [ns],filename\n" + "".join(f"{_STAMP + k * 10**8},{k}.png\n" for k in range(FRAMES))
    for n in range(2):
        T = np.eye(4)
        T[0, 3] = 0.5 * n
        sensor = (
            "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n"
            f"  data: [{', '.join(row(T).split())}]\ncamera_model: pinhole\nresolution: [32, 24]\n"
            "intrinsics: [30.0, 30.0, 15.5, 11.5] # fu, fv, cu, cv\n"
            "distortion_model: radial-tangential\ndistortion_coefficients: [-0.01, 0.01, 0.0, 0.0]\n"
        )
        files |= {f"mav0/cam{n}/data/{k}.png": image(".png") for k in range(FRAMES)}
        files |= {f"mav0/cam{n}/data.csv": listing.encode(), f"mav0/cam{n}/sensor.yaml": sensor.encode()}
    truth = "".join(f"{_STAMP + k * 10**8 // 2},{0.3 * k},0,0,1,0,0,0,6{',0' * 8}\n" for k in range(2 * FRAMES))
    files["source.json"] = b'{"format": "euroc", "truth_from": {"kind": "simulation", "description": "Exact."}}'
    return {**files, "mav0/state_groundtruth_estimate0/data.csv": f"#timestamp\n{truth}".encode()}


def recording() -> Files:
    """A stored recording."""
    return {"drive.npz": packed_recording(_drive())}


def run() -> Files:
    """A stored run of a filter."""
    return {"run.npz": packed_run(run_filter(_drive(), "inverse-depth"), {"code": "none"})}


def trajectories() -> Files:
    """Five poses in every format."""
    t = np.arange(5.0)
    positions = np.column_stack([np.sin(t), 0.1 * t, t])
    orientations = np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))
    made = Trajectory(positions, orientations, t, np.tile(0.01 * np.eye(6), (5, 1, 1)))
    files = {}
    with TemporaryDirectory() as folder:
        for name in ("run.square", "run.tum", "run.kitti"):
            save_trajectory(Path(folder) / name, made)
            files[name] = (Path(folder) / name).read_bytes()
    return files


def layouts() -> Files:
    """Five poses in the layouts of others: names, nanoseconds, blocks of covariances; a drift model and its claim."""
    t = np.arange(5.0)
    positions = np.column_stack([np.sin(t), 0.1 * t, t])
    xyzw = np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))
    blocks = np.tile([0.01, 0.0, 0.0, 0.01, 0.0, 0.01] * 2, (5, 1))
    tum = np.column_stack([t, positions, xyzw])
    euroc = np.column_stack([_STAMP + 1e9 * t, positions, xyzw[:, [3, 0, 1, 2]]])
    model = DriftModel(1e-4 * np.array([1, 1, 1, 1, 0, 1])[:, None] * np.ones(6))  # nothing by the number of tracks
    named = "t,tx,ty,tz,qx,qy,qz,qw,pxx,pxy,pxz,pyy,pyz,pzz,qrr,qrp,qry,qpp,qpy,qyy\n"
    with TemporaryDirectory() as folder:
        model.write(Path(folder) / "model.json")
        save_trajectory(Path(folder) / "claimed.square", claim(Trajectory(positions, xyzw, t), model))
        files = {name: (Path(folder) / name).read_bytes() for name in ("model.json", "claimed.square")}
    header = b"# timestamp(s) q p v bg ba cam_imu_dt num_cam\n"
    whole = np.column_stack([t, xyzw, positions, np.full((5, 9), 0.1), np.zeros((5, 2))])
    return files | {
        "state_estimate.txt": header + rows(whole),
        "state_deviation.txt": header + rows(np.column_stack([t, np.full((5, 15), 0.1), np.zeros((5, 2))])),
        "openvins.txt": rows(np.column_stack([tum, blocks])),
        "euroc.csv": b"#timestamp [ns],x [m],y [m],z [m],qw,qx,qy,qz\n" + rows(euroc).replace(b" ", b","),
        "cnspy.csv": named.encode() + rows(np.column_stack([tum, blocks])).replace(b" ", b","),
        "numbered.txt": rows(np.column_stack([t, np.tile(poses()[0], (5, 1))])),
        "ros.txt": rows(np.column_stack([tum, np.tile(0.01 * np.eye(6).ravel(), (5, 1))])),
    }


def route() -> Files:
    """Poses of a drive long enough for a route."""
    table = [[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.7 * k] for k in range(20)]
    return {"poses.txt": rows(table)}


def network() -> Files:
    """A small trained policy."""
    weights, biases = (np.ones((4, 3)), np.ones((2, 4))), (np.zeros(4), np.zeros(2))
    made = Network(("belief",), np.zeros(3), np.ones(3), 10.0, weights, biases, {"task": {"hold": 2}})
    with TemporaryDirectory() as folder:
        path = Path(folder) / "network.npz"
        made.save(path)
        return {"network.npz": path.read_bytes()}


def scenario() -> Files:
    """A grid of scenarios."""
    text = """
name = "noise-mismatch"
kind = "reference"
description = "one line"
seeds = 20
gate = false
corruptions = [{ kind = "outliers", share = 0.1 }]
[options]
name = "long_drive"
[[filters]]
name = "inverse-depth"
label = "paper"
options = { error = "so3", motion = { sigma_acceleration = 1.0 } }
[grid]
"options.noise" = ["pixels", "uvd"]
"noise.independent_pixels" = [0.5, 1.0, 2.0]
"""
    crossed = """
name = "crossed"
kind = "dataset"
frames = 100
[options]
path = "{data}/kitti07"
[factorial]
filter = "inverse-depth"
options = { iterations = 2 }
landmark = ["inverse-depth", "euclidean"]
error = ["so3", "quaternion"]
"""
    cells = {
        "name": "two",
        "kind": "gaze",
        "policies": ["sweep", {"name": "greedy", "options": {}}],
        "noise": {"diagonal": [1.0, 1.0, 2.0]},
        "cells": [{"name": "a", "seeds": [1, 2]}, {"name": "b", "frames": 10, "metrics": ["map"]}],
    }
    called = 'name = "called"\nkind = "factory"\n[options]\ncall = "package.module:function"\n'
    texts = {"grid.toml": text, "crossed.toml": crossed, "cells.json": json.dumps(cells), "called.toml": called}
    return {name: text.encode() for name, text in texts.items()}


def results() -> Files:
    """What a run directory says about itself."""
    one = Scenario("one", ReferenceSource("short_turn"), (FilterChoice("paper", "inverse-depth"),))
    two = one.replaced(name="two", seeds=(0, 1))
    study = Study.of(one).as_dict()
    study["cells"] += [{"name": "two", "factors": {"seeds": "0, 1"}, "scenario": two.as_dict()}]
    settings = {"version": 2, "scenario": one.as_dict(), "versions": {"python": "3.11"}}
    return {"settings.json": json.dumps(settings).encode(), "grid/study.json": json.dumps(study).encode()}


def finished() -> Files:
    """A finished run of one filter and its bound."""
    choice = FilterChoice("inverse-depth", "inverse-depth")
    scenario = Scenario("one", ReferenceSource("short_turn"), (choice,), frames=4)
    with TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        (directory,) = prepared_study(out, Study.of(scenario)).write_settings().cells
        directory.save_recording(0, packed_recording(_drive()), description_of(_drive()))
        ran = run_filter(_drive(), "inverse-depth", seed=0)
        directory.save_trial(0, choice, packed_run(ran, directory.provenance(0, choice)))
        bound = cramer_rao_bound(_drive(), ConstantVelocity())
        directory.save_trial(0, None, packed_bound(bound, code_digest()))
        return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}


def training() -> Files:
    """A learning curve, and what it is of."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "learning_curve.csv"
        LearningCurve(path).add(
            10, 1.0, 2.0, PolicyEvaluation(*(float(k) for k in range(len(dataclasses.fields(PolicyEvaluation)))))
        )
        about = json.dumps({"task": {"name": "a"}, "settings": {"seed": 0}})
        return {"learning_curve.csv": path.read_bytes(), "run.json": about.encode()}


@cache
def _drive():
    drive = short_turn(seed=0)
    return dataclasses.replace(drive, frames=drive.frames[:4])
