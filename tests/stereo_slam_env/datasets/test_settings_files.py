"""Settings for other programs state the rig and the noise of the simulation, each in its own words (3 s)."""

import json
import re

import cv2
import numpy as np
import pytest
import yaml

from filters import InertialUnit, StereoCamera
from filters.geometry import rotations
from stereo_slam_env.datasets.settings_files import Topics, readme, settings_files
from stereo_slam_env.sensing.lenses import Rectification
from stereo_slam_env.sensing.rig_files import body_of_camera, imu_shift, noise_of_unit, read_calibration
from stereo_slam_env.sensing.sensor_suite import SensorSuite

CAMERA = StereoCamera(461.3, 461.3, 322.7, 238.1, 0.1234, 640, 480)
UNIT = InertialUnit([0.05, -0.1, 0.2], rotations.exp_quaternion([0.5, -1.3, 0.2]), 1.7e-4, 2.0e-3, 1e-5, 3.0e-3)
RATE, OFFSET = 200.0, -0.0037
ODOMETRY = np.diag([0.01, 0.02, 0.03, 1e-5, 2e-5, 3e-5])
SUITE = SensorSuite(CAMERA, 20.0, UNIT, RATE, OFFSET, odometry=ODOMETRY)
BARE = SensorSuite(CAMERA, 20.0)
TOPICS = Topics(left_image="/rig/left", imu="/rig/inertial")
OPENCV = ("openvins/", "vins_fusion/", "orb_slam3/")
"""Programs that read by OpenCV's FileStorage."""


def exact(value):
    return pytest.approx(value, abs=1e-9, rel=1e-9)


def T(pose):
    return np.block([[pose.R_wc, pose.position[:, None]], [np.zeros((1, 3)), 1.0]])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("settings")
    for name, text in settings_files(SUITE, "town 3", TOPICS).items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return folder


@pytest.fixture
def opened(folder):
    """A file of a program that reads by OpenCV, as it reads it."""
    files = []

    def opened(name):
        files.append(cv2.FileStorage(str(folder / name), cv2.FILE_STORAGE_READ))
        assert files[-1].isOpened()
        return files[-1]

    yield opened
    for file in files:
        file.release()


def test_there_are_settings_for_six_programs(folder):
    assert sorted(str(path.relative_to(folder)) for path in folder.rglob("*.*")) == [
        "basalt/calibration.json",
        *("kalibr/camchain.yaml", "kalibr/imu.yaml"),
        *("openvins/estimator_config.yaml", "openvins/kalibr_imu_chain.yaml", "openvins/kalibr_imucam_chain.yaml"),
        *("orb_slam3/stereo.yaml", "orb_slam3/stereo_inertial.yaml"),
        *("ros/left.yaml", "ros/odometry.yaml", "ros/right.yaml"),
        *("vins_fusion/cam0.yaml", "vins_fusion/cam1.yaml"),
        *("vins_fusion/stereo_config.yaml", "vins_fusion/stereo_imu_config.yaml"),
    ]


@pytest.mark.parametrize(
    "name",
    [
        *("kalibr/camchain.yaml", "openvins/kalibr_imucam_chain.yaml", "ros/left.yaml"),
        *("orb_slam3/stereo.yaml", "orb_slam3/stereo_inertial.yaml"),
    ],
)
def test_the_rig_is_read_back(folder, name):
    read = read_calibration(folder / name)
    assert isinstance(read, Rectification)
    for entry in ("fx", "fy", "cx", "cy", "baseline", "width", "height"):
        assert getattr(read.camera, entry) == exact(getattr(CAMERA, entry))
    assert not read.needed


def test_the_pose_of_the_unit_its_noise_and_its_clock_are_read_back(folder):
    for name in ("kalibr/camchain.yaml", "openvins/kalibr_imucam_chain.yaml"):
        assert body_of_camera(folder / name) == exact(T(SUITE.T_bc))
        assert imu_shift(folder / name) == OFFSET
    for name in ("kalibr/imu.yaml", "openvins/kalibr_imu_chain.yaml"):
        noise = UNIT.gyro_density, UNIT.accelerometer_density, UNIT.gyro_walk, UNIT.accelerometer_walk
        assert noise_of_unit(folder / name) == noise


def test_a_true_point_has_the_pixels_that_kalibr_gives_it(folder):
    """By the matrices of the file alone: from the unit to both cameras."""
    chain = yaml.safe_load((folder / "kalibr/camchain.yaml").read_text())
    p_c = np.array([0.4, -0.3, 5.0])
    p_b = SUITE.T_bc @ p_c
    in_left = np.array(chain["cam0"]["T_cam_imu"]) @ [*p_b, 1.0]
    in_right = np.array(chain["cam1"]["T_cam_imu"]) @ [*p_b, 1.0]
    assert in_left[:3] == exact(p_c)
    assert np.array(chain["cam1"]["T_cn_cnm1"]) @ in_left == exact(in_right)
    u, _, d = CAMERA.project(p_c)
    assert CAMERA.fx * in_right[0] / in_right[2] + CAMERA.cx == exact(u - d)


def test_yaml_has_numbers_where_numbers_are_meant(folder):
    """YAML takes 1e-05 for a word."""
    imu = yaml.safe_load((folder / "kalibr/imu.yaml").read_text())
    assert imu.pop("rostopic") == "/rig/inertial"
    assert {type(value) for value in imu.values()} == {float}
    assert imu["gyroscope_random_walk"] == 1e-5


def test_every_file_is_read_by_the_parser_of_its_program(folder, opened):
    for path in folder.rglob("*.yaml"):
        name = path.relative_to(folder).as_posix()
        if name.startswith(OPENCV):
            assert path.read_text().startswith("%YAML:1.0\n")
            assert opened(name).root().keys()
        else:
            assert isinstance(yaml.safe_load(path.read_text()), dict)


def test_vins_fusion_takes_the_deviation_of_one_sample(opened):
    file = opened("vins_fusion/stereo_imu_config.yaml")
    root = np.sqrt(RATE)
    assert file.getNode("acc_n").real() == exact(UNIT.accelerometer_density * root)
    assert file.getNode("gyr_n").real() == exact(UNIT.gyro_density * root)
    assert file.getNode("acc_w").real() == exact(UNIT.accelerometer_walk * root)
    assert file.getNode("gyr_w").real() == exact(UNIT.gyro_walk * root)
    assert file.getNode("g_norm").real() == exact(9.81)
    assert file.getNode("td").real() == OFFSET
    assert file.getNode("body_T_cam0").mat() == exact(T(SUITE.T_bc))
    assert file.getNode("body_T_cam1").mat() == exact(T(SUITE.T_br))
    assert file.getNode("image0_topic").string() == "/rig/left"
    lens = opened("vins_fusion/cam1.yaml").getNode("projection_parameters")
    assert [lens.getNode(name).real() for name in ("fx", "fy", "cx", "cy")] == [461.3, 461.3, 322.7, 238.1]


def test_orb_slam3_takes_densities_and_numbers_of_its_types(opened):
    file = opened("orb_slam3/stereo_inertial.yaml")
    assert file.getNode("File.version").string() == "1.0"
    assert file.getNode("IMU.NoiseGyro").real() == UNIT.gyro_density
    assert file.getNode("IMU.NoiseAcc").real() == UNIT.accelerometer_density
    assert file.getNode("IMU.GyroWalk").real() == UNIT.gyro_walk
    assert file.getNode("IMU.AccWalk").real() == UNIT.accelerometer_walk
    assert file.getNode("IMU.Frequency").real() == RATE
    assert file.getNode("IMU.T_b_c1").mat() == pytest.approx(T(SUITE.T_bc), abs=1e-7)
    assert file.getNode("Stereo.T_c1_c2").mat()[0, 3] == pytest.approx(CAMERA.baseline)
    for name in ("Camera.width", "Camera.height", "Camera.fps", "Camera.RGB", "ORBextractor.nFeatures"):
        assert file.getNode(name).isInt()
    for name in ("Camera1.fx", "Camera2.cy", "Stereo.ThDepth", "Viewer.PointSize", "IMU.GyroWalk"):
        assert file.getNode(name).isReal()


def test_openvins_knows_all_and_estimates_no_calibration(opened):
    file = opened("openvins/estimator_config.yaml")
    calibrated = [key for key in file.root().keys() if key.startswith("calib_")]  # noqa: SIM118
    assert len(calibrated) == 5
    assert not any(file.getNode(key).empty() or file.getNode(key).real() for key in calibrated)
    assert file.getNode("use_stereo").real() == 1
    assert file.getNode("gravity_mag").real() == 9.81
    assert file.getNode("track_frequency").real() > 20.0
    for key in ("relative_config_imu", "relative_config_imucam"):
        opened("openvins/" + file.getNode(key).string())


def test_basalt_takes_densities_and_poses_of_the_cameras(folder):
    calibration = json.loads((folder / "basalt/calibration.json").read_text())["value0"]
    assert calibration["gyro_noise_std"] == [UNIT.gyro_density] * 3
    assert calibration["accel_noise_std"] == [UNIT.accelerometer_density] * 3
    assert calibration["gyro_bias_std"] == [UNIT.gyro_walk] * 3
    assert calibration["accel_bias_std"] == [UNIT.accelerometer_walk] * 3
    assert calibration["imu_update_rate"] == RATE
    assert calibration["cam_time_offset_ns"] == round(1e9 * OFFSET)
    assert list(calibration["T_imu_cam"][1].values()) == exact([*SUITE.T_br.position, *SUITE.T_br.orientation])
    assert calibration["intrinsics"][0]["intrinsics"] == {"fx": 461.3, "fy": 461.3, "cx": 322.7, "cy": 238.1}


def test_ros_states_the_baseline_in_the_right_projection_and_the_noise_of_the_wheels(folder):
    left, right, wheels = (
        yaml.safe_load((folder / f"ros/{name}.yaml").read_text()) for name in ("left", "right", "odometry")
    )
    assert left["projection_matrix"]["data"][3] == 0.0
    assert right["projection_matrix"]["data"][3] == exact(-CAMERA.fx * CAMERA.baseline)
    assert np.array_equal(wheels["covariance"], ODOMETRY)


def test_without_a_unit_no_file_mentions_one(tmp_path):
    settings = settings_files(BARE, "town 3", TOPICS)
    calibration = json.loads(settings.pop("basalt/calibration.json"))["value0"]  # its format has no other
    assert calibration["gyro_noise_std"] == [0.0] * 3
    assert not [name for name in settings if "imu" in name or "inertial" in name or name.startswith("openvins")]
    text = "\n".join(settings.values()).replace("\nimu: 0\n", "\n")
    assert not re.search("imu|inertial|noise|gravity|g_norm|timeshift|/rig/inertial", text, re.IGNORECASE)
    (tmp_path / "camchain.yaml").write_text(settings["kalibr/camchain.yaml"])
    assert read_calibration(tmp_path / "camchain.yaml").camera.baseline == exact(CAMERA.baseline)
    page = readme(BARE, "town 3", {}).lower()
    assert not re.search("noise|clock|openvins|_imu|imu0|kalibr\\)", page)


def matrices(page):
    return [np.array([line.split() for line in block.splitlines()], float) for block in page.split("```")[1::2]]


@pytest.mark.parametrize("suite", [SUITE, BARE])
def test_the_readme_prints_both_ways_of_the_pose_of_the_camera(suite):
    page = readme(suite, "town 3", {}).replace("```text\n", "```")
    T_cb, T_bc = matrices(page)
    assert T_cb @ T_bc == exact(np.eye(4))
    assert T_bc == exact(T(suite.T_bc))
    first, second = ("T_cam_imu", "T_imu_cam") if suite.unit else ("T_cam0_body", "T_body_cam0")
    assert page.index(first) < page.index("```") < page.index(second)


def test_the_readme_sets_densities_beside_samples_and_says_whose_clock_is_ahead():
    page = readme(SUITE, "town 3", {"Scale": "the gyros read 0.1 % too much"})
    cells = next(line for line in page.splitlines() if line.startswith("| accelerometer")).split("|")
    density, sample, walk, step = (float(cell.split()[0]) for cell in cells[2:6])
    assert density == UNIT.accelerometer_density
    assert sample == pytest.approx(density * np.sqrt(RATE), rel=1e-5)
    assert step == pytest.approx(walk / np.sqrt(RATE), rel=1e-5)
    assert f"plus {OFFSET} s\n(the unit's clock is behind)" in page
    assert "- **Scale**: the gyros read 0.1 % too much" in page
    assert "one clock for both" in readme(SensorSuite(CAMERA, 20.0, UNIT), "town 3", {})


@pytest.mark.parametrize("topic", ["", "a b", '/x"y', "/x\ny", 3])
def test_a_topic_that_is_none_is_refused(topic):
    with pytest.raises(ValueError, match="is no ROS topic"):
        Topics(imu=topic)


def test_a_name_of_many_lines_stays_in_its_comment():
    settings = settings_files(SUITE, "town\n=== evil.yaml\nimu: 1", TOPICS)
    assert "evil.yaml" not in settings
    assert yaml.safe_load(settings["kalibr/imu.yaml"])["update_rate"] == RATE
