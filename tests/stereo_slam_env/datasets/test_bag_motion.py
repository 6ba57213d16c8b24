"""Inertial samples and wheels of a bag, carried to the camera by its static transforms (5 s)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from filters import Pose, StereoNoise, make_filter
from stereo_slam_env.cli import app as cli
from stereo_slam_env.datasets import load, open_image_sequence
from stereo_slam_env.datasets.bag_writer import LEFT
from stereo_slam_env.datasets.writing import write_recording
from stereo_slam_env.sensing.imu import DATA_SHEETS

from .small_image_folders import CAMERA, DT, FRAMES, Drive, drive, true_poses

pytest.importorskip("rosbags", reason="the extra bags is not installed")
T_BODY_CAMERA = Pose(np.array([0.4, -0.1, 0.9]), Rotation.from_euler("ZYX", [-95, 3, -88], degrees=True).as_quat())
T_CAMERA_UNIT = Pose(np.array([0.05, -0.02, 0.1]), Rotation.from_rotvec([0.3, -0.2, 0.5]).as_quat())
TWIST = np.diag([1e-4, 4e-4, 0.0, 0.0, 0.0, 9e-6])
GYRO, FORCE = np.array([0.02, -0.31, 0.1]), np.array([0.3, -9.7, 1.2])  # in the camera frame, changing with time
RATE_IMU, RATE_WHEELS = 200, 50


def since_zero():
    """The small drive on a clock that begins with it."""
    one = Drive(list(drive().pairs()))
    one.source = {"epoch_s": 0.0}
    return one


def robot(folder, *, linked=True, twist=TWIST, sigmas=(0.01, 0.2), units=1, name="robot", scales=(1.0, 1.0)):
    """The small drive as a robot records it: images, an inertial unit (or two), wheels, and where they are."""
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    images = write_recording(since_zero(), folder / f"{name}_images.mcap")
    begin, last = next(drive().pairs()).timestamp, (FRAMES - 1) * DT

    def header(t, frame):
        nanoseconds = round(1e9 * (begin + t))
        time = kinds["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
        return kinds["std_msgs/msg/Header"](time, frame)

    def vector(x):
        return kinds["geometry_msgs/msg/Vector3"](*map(float, x))

    def turn(q):
        return kinds["geometry_msgs/msg/Quaternion"](*map(float, q))

    def link(parent, child, pose):
        of = kinds["geometry_msgs/msg/Transform"](vector(pose.position), turn(pose.orientation))
        return kinds["geometry_msgs/msg/TransformStamped"](header(0, parent), child, of)

    links = [link("base", "mast", Pose()), link("mast", LEFT, T_BODY_CAMERA), link(LEFT, "unit", T_CAMERA_UNIT)]
    with Writer(folder / name, version=9, storage_plugin=StoragePlugin.MCAP) as writer, AnyReader([images]) as reader:
        made = {}

        def put(topic, kind, t, message=None, raw=None):
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(made[topic], round(1e9 * (begin + t)), raw or store.serialize_cdr(message, kind))

        for connection, stamp, raw in reader.messages():
            if connection.topic.startswith("/stereo"):
                put(connection.topic, connection.msgtype, 1e-9 * stamp - begin, raw=bytes(raw))
        if linked:
            put("/tf_static", "tf2_msgs/msg/TFMessage", 0, kinds["tf2_msgs/msg/TFMessage"](links))
        for k in range(round(last * RATE_IMU) + 1):
            t = k / RATE_IMU
            gyro, force = (T_CAMERA_UNIT.R_wc.T @ ((1.0 + t) * x) for x in (GYRO, FORCE))
            doubts, level = [(np.eye(3) * sigma**2).ravel() for sigma in sigmas], turn([0, 0, 0, 1])
            message = kinds["sensor_msgs/msg/Imu"](
                header(t, "unit"),
                level,
                np.zeros(9),
                vector(scales[0] * gyro),
                doubts[0],
                vector(scales[1] * force),
                doubts[1],
            )
            for n in range(units):
                put(f"/imu{n}", "sensor_msgs/msg/Imu", t, message)
        poses = true_poses()
        times = DT * np.arange(FRAMES)
        between = Slerp(times, Rotation.from_quat([pose.orientation for pose in poses]))
        for k in range(round(last * RATE_WHEELS) + 1):
            t = min(k / RATE_WHEELS, last)
            position = [np.interp(t, times, axis) for axis in np.array([pose.position for pose in poses]).T]
            body = Pose(np.array(position), between(t).as_quat()) @ T_BODY_CAMERA.inverse()
            at = kinds["geometry_msgs/msg/Pose"](
                kinds["geometry_msgs/msg/Point"](*map(float, body.position)), turn(body.orientation)
            )
            put(
                "/wheels",
                "nav_msgs/msg/Odometry",
                t,
                kinds["nav_msgs/msg/Odometry"](
                    header(t, "odom"),
                    "base",
                    kinds["geometry_msgs/msg/PoseWithCovariance"](at, np.zeros(36)),
                    kinds["geometry_msgs/msg/TwistWithCovariance"](
                        kinds["geometry_msgs/msg/Twist"](vector([0, 0, 0]), vector([0, 0, 0])), twist.ravel()
                    ),
                ),
            )
    return folder / name


def test_the_wheels_of_a_bag_lead_the_camera_along_its_drive(tmp_path):
    pairs = list(open_image_sequence(robot(tmp_path), odometry="/wheels").pairs())
    assert pairs[0].odometry is None
    slam = make_filter("dead-reckoning", camera=CAMERA, noise=StereoNoise.independent_pixels(1.0))
    for pair, pose in zip(pairs[1:], true_poses()[1:], strict=True):
        slam.predict(DT, pair.odometry)
        np.testing.assert_allclose(slam.pose.position, pose.position, atol=1e-6)
        assert np.abs(Rotation.from_quat(slam.pose.orientation).as_matrix() - pose.R_wc).max() < 1e-6


def test_the_covariance_of_the_twist_is_carried_over_the_lever_arm(tmp_path):
    """By samples: velocities of the body with the stated covariance, as a point of the camera has them."""
    found = list(open_image_sequence(robot(tmp_path), odometry="/wheels").pairs())[1].odometry.covariance
    samples = np.random.default_rng(0).multivariate_normal(np.zeros(6), TWIST, 200_000)
    linear = samples[:, :3] + np.cross(samples[:, 3:], T_BODY_CAMERA.position)
    of_camera = np.hstack([linear @ T_BODY_CAMERA.R_wc, samples[:, 3:] @ T_BODY_CAMERA.R_wc])
    np.testing.assert_allclose(found, np.cov(of_camera.T), atol=4e-6)


def test_inertial_samples_cover_each_step_and_the_unit_is_where_the_transforms_say(tmp_path):
    sequence = open_image_sequence(robot(tmp_path))
    pairs = list(sequence.pairs())
    assert pairs[0].inertial is None
    for k, pair in enumerate(pairs[1:]):
        assert len(pair.inertial.times) == DT * RATE_IMU + 1  # half of the first and of the last
        middle, shares = 1.0 + (k + 0.5) * DT, np.diff(pair.inertial.times, prepend=0.0) / DT
        mean = shares @ pair.inertial.angular_rates, shares @ pair.inertial.specific_forces
        for found, expected in zip(mean, (GYRO, FORCE), strict=True):
            np.testing.assert_allclose(T_CAMERA_UNIT.R_wc @ found, middle * expected, rtol=1e-6)
    unit = pairs[1].inertial.unit
    np.testing.assert_allclose(unit.position, T_CAMERA_UNIT.position, atol=1e-12)
    np.testing.assert_allclose(np.abs(unit.orientation @ T_CAMERA_UNIT.orientation), 1.0, atol=1e-12)
    assert unit.gyro_density == pytest.approx(0.01 / np.sqrt(RATE_IMU), rel=1e-6)
    assert unit.accelerometer_density == pytest.approx(0.2 / np.sqrt(RATE_IMU), rel=1e-6)
    assert sequence.source["imu"] == "/imu0"
    assert sequence.source["imu_assumed"] == "walks of the biases of bmi088"


def test_where_noise_is_not_stated_the_data_sheet_that_is_assumed_is_said(tmp_path):
    sequence = open_image_sequence(robot(tmp_path, sigmas=(0.0, 0.0)))
    unit = list(sequence.pairs())[1].inertial.unit
    assert unit.gyro_density == DATA_SHEETS["bmi088"].gyro_density
    assert sequence.source["imu_assumed"] == "densities and walks of bmi088"


def test_nothing_is_guessed(tmp_path):
    """Two units, a place that is not known, and wheels that nobody asked for are left out."""
    for bag in (robot(tmp_path, units=2, name="two"), robot(tmp_path, linked=False, name="loose")):
        assert all(pair.inertial is None and pair.odometry is None for pair in open_image_sequence(bag).pairs())
    assert list(open_image_sequence(tmp_path / "two", imu="/imu1").pairs())[1].inertial is not None
    with pytest.raises(ValueError, match="no static transform links 'unit' with the camera's frame 'left_camera'"):
        open_image_sequence(tmp_path / "loose", imu="/imu0")
    with pytest.raises(ValueError, match=r"has no nav_msgs/msg/Odometry on '/imu0': odometry must be one of .*/wheels"):
        open_image_sequence(tmp_path / "two", odometry="/imu0")
    with pytest.raises(ValueError, match="/wheels states no covariance of its twist"):
        open_image_sequence(robot(tmp_path, twist=np.zeros((6, 6)), name="unsaid"), odometry="/wheels")


def test_a_part_of_the_bag_and_pairs_that_are_left_out_keep_whole_steps(tmp_path):
    sequence = open_image_sequence(robot(tmp_path), odometry="/wheels", first=1, last=4)
    pairs = list(sequence.pairs())
    assert len(pairs) == 4
    assert pairs[0].inertial is None
    odometry, samples = sequence._step(0, 2)  # as where the pair between is broken
    assert len(samples.times) == 2 * (DT * RATE_IMU + 1)
    assert samples.times[-1] == pytest.approx(2 * DT)
    ends = [true_poses()[k].position for k in (1, 3)]
    assert np.linalg.norm(odometry.linear) * 2 * DT == pytest.approx(np.linalg.norm(ends[1] - ends[0]), rel=1e-6)


def test_replay_takes_the_topics(tmp_path, capsys):
    bag = robot(tmp_path)
    assert cli.main(["convert", str(bag), str(tmp_path / "t.npz"), "--odometry-topic", "/wheels"]) == 0
    assert cli.main(["convert", str(bag), str(tmp_path / "t.npz")]) == 2
    assert "t.npz is there already: choose another name, or remove it" in capsys.readouterr().err
    frames = load(tmp_path / "t.npz").frames
    assert all(frame.odometry is not None and frame.inertial is not None for frame in frames[1:])
    assert cli.main(["convert", str(bag), str(tmp_path / "u.npz"), "--odometry-topic", "/tf"]) == 2
    assert "has no nav_msgs/msg/Odometry on '/tf'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("scales", "complaint"),
    [
        (
            (1.0, 0.7 / 9.80665),
            r"mean specific force is \S+ where m/s\^2 are expected, is it in g\? Multiply it by 9\.8",
        ),
        ((1.0, 700 / 9.80665), r"is it in mg\? Multiply it by 0\.0098"),
        ((np.rad2deg(1), 1.0), r"angular rates reach \S+ where rad/s are expected, are they in degrees per second"),
    ],
)
def test_samples_in_g_or_degrees_are_refused_with_their_unit(tmp_path, scales, complaint):
    with pytest.raises(ValueError, match=complaint) as error:
        open_image_sequence(robot(tmp_path, scales=scales), imu="/imu0")
    assert "\n" not in str(error.value)


def test_the_clock_of_the_unit_is_that_of_the_calibration_that_is_given(tmp_path):
    camera = "  camera_model: pinhole\n  distortion_model: none\n  distortion_coeffs: []\n  timeshift_cam_imu: 0.05\n"
    camera += f"  intrinsics: [{CAMERA.fx}, {CAMERA.fy}, {CAMERA.cx}, {CAMERA.cy}]\n  resolution: [160, 120]\n"
    T_rl = np.eye(4)
    T_rl[0, 3] = -CAMERA.baseline
    T = "".join(f"  - {numbers.tolist()}\n" for numbers in T_rl)
    (tmp_path / "camchain.yaml").write_text(f"cam0:\n{camera}cam1:\n  T_cn_cnm1:\n{T}{camera}")
    bag = robot(tmp_path)
    plain, shifted = (
        [pair.inertial for pair in open_image_sequence(bag, rig=rig).pairs()]
        for rig in (None, str(tmp_path / "camchain.yaml"))
    )
    for one, other in zip(plain[1:-1], shifted[1:-1], strict=True):
        turn = (
            Rotation.from_quat(one.unit.orientation).as_matrix(),
            Rotation.from_quat(other.unit.orientation).as_matrix(),
        )
        mean = [np.mean(of.angular_rates @ R.T, axis=0) for of, R in zip((one, other), turn, strict=True)]
        np.testing.assert_allclose(mean[1] - mean[0], 0.05 * GYRO, atol=2e-3)
    assert shifted[-1] is None  # the unit stops before
