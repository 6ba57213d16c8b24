"""Drives in the ASL layout of the EuRoC MAV data and of TUM-VI, written pair by pair; `euroc` reads them.

An odometry has no place in either layout: `mav0/odom0/data.csv`, which other programs pass over, has a row a step with
the mean velocity of the left camera since the row before (linear, angular, camera frame) and the lower triangle of its
covariance. A clock of the unit that is not that of the cameras stands in `cam0/sensor.yaml` of EuRoC's layout, as
Kalibr's `timeshift_cam_imu`.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import IO

import numpy as np

from filters import Pose
from stereo_slam_env.datasets.image_files import write_image
from stereo_slam_env.datasets.settings_files import Topics, settings_files
from stereo_slam_env.datasets.written_frame import WrittenFrame, numbers
from stereo_slam_env.files.folders import write_text
from stereo_slam_env.sensing.sensor_suite import SensorSuite

_POSE = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
_STATES = ", ".join(
    f"{name}_{axis} [{unit}]"
    for name, unit in (("v_RS_R", "m s^-1"), ("b_w_RS_S", "rad s^-1"), ("b_a_RS_S", "m s^-2"))
    for axis in "xyz"
)
_IMU = ", ".join(
    ["#timestamp [ns]"]
    + [f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"]
    + [f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"]
)
_LOWER = np.tril_indices(6)
_ODOMETRY = ", ".join(
    ["#timestamp [ns]", *(f"v_{axis} [m s^-1]" for axis in "xyz"), *(f"w_{axis} [rad s^-1]" for axis in "xyz")]
    + [f"P{i}{j}" for i, j in zip(*_LOWER, strict=True)]
)


class AslWriter:
    """Writer of `mav0`; of TUM-VI with Kalibr's files in `dso`."""

    def __init__(self, folder: Path, suite: SensorSuite, *, of_tum_vi: bool) -> None:
        self._suite, self._of_tum_vi, self._root = suite, of_tum_vi, folder / "mav0"
        self._folder, self._stack, self._files = folder, ExitStack(), dict[str, IO[str]]()
        self._size = suite.camera.width, suite.camera.height
        for camera in ("cam0", "cam1"):
            (self._root / camera / "data").mkdir(parents=True, exist_ok=True)
            self._table(camera, "#timestamp [ns],filename")

    def _table(self, name: str, header: str) -> IO[str]:
        """The open table of a sensor, with its header."""
        if name not in self._files:
            path = self._root / name / "data.csv"
            path.parent.mkdir(parents=True, exist_ok=True)
            self._files[name] = self._stack.enter_context(path.open("w"))
            self._files[name].write(header + "\n")
        return self._files[name]

    def has_images(self, number: int, stamp: int) -> bool:
        """Whether both images of a stamp, ns, are there."""
        return all((self._root / camera / "data" / f"{stamp}.png").is_file() for camera in ("cam0", "cam1"))

    def write(self, frame: WrittenFrame) -> None:
        """Write what came with a pair."""
        for camera, image in (("cam0", frame.pair.left), ("cam1", frame.pair.right)):
            name = f"{frame.stamp}.png"
            write_image(self._root / camera / "data" / name, image, self._size, frame.number)
            self._files[camera].write(f"{frame.stamp},{name}\n")
        for stamp, values in frame.rows:
            self._table("imu0", _IMU).write(f"{stamp},{numbers(values, ',')}\n")
        if (odometry := frame.pair.odometry) is not None:
            row = [*odometry.linear, *odometry.angular, *odometry.covariance[_LOWER]]
            self._table("odom0", _ODOMETRY).write(f"{frame.stamp},{numbers(row, ',')}\n")
        if (pose := frame.T_ub) is not None:
            self._write_truth(frame, pose)

    def _write_truth(self, frame: WrittenFrame, pose: Pose) -> None:
        row, velocity, biases = [*pose.position, *np.roll(pose.orientation, 1)], frame.velocity_u, frame.pair.biases
        if self._of_tum_vi:
            self._table("mocap0", _POSE).write(f"{frame.stamp},{numbers(row, ',')}\n")
            return
        header = _POSE
        if velocity is not None:
            header, row = f"{header}, {_STATES}", [*row, *velocity, *(np.zeros(6) if biases is None else biases)]
        self._table("state_groundtruth_estimate0", header).write(f"{frame.stamp},{numbers(row, ',')}\n")

    def close(self) -> None:
        """Write what makes it complete: the calibration."""
        self._stack.close()
        suite = self._suite
        if self._of_tum_vi:
            settings = settings_files(suite, "drive", Topics())
            texts = {"dso/camchain.yaml": settings["kalibr/camchain.yaml"]}
            texts |= {"dso/imu_config.yaml": settings["kalibr/imu.yaml"]} if suite.unit is not None else {}
        else:
            texts = {f"mav0/{name}/sensor.yaml": text for name, text in self._sensors().items()}
            texts["mav0/body.yaml"] = "comment: the body is the inertial unit; without one x is forward, z up\n"
        for name, text in texts.items():
            write_text(self._folder / name, text)

    def _sensors(self) -> dict[str, str]:
        """EuRoC's descriptions of the sensors, by folder."""
        suite, camera = self._suite, self._suite.camera
        shift = f"timeshift_cam_imu: {suite.time_offset!r}\n" if suite.time_offset else ""
        sensors = {
            name: _sensor("camera", T_bs)
            + f"rate_hz: {suite.rate!r}\nresolution: [{camera.width}, {camera.height}]\ncamera_model: pinhole\n"
            f"intrinsics: [{numbers([camera.fx, camera.fy, camera.cx, camera.cy], ', ')}]\n"
            "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n" + shift
            for name, T_bs in (("cam0", suite.T_bc), ("cam1", suite.T_br))
        }
        if (unit := suite.unit) is not None and "imu0" in self._files:
            sensors["imu0"] = _sensor("imu", Pose()) + (
                f"rate_hz: {suite.imu_rate!r}\n"
                f"gyroscope_noise_density: {unit.gyro_density!r}\ngyroscope_random_walk: {unit.gyro_walk!r}\n"
                f"accelerometer_noise_density: {unit.accelerometer_density!r}\n"
                f"accelerometer_random_walk: {unit.accelerometer_walk!r}\n"
            )
        if "odom0" in self._files:
            sensors["odom0"] = _sensor("odometry", suite.T_bc)
        if "state_groundtruth_estimate0" in self._files:
            sensors["state_groundtruth_estimate0"] = _sensor("visual-inertial", Pose())
        return sensors


def _sensor(kind: str, T_bs: Pose) -> str:
    """Opening of a `sensor.yaml`: what it is, and its pose in the body."""
    rows = np.vstack([np.column_stack([T_bs.R_wc, T_bs.position]), [0.0, 0.0, 0.0, 1.0]])
    return f"sensor_type: {kind}\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{numbers(rows.ravel(), ', ')}]\n"
