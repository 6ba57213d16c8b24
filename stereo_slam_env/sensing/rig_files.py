"""Calibrations of stereo rigs in the files of others: KITTI, EuRoC, Kalibr, ROS CameraInfo, OpenCV, VSLAM-LAB.

A calibration of rectified images gives the rig at once, one of raw images gives its rectification by OpenCV. A file of
one camera is read with that of the other, which stands beside it under the name that goes with the first: `cam0` and
`cam1`, `left` and `right`, `intrinsics` and `extrinsics`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from filters import StereoCamera
from filters.contract.validation import plain
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.files.opening import is_there, open_regular
from stereo_slam_env.sensing.calibration_entries import (
    Size,
    first_of,
    lens_of,
    numbers_of,
    size_of,
    table_of,
    transform_of,
)
from stereo_slam_env.sensing.lenses import (
    Lens,
    Rectification,
    rectification,
    stated_rectification,
)
from stereo_slam_env.sensing.projections import (
    entry,
    projections,
    read_entries,
    rectified_rig,
    require_baseline,
    require_principal_point,
)

Calibration = StereoCamera | Rectification
"""A rig whose images are rectified, or how raw ones are."""
LARGEST_SHIFT = 10.0
"""Of the clocks of a camera and an inertial unit, s."""
ENDINGS = (".txt", ".yaml", ".yml", ".json")
_PARTNERS = (("cam0", "cam1"), ("left", "right"), ("Left", "Right"), ("intrinsics", "extrinsics"), ("infra1", "infra2"))
_IN_FOLDERS = (
    *("calib.txt", "calib_cam_to_cam.txt", "mav0/cam0/sensor.yaml", "cam0/sensor.yaml", "calibration.yaml"),
    *("camchain*.yaml", "*-camchain*.yaml", "*imucam_chain*.yaml", "dso/camchain.yaml", "left.yaml", "intrinsics.yml"),
)
_SAME_POSE = 0.01
"""m and rad by which two poses of one file may differ: digits of a text, and calibrations in two steps."""
_TANGENTIAL, _RADIAL = 3e-3, 0.02
"""Largest tangential coefficients, and least first radial one, of a pinhole with four."""
_ORB_STEREO = ("Camera.bf", "Stereo.b", "Stereo.T_c1_c2")
_ORB_TYPES = ("PinHole", "Pinhole", "pinhole", "KannalaBrandt8", "Rectified", "not stated")
_ORB_LENS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_KNOWN = "KITTI calib.txt, EuRoC sensor.yaml, Kalibr camchain, ROS CameraInfo, OpenCV, ORB-SLAM or VSLAM-LAB yaml"


def is_calibration(name: str) -> bool:
    """Whether a name means a file or folder with a calibration, not a rig of our own."""
    return name.endswith(ENDINGS) or "/" in name or is_there(Path(name))


def read_calibration(path: str | Path, right: str | Path | None = None, size: Size | None = None) -> Calibration:
    """The calibration of a stereo rig by its file, or by the folder that holds it.

    Parameters
    ----------
    path : str or Path
        The file of both cameras, that of the left one, or a folder.
    right : str or Path, optional
        The file of the right camera; None: found beside the left one, where its file is of one camera.
    size : (int, int), optional
        Width and height of the images, px, for a file that does not say it.

    Returns
    -------
    StereoCamera or Rectification
        The rig of rectified images, or the rectification of raw ones, whose `camera` is the rig.

    Raises
    ------
    ValueError
        Missing, damaged, of another form, or no rig: one line that names the file.
    """
    file = _file_of(Path(path))
    if file.suffix == ".txt":
        return _kitti(file, size)
    table = table_of(file)
    for key, read in (("cam0", _kalibr), ("cameras", _vslam_lab)):
        if key in table:
            return read(file, table, size)
    if first_of(table, "M1", "K1", "cameraMatrix1", "LEFT.K", *_ORB_STEREO) is not None:
        return _opencv(file, _with_partner(file, right, table), size)
    for key, read_both in (("intrinsics", _euroc), ("camera_matrix", _camera_info)):
        if key in table:
            other = _partner(file, right)
            return read_both((file, other), (table, table_of(other)), size)
    raise ValueError(
        f"{file} holds no calibration that is known ({', '.join(map(plain, table)) or 'nothing'}): {_KNOWN}"
    )


def body_of_camera(path: Path) -> FloatArray:
    """T (4, 4) that takes points of a sensor, as mounted, to the body: T_BS, or T_imu_cam of cam0."""
    table = table_of(path)
    if "cam0" in table:
        return _of_kalibr(path, table, "cam0")
    if "cameras" in table:
        return transform_of(path, table["cameras"][0], "T_BS") if "T_BS" in table["cameras"][0] else np.eye(4)
    return transform_of(path, table, "T_BS")


def noise_of_unit(path: Path) -> tuple[float, float, float, float]:
    """Densities of gyros and accelerometers, and their walks, as of `InertialUnit`: EuRoC's and Kalibr's entries."""
    table = table_of(path)
    if isinstance(table.get("imu0"), dict):  # OpenVINS, and results of Kalibr
        table = table["imu0"]
    kinds = (
        "gyroscope_noise_density",
        "accelerometer_noise_density",
        "gyroscope_random_walk",
        "accelerometer_random_walk",
    )
    gyro, accelerometer, gyro_walk, accelerometer_walk = (float(numbers_of(path, table, kind, 1)[0]) for kind in kinds)
    return gyro, accelerometer, gyro_walk, accelerometer_walk


def imu_shift(path: str | Path) -> float:
    """Seconds to be added to times of the left camera for those of the inertial unit: Kalibr's `timeshift_cam_imu`.

    It stands with the entries of `cam0`, or in a file of one camera.
    """
    file = _file_of(Path(path))
    table = table_of(file) if file.suffix != ".txt" else {}
    camera = table.get("cam0", table)
    if not isinstance(camera, dict) or "timeshift_cam_imu" not in camera:
        return 0.0
    shift = float(numbers_of(file, camera, "timeshift_cam_imu", 1)[0])
    if abs(shift) > LARGEST_SHIFT:
        raise ValueError(f"{file}: timeshift_cam_imu is {shift:g} s: seconds are expected, is it in ms or ns?")
    return shift


def _file_of(path: Path) -> Path:
    if path.is_dir():
        files = [file for name in _IN_FOLDERS for file in sorted(path.glob(name))]
        if not files:
            raise ValueError(f"{path} holds no calibration ({', '.join(_IN_FOLDERS)}): name the file")
        return files[0]
    if not is_there(path):
        raise ValueError(f"{path} does not exist: give a calibration file ({_KNOWN})")
    return path


def _partner(file: Path, right: str | Path | None) -> Path:
    if right is not None:
        return _file_of(Path(right))
    for one, other in _PARTNERS:
        at = str(file).rfind(one)
        if at >= 0 and is_there(other_file := Path(str(file)[:at] + other + str(file)[at + len(one) :])):
            return other_file
    raise ValueError(f"{file} is of one camera, and none beside it is of the other: give both, left and right")


def _with_partner(file: Path, right: str | Path | None, table: dict[str, Any]) -> dict[str, Any]:
    """The entries of a file and of the one that goes with it, where there is one and it is needed."""
    if first_of(table, "R", "T", "Stereo.T_c1_c2", "Stereo.b", "Camera.bf", "RIGHT.P") is not None:
        return table
    return {**table_of(_partner(file, right)), **table}


def _kitti(path: Path, size: Size | None) -> StereoCamera:
    entries = read_entries(path)
    names = ("P_rect_00", "P_rect_01") if "P_rect_00" in entries else ("P0", "P1")
    P = projections(path, names)
    if size is None and "S_rect_00" in entries:
        width, height = entry(path, entries, "S_rect_00", (2,))
        size = int(width), int(height)
    if size is None:
        image = next((file for file in sorted(path.parent.glob("image_[02]/*.png"))), None)
        size = None if image is None else _png_size(image)
    if size is None:
        raise ValueError(f"{path} does not say the size of the images: give width and height with it")
    require_principal_point(path, P[0], size)
    return rectified_rig(path, *P, size)


def _png_size(path: Path) -> Size | None:
    with open_regular(path) as stream:
        head = stream.read(24)
    return (int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")) if len(head) == 24 else None


def _euroc(paths: tuple[Path, Path], tables: tuple[dict[str, Any], dict[str, Any]], size: Size | None) -> Calibration:
    lenses, poses = [], []
    for path, table in zip(paths, tables, strict=True):
        if (model := str(table.get("camera_model", "pinhole"))) != "pinhole":
            raise ValueError(f"{path}: camera_model is {plain(model)!r}, only 'pinhole' can be read")
        image_size = size_of(path, table, ("resolution",), size)
        of_lens = numbers_of(path, table, "distortion_coefficients")
        intrinsics = numbers_of(path, table, "intrinsics", 4)
        lenses.append(
            lens_of(path, intrinsics, image_size, of_lens, table.get("distortion_model", "radial-tangential"))
        )
        poses.append(transform_of(path, table, "T_BS"))
    return rectification(lenses[0], lenses[1], tuple((np.linalg.inv(poses[1]) @ poses[0]).ravel()), str(paths[1]))


def _kalibr(path: Path, table: dict[str, Any], size: Size | None) -> Calibration:
    lenses, poses = [], []
    for name in ("cam0", "cam1"):
        camera = table.get(name)
        if not isinstance(camera, dict):
            raise ValueError(f"{path} lacks '{name}': a camchain of two cameras is needed")
        if (model := str(camera.get("camera_model", "pinhole"))) != "pinhole":
            raise ValueError(f"{path}: camera_model is {plain(model)!r}, only 'pinhole' can be read")
        image_size = size_of(path, camera, ("resolution",), size)
        of_lens = numbers_of(path, camera, ("distortion_coeffs", "distortion_coefficients"))
        model = camera.get("distortion_model", "radtan")
        of_lens = of_lens[: 0 if model == "none" else None]
        lenses.append(lens_of(path, numbers_of(path, camera, "intrinsics", 4), image_size, of_lens, model))
        poses.append(camera)
    by_unit = [any(name in one for name in ("T_cam_imu", "T_imu_cam")) for one in poses]
    T_rl = transform_of(path, poses[1], "T_cn_cnm1") if "T_cn_cnm1" in poses[1] or not by_unit[1] else None
    if T_rl is None or all(by_unit):
        T_by_unit = np.linalg.inv(_of_kalibr(path, table, "cam1")) @ _of_kalibr(path, table, "cam0")
        if T_rl is not None and not np.allclose(T_rl, T_by_unit, atol=_SAME_POSE):
            apart = np.linalg.norm((T_rl - T_by_unit)[:3, 3])
            turned = np.degrees(np.linalg.norm(rotations.log(T_rl[:3, :3] @ T_by_unit[:3, :3].T)))
            message = (
                "T_cn_cnm1 and the poses of the cameras to the inertial unit contradict each other, "
                f"by {apart:.3g} m and {turned:.3g} degrees"
            )
            raise ValueError(f"{path}: {message}: one of them is inverted or of another calibration, so correct it")
        T_rl = T_by_unit if T_rl is None else T_rl
    return rectification(lenses[0], lenses[1], tuple(T_rl.ravel()), str(path))


def _of_kalibr(path: Path, table: Mapping[str, Any], name: str) -> FloatArray:
    """T_imu_cam (4, 4) of a camera, as OpenVINS writes it, or Kalibr's T_cam_imu inverted."""
    camera = table[name]
    if not isinstance(camera, dict):
        raise ValueError(f"{path} lacks '{name}': a camchain of two cameras is needed")
    if "T_imu_cam" in camera:
        return transform_of(path, camera, "T_imu_cam")
    return np.asarray(np.linalg.inv(transform_of(path, camera, "T_cam_imu")), dtype=np.float64)


def _vslam_lab(path: Path, table: dict[str, Any], size: Size | None) -> Calibration:
    cameras = table["cameras"]
    if not isinstance(cameras, list) or len(cameras) < 2 or not all(isinstance(one, dict) for one in cameras):
        raise ValueError(f"{path}: 'cameras' must list two cameras, left and right")
    lenses, poses = [], []
    for camera in cameras[:2]:
        image_size = size_of(path, camera, ("image_dimension",), size)
        focal = numbers_of(path, camera, "focal_length", 1, 2)
        intrinsics = np.concatenate([np.resize(focal, 2), numbers_of(path, camera, "principal_point", 2)])
        model = first_of(camera, "distortion_type", "cam_model") or "pinhole"
        of_lens = (
            numbers_of(path, camera, "distortion_coefficients") if "distortion_coefficients" in camera else np.empty(0)
        )
        lenses.append(lens_of(path, intrinsics, image_size, of_lens if of_lens.any() else np.empty(0), model))
        poses.append(transform_of(path, camera, "T_BS") if "T_BS" in camera else np.eye(4))
    return rectification(lenses[0], lenses[1], tuple((np.linalg.inv(poses[1]) @ poses[0]).ravel()), str(path))


def _camera_info(
    paths: tuple[Path, Path], tables: tuple[dict[str, Any], dict[str, Any]], size: Size | None
) -> Calibration:
    lenses, turns, P = [], [], []
    for path, table in zip(paths, tables, strict=True):
        image_size = size_of(path, table, (), size)
        of_lens = numbers_of(path, table, "distortion_coefficients")
        model = table.get("distortion_model", "plumb_bob")
        lenses.append(lens_of(path, numbers_of(path, table, "camera_matrix", 9), image_size, of_lens, model))
        turns.append(numbers_of(path, table, "rectification_matrix", 9).reshape(3, 3))
        P.append(numbers_of(path, table, "projection_matrix", 12).reshape(3, 4))
    return stated_rectification((lenses[0], lenses[1]), (turns[0], turns[1]), (P[0], P[1]), str(paths[1]))


def _opencv(path: Path, table: dict[str, Any], size: Size | None) -> Calibration:
    """Rig of OpenCV's stereo calibration (M1, D1, M2, D2, R, T), and ORB-SLAM's settings, raw or rectified."""
    of_image = ("image_size", "imageSize", "size", "resolution")
    for width, height in (("Camera.width", "Camera.height"), ("LEFT.width", "LEFT.height")):
        if size is None and width in table and height in table:
            size = int(numbers_of(path, table, width, 1)[0]), int(numbers_of(path, table, height, 1)[0])
    image_size = size_of(path, table, of_image, size)
    matrices = {"LEFT": ("M1", "K1", "cameraMatrix1", "LEFT.K"), "RIGHT": ("M2", "K2", "cameraMatrix2", "RIGHT.K")}
    lenses_of = {"LEFT": ("D1", "distCoeffs1", "LEFT.D"), "RIGHT": ("D2", "distCoeffs2", "RIGHT.D")}
    if first_of(table, *matrices["LEFT"]) is None:
        return _orb_slam(path, table, image_size)
    lenses = []
    for side, names in matrices.items():
        of_lens = numbers_of(path, table, lenses_of[side])
        model = _opencv_model(path, table, of_lens)
        of_lens = of_lens if of_lens.any() else np.empty(0)
        lenses.append(lens_of(path, numbers_of(path, table, names, 9), image_size, of_lens, model))
    if "LEFT.P" in table:
        turns = [numbers_of(path, table, name, 9).reshape(3, 3) for name in ("LEFT.R", "RIGHT.R")]
        P = [numbers_of(path, table, name, 12).reshape(3, 4) for name in ("LEFT.P", "RIGHT.P")]
        return stated_rectification((lenses[0], lenses[1]), (turns[0], turns[1]), (P[0], P[1]), str(path))
    T_rl = np.eye(4)
    T_rl[:3, :3] = numbers_of(path, table, "R", 9).reshape(3, 3)
    T_rl[:3, 3] = numbers_of(path, table, "T", 3)
    return rectification(lenses[0], lenses[1], tuple(T_rl.ravel()), str(path))


def _opencv_model(path: Path, table: Mapping[str, Any], of_lens: FloatArray) -> str:
    """The lens model of OpenCV's coefficients: as the file says it, or by their number and size.

    The pinhole calibration writes 5 or more, the fisheye one 4. Where a file has 4 of a pinhole, the last two are
    tangential, thousandths, and the first is not.
    """
    model = first_of(table, "distortion_model", "camera_model", "model")
    if model is not None:
        return plain(str(model))
    flag = first_of(table, "fisheye_model", "fisheye", "is_fisheye")
    if flag is not None:
        return "fisheye" if str(flag).strip().lower() in ("1", "1.0", "true", "yes") else ""
    if of_lens.size != 4 or not of_lens.any():
        return ""
    last = np.abs(of_lens[2:]).max()
    if last <= _TANGENTIAL and abs(of_lens[0]) >= _RADIAL:
        return ""
    if last > _TANGENTIAL:
        return "fisheye"
    raise ValueError(
        f"{path}: four coefficients {of_lens.tolist()} may be a fisheye's (k1 to k4) or a pinhole's (k1, k2, p1, p2): "
        "write 'fisheye_model: 1' or 'fisheye_model: 0' into it"
    )


def _orb_slam(path: Path, table: dict[str, Any], size: Size) -> Calibration:
    """Settings of rectified images, Camera.fx ... and Camera.bf (px m) or Stereo.b (m); or of two raw cameras."""
    kind = str(table.get("Camera.type", "not stated"))
    if kind not in _ORB_TYPES:
        raise ValueError(f"{path}: Camera.type {plain(kind)!r} is not read: PinHole, KannalaBrandt8 and Rectified are")
    prefix = "Camera1" if "Camera1.fx" in table else "Camera"
    if kind != "Rectified" and "Stereo.T_c1_c2" in table:
        left, right = (_orb_lens(path, table, one, kind, size) for one in ("Camera1", "Camera2"))
        return rectification(
            left, right, tuple(np.linalg.inv(transform_of(path, table, "Stereo.T_c1_c2")).ravel()), str(path)
        )
    fx, fy, cx, cy = (float(numbers_of(path, table, f"{prefix}.{name}", 1)[0]) for name in ("fx", "fy", "cx", "cy"))
    bf = table.get("Camera.bf")
    baseline = (
        numbers_of(path, table, "Stereo.b", 1)[0] if bf is None else numbers_of(path, table, "Camera.bf", 1)[0] / fx
    )
    bent = [f"{prefix}.{name}" for name in _ORB_LENS if table.get(f"{prefix}.{name}")]
    if bent and kind != "Rectified":
        raise ValueError(
            f"{path}: {bent[0]} is a distortion of raw images, and Camera.type is {plain(kind)}, not Rectified: give "
            "Kalibr's or OpenCV's file of both cameras"
        )
    if kind == "KannalaBrandt8":
        raise ValueError(f"{path}: Camera.type KannalaBrandt8 is of raw images: give both cameras, with Stereo.T_c1_c2")
    require_baseline(path, float(baseline))
    return StereoCamera(fx, fy, cx, cy, float(baseline), *size)


def _orb_lens(path: Path, table: dict[str, Any], camera: str, kind: str, size: Size) -> Lens:
    """One of two raw cameras of ORB-SLAM3."""
    K = np.concatenate([numbers_of(path, table, f"{camera}.{name}", 1) for name in ("fx", "fy", "cx", "cy")])
    fisheye = kind == "KannalaBrandt8"
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    of_lens = [
        float(numbers_of(path, table, f"{camera}.{n}", 1)[0]) if f"{camera}.{n}" in table else 0.0 for n in names
    ]
    of_lens = of_lens if any(of_lens[5:]) else of_lens[:5]
    return lens_of(path, K, size, np.array(of_lens), "fisheye" if fisheye else "")
