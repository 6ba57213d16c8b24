"""The rig of the ASL layout: `sensor.yaml` of both cameras, and the rectification that they ask for.

`sensor.yaml` holds T_BS, which takes points of the camera to the body, the resolution, pinhole intrinsics (fu, fv, cu,
cv) and radial-tangential distortion (k1, k2, p1, p2).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.datasets.calibration import RectifiedRig, rectified_rig
from stereo_slam_env.datasets.image_files import MAX_PIXELS
from stereo_slam_env.datasets.sequence import Rectify
from stereo_slam_env.files.tables import first_line
from stereo_slam_env.files.text import read_text
from stereo_slam_env.recording.image_sequence import GreyImage


@dataclass(frozen=True, eq=False)
class Sensor:
    """What `sensor.yaml` says of a camera.

    Attributes
    ----------
    T_bs : (4, 4)
        Takes points from the camera to the body.
    K : (3, 3)
        Intrinsics, px.
    distortion : (4,)
        k1, k2, p1, p2.
    size : (int, int)
        Width and height, px.
    """

    T_bs: FloatArray
    K: FloatArray
    distortion: FloatArray
    size: tuple[int, int]


def read_sensor(path: Path) -> Sensor:
    """Read `sensor.yaml`.

    Raises
    ------
    ValueError
        An entry is missing, has the wrong size, or is of another camera model.
    """
    text = _text(path)
    for key, wanted in (("camera_model", "pinhole"), ("distortion_model", "radial-tangential")):
        found = re.search(rf"^{key}\s*:\s*(\S+)", text, re.MULTILINE)
        model = found[1].strip("\"'").replace("_", "-") if found else None
        if model is not None and model != wanted:
            raise ValueError(f"{path}: {key} is {model!r}, only {wanted!r} can be read")
    fu, fv, cu, cv = _numbers(path, text, "intrinsics", 4)
    width, height = (int(number) for number in _numbers(path, text, "resolution", 2))
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ValueError(f"{path}: resolution {width}x{height} is none of an image that is read: correct it")
    return Sensor(
        _parsed_transform(path, text),
        np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]]),
        _numbers(path, text, "distortion_coefficients", 4),
        (width, height),
    )


def read_transform(path: Path) -> FloatArray:
    """T_BS (4, 4) of a `sensor.yaml`; raises as `read_sensor`."""
    return _parsed_transform(path, _text(path))


def rectification(sensors: tuple[Sensor, Sensor], path: Path) -> tuple[RectifiedRig, FloatArray, Rectify]:
    """The rectified rig, R (3, 3) from the left camera of the file to it, and what rectifies a pair of images.

    Both eyes are turned to a common plane and freed of distortion; only pixels that exist are kept.

    Raises
    ------
    ValueError
        The eyes have different sizes or are not side by side; `path` is for the message.
    """
    left, right = sensors
    if left.size != right.size:
        raise ValueError(f"{path}: the images are {right.size}, those of the left camera {left.size}: not one rig")
    T_rl = np.linalg.solve(right.T_bs, left.T_bs)
    R_left, R_right, P_left, P_right = cv2.stereoRectify(
        left.K,
        left.distortion,
        right.K,
        right.distortion,
        left.size,
        T_rl[:3, :3],
        T_rl[:3, 3:],
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0,
    )[:4]
    rig = rectified_rig(path, np.asarray(P_left, np.float64), np.asarray(P_right, np.float64), left.size)
    maps = [
        cv2.initUndistortRectifyMap(sensor.K, sensor.distortion, R, P, sensor.size, cv2.CV_16SC2)
        for sensor, R, P in ((left, R_left, P_left), (right, R_right, P_right))
    ]

    def rectify(left_image: GreyImage, right_image: GreyImage) -> tuple[GreyImage, GreyImage]:
        turned = [
            np.asarray(cv2.remap(image, *both, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
            for image, both in zip((left_image, right_image), maps, strict=True)
        ]
        return turned[0], turned[1]

    return rig, np.asarray(R_left, dtype=np.float64), rectify


def _text(path: Path) -> str:
    """Content without comments."""
    return re.sub(r"#.*", "", read_text(path))


def _numbers(path: Path, text: str, key: str, count: int) -> FloatArray:
    found = re.search(rf"^{key}\s*:\s*\[([^\]]*)\]", text, re.MULTILINE)
    if found is None:
        raise ValueError(f"{path} lacks '{key}: [...]': take the calibration of this recording")
    return _parsed(path, found[1], key, count)


def _parsed_transform(path: Path, text: str) -> FloatArray:
    found = re.search(r"^T_BS\s*:[^\[]*\[([^\]]*)\]", text, re.MULTILINE)
    if found is None:
        raise ValueError(f"{path} lacks 'T_BS' with 'data: [...]': take the calibration of this recording")
    T = _parsed(path, found[1], "T_BS", 16).reshape(4, 4)
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        raise ValueError(f"{path}: T_BS holds no rotation: take the calibration of this recording")
    return T


def _parsed(path: Path, words: str, key: str, count: int) -> FloatArray:
    try:
        numbers = np.array([float(word) for word in words.replace(",", " ").split()])
    except ValueError as error:
        raise ValueError(f"{path}: '{key}' holds no numbers ({first_line(error)}): correct it") from error
    if numbers.size != count or not np.isfinite(numbers).all():
        raise ValueError(f"{path}: '{key}' has {numbers.size} numbers where {count} finite ones were expected")
    return numbers
