"""One stereo rig, raw, written in every calibration format: all give the same rectified rig (3 s)."""

from dataclasses import asdict

import cv2
import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.cli import app as cli
from stereo_slam_env.cli.shared_options import rig_from
from stereo_slam_env.sensing.lenses import Rectification
from stereo_slam_env.sensing.rig_files import body_of_camera, noise_of_unit, read_calibration
from stereo_slam_env.sensing.rigs import RIGS, calibration_of, camera_of, imu_shift_of

SIZE = (640, 400)
K = [
    np.array([[400.0, 0, 315.0], [0, 401.0, 205.0], [0, 0, 1.0]]),
    np.array([[403.0, 0, 322.0], [0, 402.0, 198.0], [0, 0, 1.0]]),
]
D = [np.array([-0.2, 0.05, 3e-4, -2e-4]), np.array([-0.21, 0.06, -1e-4, 1e-4])]
T_RL = np.eye(4)
"""Takes points of the left camera to the right one: 12 cm, and a degree askew."""
T_RL[:3, :3] = Rotation.from_rotvec([0.01, -0.015, 0.008]).as_matrix()
T_RL[:3, 3] = [-0.12, 0.001, -0.002]
T_BL = np.eye(4)
T_BL[:3, :3], T_BL[:3, 3] = Rotation.from_rotvec([0.3, 1.2, -0.4]).as_matrix(), [0.1, -0.2, 0.3]
T_BR = T_BL @ np.linalg.inv(T_RL)
R0, R1, P0, P1 = cv2.stereoRectify(
    K[0], D[0], K[1], D[1], SIZE, T_RL[:3, :3], T_RL[:3, 3:], flags=cv2.CALIB_ZERO_DISPARITY, alpha=0
)[:4]


def row(numbers):
    return "[" + ", ".join(f"{float(x):.15g}" for x in np.ravel(numbers)) + "]"


def four(k):
    return row([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])


def matrix(name, numbers, tag=""):
    rows, columns = np.atleast_2d(numbers).shape
    return f"{name}:{tag}\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: {row(numbers)}\n"


def euroc(folder):
    for name, T, k, d in (("cam0", T_BL, K[0], D[0]), ("cam1", T_BR, K[1], D[1])):
        (folder / name).mkdir()
        (folder / name / "sensor.yaml").write_text(
            f"#{name}\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: {row(T)}\nresolution: {list(SIZE)}\n"
            f"camera_model: pinhole\nintrinsics: {four(k)} #fu, fv, cu, cv\ndistortion_model: radial-tangential\n"
            f"distortion_coefficients: {row(d)}\n"
        )
    return folder / "cam0" / "sensor.yaml"


def kalibr(folder):
    T = "".join(f"  - {row(numbers)}\n" for numbers in T_RL)
    text = ""
    for name, k, d in (("cam0", K[0], D[0]), ("cam1", K[1], D[1])):
        text += f"{name}:\n" + (f"  T_cn_cnm1:\n{T}" if name == "cam1" else "")
        text += f"  camera_model: pinhole\n  distortion_coeffs: {row(d)}\n  distortion_model: radtan\n"
        text += f"  intrinsics: {four(k)}\n  resolution: {list(SIZE)}\n"
    (folder / "camchain-mine.yaml").write_text(text)
    return folder / "camchain-mine.yaml"


def camera_info(folder):
    for name, k, d, R, P in (("left", K[0], D[0], R0, P0), ("right", K[1], D[1], R1, P1)):
        text = f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_name: {name}\n" + matrix("camera_matrix", k)
        text += "distortion_model: plumb_bob\n" + matrix("distortion_coefficients", d)
        (folder / f"{name}.yaml").write_text(text + matrix("rectification_matrix", R) + matrix("projection_matrix", P))
    return folder / "left.yaml"


def opencv(folder):
    """As OpenCV's own sample of stereo calibration leaves them: two files, no size of the images."""
    tag = " !!opencv-matrix"
    both = zip(("M1", "D1", "M2", "D2"), (K[0], D[0], K[1], D[1]), strict=True)
    text = "%YAML:1.0\n---\n" + "".join(matrix(name, numbers, tag) for name, numbers in both)
    (folder / "intrinsics.yml").write_text(text)
    text = "%YAML:1.0\n---\n" + matrix("R", T_RL[:3, :3], tag) + matrix("T", T_RL[:3, 3:], tag)
    (folder / "extrinsics.yml").write_text(text)
    return {"name": str(folder / "intrinsics.yml"), "width": SIZE[0], "height": SIZE[1]}


def vslam_lab(folder):
    text = "cameras:\n"
    for name, T, k, d in (("rgb_0", T_BL, K[0], D[0]), ("rgb_1", T_BR, K[1], D[1])):
        text += f"  - cam_name: {name}\n    cam_model: radtan4\n    focal_length: {row([k[0, 0], k[1, 1]])}\n"
        text += f"    principal_point: {row([k[0, 2], k[1, 2]])}\n    distortion_coefficients: {row(d)}\n"
        text += f"    image_dimension: {list(SIZE)}\n    fps: 20.0\n    T_BS: {row(T)}\n"
    (folder / "calibration.yaml").write_text(text)
    return folder


FORMATS = {maker.__name__: maker for maker in (euroc, kalibr, camera_info, opencv, vslam_lab)}


def rig_in(folder, name):
    rig = FORMATS[name](folder)
    return rig if isinstance(rig, dict) else str(rig)


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_rig_and_the_images_that_opencv_rectifies_it_to(tmp_path, name):
    rig = rig_in(tmp_path, name)
    camera, rectify = camera_of(rig), calibration_of(rig)
    assert (camera.width, camera.height) == SIZE
    found = [camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline]
    wanted = [P0[0, 0], P0[1, 1], P0[0, 2], P0[1, 2], np.linalg.norm(T_RL[:3, 3])]
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    assert isinstance(rectify, Rectification)
    np.testing.assert_allclose(rectify.R_left, R0, atol=1e-9)
    images = np.random.default_rng(0).integers(0, 255, (2, *SIZE[::-1]), dtype=np.uint8)
    for image, k, d, R, P, mine in zip(images, K, D, (R0, R1), (P0, P1), rectify(*images), strict=True):
        maps = cv2.initUndistortRectifyMap(k, d, R, P, SIZE, cv2.CV_16SC2)
        theirs = cv2.remap(image, *maps, cv2.INTER_LINEAR)
        assert (np.abs(mine.astype(int) - theirs) <= 1).mean() > 0.999  # 15 digits in a file


@pytest.mark.parametrize("sized", [True, False])
def test_matrices_of_orb_slam_2_are_those_of_its_rectification(tmp_path, sized):
    """`EuRoC.yaml`: K, D, R and P of both cameras; the size is that of the file, or is given beside it."""
    text = f"%YAML:1.0\n---\nLEFT.width: {SIZE[0]}\nLEFT.height: {SIZE[1]}\n" if sized else "%YAML:1.0\n---\n"
    for side, k, d, R, P in (("LEFT", K[0], D[0], R0, P0), ("RIGHT", K[1], D[1], R1, P1)):
        for name, numbers in (("K", k), ("D", d), ("R", R), ("P", P)):
            text += matrix(f"{side}.{name}", numbers, " !!opencv-matrix")
    (tmp_path / "EuRoC.yaml").write_text(text)
    size = {} if sized else {"width": SIZE[0], "height": SIZE[1]}
    rectify = calibration_of({"name": str(tmp_path / "EuRoC.yaml"), **size})
    assert isinstance(rectify, Rectification)
    assert (rectify.camera.width, rectify.camera.height) == SIZE
    for found, wanted in zip((*rectify.turns, *rectify.projections), (R0, R1, P0, P1), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12)


def test_the_maps_are_made_once(tmp_path):
    path = kalibr(tmp_path)
    assert read_calibration(path) is read_calibration(path)


def test_numbers_beside_a_file_take_the_place_of_its_own_and_both_files_can_be_named(tmp_path):
    path = kalibr(tmp_path)
    assert camera_of({"name": str(path), "baseline": 0.3}).baseline == 0.3
    left = camera_info(tmp_path)
    right = (tmp_path / "right.yaml").rename(tmp_path / "other.yaml")
    with pytest.raises(ValueError, match=r"left\.yaml is of one camera, and none beside it is of the other"):
        camera_of(str(left))
    both = rig_from(f"left={left},right={right}")
    assert camera_of(both).baseline == pytest.approx(np.linalg.norm(T_RL[:3, 3]), rel=1e-9)


# --- fields that are read are used, or refused -----------------------------------------------------------------------


def kalibr_by_unit(folder, name="T_cam_imu", shift=None):
    """As Kalibr (T_cam_imu) and OpenVINS (T_imu_cam) write the poses of both cameras to the inertial unit."""
    text = "%YAML:1.0\n\n"
    for camera, k, d, T in (("cam0", K[0], D[0], T_BL), ("cam1", K[1], D[1], T_BR)):
        T = T if name == "T_imu_cam" else np.linalg.inv(T)
        text += f"{camera}:\n  {name}:\n" + "".join(f"    - {row(numbers)}\n" for numbers in T)
        text += f"  camera_model: pinhole\n  distortion_coeffs: {row(d)}\n  distortion_model: radtan\n"
        text += f"  intrinsics: {four(k)}\n  resolution: {list(SIZE)}\n"
        text += "" if shift is None else f"  timeshift_cam_imu: {shift}\n"
    path = folder / "kalibr_imucam_chain.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", ["T_cam_imu", "T_imu_cam"])
def test_poses_to_the_inertial_unit_are_read_in_both_directions(tmp_path, name):
    path = kalibr_by_unit(tmp_path, name)
    assert camera_of(str(path)).baseline == pytest.approx(np.linalg.norm(T_RL[:3, 3]), rel=1e-9)
    np.testing.assert_allclose(calibration_of(str(tmp_path)).R_left, R0, atol=1e-9)
    np.testing.assert_allclose(body_of_camera(path), T_BL, atol=1e-12)


def test_the_clock_of_the_inertial_unit_is_read(tmp_path):
    assert imu_shift_of(str(kalibr_by_unit(tmp_path))) == 0.0
    assert imu_shift_of(str(kalibr_by_unit(tmp_path, shift=0.05))) == 0.05
    assert imu_shift_of({"name": str(tmp_path), "baseline": 0.2}) == 0.05
    assert imu_shift_of("vga") == 0.0


def opencv_lens(folder, lens, more=""):
    D_file = "".join(f"D{n}: {row(lens)}\n" for n in (1, 2))
    K_file = "".join(matrix(f"K{n + 1}", K[n]) for n in (0, 1))
    path = folder / "stereo.yml"
    rest = f"image_size: {list(SIZE)}\nT: [-0.12, 0.0, 0.0]\n"
    path.write_text("%YAML:1.0\n---\n" + K_file + D_file + matrix("R", np.eye(3)) + rest + more)
    return str(path)


@pytest.mark.parametrize(
    ("lens", "more", "model"),
    [
        ([-0.0091, 0.0437, -0.0412, 0.0072], "", "equidistant"),
        ([-0.0022, 0.0378, -0.0358, 0.0058], "", "equidistant"),
        ([-0.2, 0.05, 3e-4, -2e-4], "", "radial-tangential"),
        ([-0.2, 0.05, 3e-4, -2e-4], "fisheye_model: 1\n", "equidistant"),
        ([-0.01, 0.02, 0.001, -0.001], "fisheye_model: 0\n", "radial-tangential"),
        ([-0.01, 0.02, 0.001, -0.001], "distortion_model: equidistant\n", "equidistant"),
        ([-0.2, 0.05, 3e-4, -2e-4, 0.01], "", "radial-tangential"),
    ],
)
def test_the_model_of_opencvs_coefficients_is_that_of_its_calibration(tmp_path, lens, more, model):
    found = calibration_of(opencv_lens(tmp_path, lens, more))
    assert [one.model for one in found.lenses] == [model] * 2


def test_four_coefficients_that_may_be_of_either_model_are_asked_for(tmp_path):
    with pytest.raises(ValueError, match=r"may be a fisheye's .* or a pinhole's .* write 'fisheye_model: 1'"):
        camera_of(opencv_lens(tmp_path, [-0.01, 0.02, 0.001, -0.001]))


def orb_slam(folder, more):
    numbers = {"fx": 512.3, "fy": 513.1, "cx": 318.6, "cy": 200.3}
    entries = {f"Camera.{key}": value for key, value in numbers.items()}
    entries |= {"Camera.width": SIZE[0], "Camera.height": SIZE[1], "Camera.bf": 40.0, **more}
    path = folder / "settings.yaml"
    path.write_text("%YAML:1.0\n" + "".join(f"{key}: {value}\n" for key, value in entries.items()))
    return str(path)


@pytest.mark.parametrize("name", ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"])
def test_a_distortion_beside_one_camera_of_orb_slam_is_refused(tmp_path, name):
    with pytest.raises(ValueError, match=rf"Camera\.{name} is a distortion of raw images, and Camera.type is not"):
        camera_of(orb_slam(tmp_path, {f"Camera.{name}": 0.2}))
    assert camera_of(orb_slam(tmp_path, {f"Camera.{name}": 0.0})).fx == 512.3
    assert camera_of(orb_slam(tmp_path, {f"Camera.{name}": 0.2, "Camera.type": '"Rectified"'})).fx == 512.3
    for kind in ("Mei", "pinhole8", "kannalabrandt8"):
        with pytest.raises(ValueError, match=f"Camera.type '{kind}' is not read: PinHole, KannalaBrandt8 and Rect"):
            camera_of(orb_slam(tmp_path, {"Camera.type": kind}))


def test_two_raw_cameras_of_orb_slam_3_are_rectified(tmp_path):
    text = f'%YAML:1.0\nCamera.type: "PinHole"\nCamera.width: {SIZE[0]}\nCamera.height: {SIZE[1]}\n'
    for n, (k, d) in enumerate(zip(K, D, strict=True), start=1):
        numbers = dict(zip(("fx", "fy", "cx", "cy"), (k[0, 0], k[1, 1], k[0, 2], k[1, 2]), strict=True))
        numbers |= dict(zip(("k1", "k2", "p1", "p2"), d, strict=True))
        text += "".join(f"Camera{n}.{key}: {value:.17g}\n" for key, value in numbers.items())
    (tmp_path / "euroc.yaml").write_text(text + matrix("Stereo.T_c1_c2", np.linalg.inv(T_RL), " !!opencv-matrix"))
    found = calibration_of(str(tmp_path / "euroc.yaml"))
    np.testing.assert_allclose(found.R_left, R0, atol=1e-9)
    assert found.camera.fx == pytest.approx(P0[0, 0], rel=1e-9)
    rational = "".join(f"Camera{n}.{name}: {0.01 * n}\n" for n in (1, 2) for name in ("k3", "k4", "k5", "k6"))
    (tmp_path / "rational.yaml").write_text((tmp_path / "euroc.yaml").read_text() + rational)
    for n, (lens, d) in enumerate(zip(calibration_of(str(tmp_path / "rational.yaml")).lenses, D, strict=True), start=1):
        np.testing.assert_allclose(lens.coefficients, [*d[:4], *[0.01 * n] * 4])  # OpenCV's order


def placed(translation):
    T = T_RL.copy()
    T[:3, 3] = translation
    return T


BETWEEN = [
    (np.eye(4), r"both cameras are in one place, T is zero: [^\n]+\Z"),
    (np.linalg.inv(T_RL), r"baseline is -.* or is the transform between them inverted\?"),
    (placed([0.001, -0.12, 0.0]), r"the right camera is \+0\.12 m below .* a vertical pair"),
    (placed(1e3 * T_RL[:3, 3]), r"the baseline is [\d.]+ m: metres are expected.*, is it in mm \(0\.12 m\)"),
    (placed(1e2 * T_RL[:3, 3]), r"the baseline is [\d.]+ m: metres are expected.*, is it in cm \(0\.12 m\)"),
    (placed(1e-2 * T_RL[:3, 3]), r"the baseline is [\d.]+ m: metres are expected.*, and -fx b"),
]


@pytest.mark.parametrize("name", sorted({*FORMATS} - {"camera_info"}))
@pytest.mark.parametrize(("T", "complaint"), BETWEEN, ids=["one place", "inverted", "vertical", "mm", "cm", "100 m"])
def test_a_transform_of_no_horizontal_pair_is_refused_with_its_reason(tmp_path, name, T, complaint, monkeypatch):
    for what, value in (("T_RL", T), ("T_BR", T_BL @ np.linalg.inv(T))):
        monkeypatch.setitem(globals(), what, value)
    with pytest.raises(ValueError, match=complaint):
        camera_of(rig_in(tmp_path, name))


def test_poses_of_kalibr_that_contradict_each_other_are_refused(tmp_path):
    text = kalibr_by_unit(tmp_path).read_text()
    for T, contradicts in ((T_RL, False), (np.linalg.inv(T_RL), True), (T_RL @ T_RL, True)):
        both = text + "  T_cn_cnm1:\n" + "".join(f"    - {row(numbers)}\n" for numbers in T)
        (tmp_path / "both.yaml").write_text(both)
        if contradicts:
            with pytest.raises(ValueError, match=r"T_cn_cnm1 and the poses .* contradict each other, by "):
                camera_of(str(tmp_path / "both.yaml"))
        else:
            assert camera_of(str(tmp_path / "both.yaml")).baseline == pytest.approx(np.linalg.norm(T_RL[:3, 3]))


@pytest.mark.parametrize("half_angle", [60, 80, 88, 95])
def test_a_wide_fisheye_is_rectified_to_a_plane_that_is_of_use(tmp_path, caplog, half_angle):
    """Its middle keeps its resolution, and its rows agree."""
    width, height = 848, 800
    f = 0.5 * width / np.deg2rad(half_angle)
    camera = (
        "  camera_model: pinhole\n  distortion_model: equidistant\n  distortion_coeffs: [0.001, -0.002, 0.001, 0.0]\n"
    )
    camera += f"  intrinsics: [{f}, {f}, 425.0, 397.4]\n  resolution: [{width}, {height}]\n"
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec([0.002, 0.005, 0.003]).as_matrix(), [-0.064, 0.0001, 0.0004]
    T_text = "".join(f"  - {row(numbers)}\n" for numbers in T)
    (tmp_path / "camchain.yaml").write_text(f"cam0:\n{camera}cam1:\n  T_cn_cnm1:\n{T_text}{camera}")
    with caplog.at_level("WARNING"):
        found = calibration_of(str(tmp_path / "camchain.yaml"))
    rig = found.camera
    assert 0.3 * f < rig.fx <= 1.01 * f
    assert rig.baseline == pytest.approx(np.linalg.norm(T[:3, 3]), rel=1e-6)
    assert ("too wide for a plane" in caplog.text) == (rig.fx == f)
    point, both = np.array([0.3, -0.2, 2.0]), []
    for turn, t, lens in zip(found.turns, (np.zeros(3), T[:3, 3]), found.lenses, strict=True):
        seen = (T[:3, :3] @ point if t.any() else point) + t
        raw = cv2.fisheye.projectPoints(seen[None, None], np.zeros(3), np.zeros(3), lens.K, lens.coefficients)[0]
        flat = cv2.fisheye.undistortPoints(raw, lens.K, lens.coefficients, R=turn, P=found.projections[0][:, :3])
        both.append(flat.ravel())
    assert both[0][1] == pytest.approx(both[1][1], abs=0.01)
    assert both[0][0] > both[1][0]


HOSTILE = {
    "empty.yaml": ("", "holds no entries"),
    "list.yaml": ("- 1\n- 2\n", "holds no entries"),
    "deep.yaml": ("[" * 5000, "is no YAML"),
    "code.yaml": ("!!python/object/apply:os.system ['true']\n", "is no YAML"),
    "words.yaml": (
        "cam0: {intrinsics: [a, b, c, d], resolution: [640, 400]}\ncam1: {}\n",
        "'intrinsics' holds no numbers|lacks",
    ),
    "nan.yaml": ("cam0: {intrinsics: [.nan, 1, 2, 3], resolution: [640, 400]}\ncam1: {}\n", "finite|lacks"),
    "flat.yaml": ("cam0: 7\ncam1: 8\n", "lacks 'cam0': a camchain of two cameras"),
    "huge.yaml": ("a: " + "1" * 400_000, "more than 300000"),
    "other.yaml": ("colour: blue\n", "holds no calibration that is known"),
    "numbers.txt": ("P0: 1 2 3\n", "has 3 numbers where 12"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_file_that_is_none_is_refused_in_one_line_with_exit_code_2(tmp_path, name, capsys):
    content, complaint = HOSTILE[name]
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match=complaint) as error:
        camera_of(str(tmp_path / name))
    assert "\n" not in str(error.value)
    assert cli.main(["scenes", "noise", "right-turn", "--rig", str(tmp_path / name)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_an_environment_takes_a_file_and_stores_its_numbers(tmp_path):
    path = kalibr(tmp_path)
    with gym.make("StereoSlam/Drive-v0", rig=str(path)) as env:
        assert env.unwrapped.camera == camera_of(str(path))
        assert env.unwrapped.options.as_dict()["rig"] == asdict(camera_of(str(path)))


@pytest.mark.parametrize("name", RIGS)
def test_every_rig_by_name_can_be_driven(name):
    with gym.make("StereoSlam/Drive-v0", rig=name, route="right-turn") as env:
        observation, _ = env.reset(seed=0)
        assert observation["mask"].sum() > 20


def test_the_densities_of_an_inertial_unit_are_read_in_their_order(tmp_path):
    kinds = ("gyroscope_noise_density", "accelerometer_noise_density", "gyroscope_random_walk")
    sheet = tmp_path / "imu.yaml"
    entries = dict(zip((*kinds, "accelerometer_random_walk"), (1e-4, 2e-3, 3e-5, 4e-3), strict=True))
    sheet.write_text("".join(f"{name}: {value}\n" for name, value in entries.items()))
    assert noise_of_unit(sheet) == (1e-4, 2e-3, 3e-5, 4e-3)
