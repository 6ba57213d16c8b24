"""Settings of other programs for a simulated drive: Kalibr, OpenVINS, VINS-Fusion, ORB-SLAM3, Basalt and ROS.

All of them state one rig, each in its own words. What differs: which way a transform goes, and whether noise is a
density (continuous) or the standard deviation of one sample (discrete). Texts stand in `settings.jinja`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from filters import Pose
from filters.contract.validation import plain
from filters.geometry.arrays import FloatArray
from stereo_slam_env.sensing.sensor_suite import SensorSuite

_TOPIC = re.compile(r"/?[A-Za-z][A-Za-z0-9_/]*")
_BEGIN = re.compile(r"^=== (\S+)\n", re.MULTILINE)


@dataclass(frozen=True)
class Topics:
    """Names of the ROS topics of a drive.

    Raises
    ------
    ValueError
        No name of a topic: letters, digits, `_` and `/` are allowed.
    """

    left_image: str = "/cam0/image_raw"
    right_image: str = "/cam1/image_raw"
    left_info: str = "/cam0/camera_info"
    right_info: str = "/cam1/camera_info"
    imu: str = "/imu0"
    odometry: str = "/odometry"

    def __post_init__(self) -> None:
        for topic in astuple(self):
            if not isinstance(topic, str) or not _TOPIC.fullmatch(topic):
                raise ValueError(f"topics: {plain(str(topic))!r} is no ROS topic: use letters, digits, _ and /")


def settings_files(suite: SensorSuite, name: str, topics: Topics) -> dict[str, str]:
    """Content of the settings files for a drive, by file name ("kalibr/camchain.yaml").

    Parameters
    ----------
    suite : SensorSuite
        The rig; without an inertial unit the files that need one are left out.
    name : str
        What the drive is called; it stands in comments.
    topics : Topics
        Where a bag of the drive has its messages.
    """
    texts = _BEGIN.split(_rendered("settings.jinja", suite, name, topics=topics))[1:]
    settings = dict(zip(texts[::2], (text.rstrip() + "\n" for text in texts[1::2]), strict=True))
    return {**settings, "basalt/calibration.json": _basalt(suite)}


def readme(suite: SensorSuite, name: str, about: Mapping[str, str], states: str = "") -> str:
    """README.md of the folder of a drive: its frames, noise, clocks, files and truth.

    Parameters
    ----------
    suite : SensorSuite
        The rig.
    name : str
        What the drive is called.
    about : mapping of str to str
        Further facts by title, such as errors that settings cannot state.
    states : str
        Where the true velocity and biases are; empty: nowhere.
    """
    return _rendered("settings_readme.jinja", suite, name, about=about, states=states)


def _rendered(template: str, suite: SensorSuite, name: str, **values: Any) -> str:
    T_rl = np.eye(4)
    T_rl[0, 3] = -suite.camera.baseline
    text: str = _template(template).render(
        suite=suite,
        unit=suite.unit,
        name=plain(" ".join(name.split())),
        root=float(np.sqrt(suite.imu_rate)),
        gravity=round(float(np.linalg.norm(suite.gravity)), 9),
        T_bc=_matrix(suite.T_bc),
        T_br=_matrix(suite.T_br),
        T_rl=T_rl,
        deviations=[] if suite.odometry is None else [f"{value:.6g}" for value in np.sqrt(np.diag(suite.odometry))],
        **values,
    )
    return text


@cache
def _template(name: str) -> Any:
    from jinja2 import Environment, StrictUndefined  # as of what only writes

    environment = Environment(
        trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined, keep_trailing_newline=True
    )
    environment.filters |= {"n": _number, "row": _row, "rows": _rows, "opencv": _opencv, "table": _table}
    environment.filters["inverse"] = np.linalg.inv
    return environment.from_string(files(__package__).joinpath(name).read_text(encoding="utf-8"))


def _number(value: float) -> str:
    """Shortest text that is read back as the same number, and as a number: YAML takes 1e-05 for a word."""
    text = repr(float(value) + 0.0)
    return text if "." in text else text.replace("e", ".0e")


def _row(values: ArrayLike) -> str:
    return f"[{', '.join(map(_number, np.ravel(values)))}]"


def _rows(matrix: FloatArray) -> str:
    return "".join(f"\n    - {_row(row)}" for row in matrix)


def _opencv(matrix: FloatArray, kind: str) -> str:
    data = ",\n          ".join(_row(row)[1:-1] for row in matrix)
    rows, columns = matrix.shape
    return f"!!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: {kind}\n   data: [{data}]"


def _table(matrix: FloatArray) -> str:
    """Rows of a matrix in columns, every digit."""
    return "\n".join("  ".join(f"{_number(value):>24}" for value in row) for row in matrix)


def _matrix(pose: Pose) -> FloatArray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = pose.R_wc, pose.position
    return T


def _basalt(suite: SensorSuite) -> str:
    """Calibration for Basalt, which wants every entry, also where there is no inertial unit: they are 0 then."""
    unit, camera = suite.unit, suite.camera
    poses = [
        dict(zip(("px", "py", "pz", "qx", "qy", "qz", "qw"), (*pose.position, *pose.orientation), strict=True))
        for pose in (suite.T_bc, suite.T_br)
    ]
    lens = {name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")}
    densities = {
        "accel_noise_std": "accelerometer_density",
        "gyro_noise_std": "gyro_density",
        "accel_bias_std": "accelerometer_walk",
        "gyro_bias_std": "gyro_walk",
    }
    calibration = {
        "T_imu_cam": [{name: float(value) for name, value in pose.items()} for pose in poses],
        "intrinsics": [{"camera_type": "pinhole", "intrinsics": lens}] * 2,
        "resolution": [[camera.width, camera.height]] * 2,
        "calib_accel_bias": [0.0] * 9,
        "calib_gyro_bias": [0.0] * 12,
        "imu_update_rate": float(suite.imu_rate),
        **{name: [float(getattr(unit, density, 0.0))] * 3 for name, density in densities.items()},
        "cam_time_offset_ns": round(1e9 * suite.time_offset),
        "vignette": [],
    }
    return json.dumps({"value0": calibration}, indent=2) + "\n"
