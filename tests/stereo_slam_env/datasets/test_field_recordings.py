"""What people bring: ROS bags, TartanAir, VSLAM-LAB, a plain folder, a truth or a layout of their own (20 s)."""

import os
import sys
from itertools import pairwise

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import ConstantVelocity
from stereo_slam_env import evaluate
from stereo_slam_env.cli import app as cli
from stereo_slam_env.datasets import available_recordings, load, open_image_sequence, write_recording
from stereo_slam_env.datasets.ros_bag import grey_of
from stereo_slam_env.datasets.tartanair import R_BODY_CAMERA
from stereo_slam_env.frontend.camera_motion import needed_motion
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import load_trajectory, save_trajectory

from ..real_data import real_data
from .small_bags import street, write_bag
from .small_image_folders import CAMERA, DT, FRAMES, drive, kitti_odometry, projection, true_poses, write_png
from .test_image_layouts import assert_same_poses

pytest.importorskip("rosbags", reason="the extra bags is not installed")
EPOCH = 1_700_000_000.25
"""Of a robot's clock, s."""


def calibration(folder):
    P = [" ".join(f"{x:.12g}" for x in projection(x).ravel()) for x in (0.0, -CAMERA.baseline)]
    text = "".join(f"P_rect_0{eye}: {P[eye]}\n" for eye in (0, 1))
    (folder / "calib.txt").write_text(f"S_rect_00: {CAMERA.width} {CAMERA.height}\n{text}")


def truth_file(path, epoch, T_bc=None):
    """True poses of a body as a TUM file, between the images and beyond them: constant steps are interpolated."""
    T_bc, poses = np.eye(4) if T_bc is None else T_bc, true_poses()
    R = Rotation.from_quat([pose.orientation for pose in poses]) * Rotation.from_matrix(T_bc[:3, :3]).inv()
    positions = np.array([pose.position for pose in poses]) - R.apply(T_bc[:3, 3])
    save_trajectory(path, Trajectory(positions, R.as_quat(), epoch + DT * np.arange(FRAMES)))
    return path


def plain_folder(folder, about="", names="{:04d}"):
    for k, pair in enumerate(drive().pairs()):
        write_png(folder / "left" / f"{names.format(k)}.png", pair.left)
        write_png(folder / "right" / f"{names.format(k)}.png", pair.right)
    calibration(folder)
    (folder / "recording.toml").write_text(about or 'rig = "calib.txt"\nrate_hz = 10\n')
    return folder


def vslam_lab(folder):
    R, t = Rotation.from_rotvec([0.2, -0.5, 0.9]), np.array([0.3, -0.1, 0.2])  # camera in the body
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R.as_matrix(), t
    lines, truth = ["ts_rgb_0 (ns),path_rgb_0,ts_rgb_1 (ns),path_rgb_1"], ["ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw"]
    for k, (pair, pose) in enumerate(zip(drive().pairs(), true_poses(), strict=True)):
        stamp = round(1e9 * EPOCH) + round(1e9 * DT) * k
        for eye, image in enumerate((pair.left, pair.right)):
            write_png(folder / f"rgb_{eye}" / f"{stamp}.png", image)
        lines.append(f"{stamp},rgb_0/{stamp}.png,{stamp + 1000},rgb_1/{stamp}.png")
        R_wb = Rotation.from_quat(pose.orientation) * R.inv()
        truth.append(",".join(map(str, [stamp, *(pose.position - R_wb.apply(t)), *R_wb.as_quat()])))
    text = "cameras:\n"
    for eye in (0, 1):
        T_BS = T.copy()
        T_BS[:3, 3] = t + R.apply([eye * CAMERA.baseline, 0.0, 0.0])
        text += f"  - cam_name: rgb_{eye}\n    cam_model: pinhole\n    focal_length: [{CAMERA.fx}, {CAMERA.fy}]\n"
        text += (
            f"    principal_point: [{CAMERA.cx}, {CAMERA.cy}]\n    image_dimension: [{CAMERA.width}, {CAMERA.height}]\n"
        )
        text += f"    T_BS: [{', '.join(f'{x:.15g}' for x in T_BS.ravel())}]\n"
    (folder / "rgb.csv").write_text("\n".join(lines) + "\n")
    (folder / "groundtruth.csv").write_text("\n".join(truth) + "\n")
    (folder / "calibration.yaml").write_text(text)
    return folder


def mcap(folder):
    return write_recording(drive(), folder / "drive.mcap")


def assert_the_drive(sequence, truth=True, atol=1e-6):
    pairs = list(sequence.pairs())
    assert len(pairs) == FRAMES
    for name in ("fx", "fy", "cx", "cy", "baseline", "width", "height"):
        assert getattr(sequence.camera, name) == pytest.approx(getattr(CAMERA, name), rel=1e-9)
    for pair, original in zip(pairs, drive().pairs(), strict=True):
        np.testing.assert_array_equal(pair.left, original.left)
        np.testing.assert_array_equal(pair.right, original.right)
    np.testing.assert_allclose(
        [pair.timestamp - pairs[0].timestamp for pair in pairs], DT * np.arange(FRAMES), atol=1e-6
    )
    if truth:
        assert_same_poses([pair.truth for pair in pairs], true_poses(), atol=atol)


# --- bags ------------------------------------------------------------------------------------------------------------


def test_a_recording_goes_to_mcap_and_back_with_its_bits(tmp_path, capsys):
    kitti = kitti_odometry(tmp_path)
    assert cli.main(["convert", str(kitti), str(tmp_path / "out.mcap")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'out.mcap'}\n"
    sequence = open_image_sequence(tmp_path / "out.mcap")
    assert sequence.source["topics"] == ["/stereo/left/image_rect", "/stereo/right/image_rect"]
    assert_the_drive(sequence)
    assert cli.main(["convert", str(tmp_path / "out.mcap"), str(tmp_path / "out.mcap")]) == 2
    assert "is there already" in capsys.readouterr().err


@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", ["metadata.yaml", "bag.db3", "more"])
def test_a_pipe_in_the_folder_of_a_bag_is_not_waited_for(name, tmp_path):
    """`rosbags` and SQLite open files themselves, and would wait."""
    folder = tmp_path / "bag"
    folder.mkdir()
    for each in {"metadata.yaml", "bag.db3"} - {name}:
        (folder / each).touch()
    os.mkfifo(folder / name)
    with pytest.raises(ValueError, match=f"{name} is no regular file but a pipe"):
        open_image_sequence(folder)
    with pytest.raises(ValueError, match=f"{name} is no regular file but a pipe|bag:/odometry does not exist"):
        load_trajectory(f"{folder}:/odometry")


def test_a_bag_becomes_a_kitti_sequence_and_an_archive_of_tracks(tmp_path, capsys):
    bag = mcap(tmp_path)
    assert cli.main(["convert", str(bag), str(tmp_path / "k"), "--name", "03"]) == 0
    assert_the_drive(open_image_sequence(tmp_path / "k"))
    assert cli.main(["convert", str(bag), str(tmp_path / "tracks.npz")]) == 0
    assert len(load(tmp_path / "tracks.npz").frames) == FRAMES


def bag_of(path, topics, change=None, **more):
    """The drive as a bag of raw images; `change` alters the fields of CameraInfo, None leaves that out."""

    def info(eye, k):
        P = projection(-eye * CAMERA.baseline)
        given = {"K": P[:, :3].ravel(), "R": np.eye(3).ravel(), "P": P.ravel(), "D": np.zeros(5)}
        return change({**given, "size": (CAMERA.width, CAMERA.height)})

    images = tuple([getattr(pair, eye) for pair in drive().pairs()] for eye in ("left", "right"))
    return write_bag(path, topics, images, info if change else None, **more)


@pytest.mark.parametrize("encoding", ["mono8", "rgb8"])
def test_a_ros_1_bag_is_read_with_a_truth_of_the_robots_clock(tmp_path, encoding):
    """Topics as of a RealSense."""
    topics = [f"/camera/infra{eye}/image_rect_raw" for eye in (1, 2)]
    bag = bag_of(tmp_path / "robot.bag", topics, lambda info: info, ros1=True, encoded=lambda image, k, eye: (
        encoding, np.repeat(image[..., None], 3, axis=2) if encoding == "rgb8" else image))  # fmt: skip
    assert_the_drive(open_image_sequence(bag), truth=False)
    tum = truth_file(tmp_path / "truth.tum", EPOCH)
    assert_the_drive(open_image_sequence(bag, truth=tum))
    part = open_image_sequence(bag, first=1, last=3)
    assert len(list(part.pairs())) == 3
    assert (part.source["first"], part.source["last"]) == (1, 3)
    with pytest.raises(ValueError, match=r"truth\.tum covers none of the images: .* give times of one clock"):
        list(open_image_sequence(bag, truth=truth_file(tmp_path / "truth.tum", 0.0)).pairs())


def test_topics_can_be_named_and_what_is_no_stereo_bag_is_refused_in_one_line(tmp_path, capsys):
    bag = mcap(tmp_path)
    with pytest.raises(ValueError, match=r"has no images on '/front'; topics with images: /stereo/left/image_rect, "):
        open_image_sequence(bag, left="/front")
    turned = open_image_sequence(bag, left="/stereo/left/image_rect", right="/stereo/right/image_rect", rig="qvga")
    with pytest.raises(ValueError, match="is 160x120 where CameraInfo says 320x240"):
        next(turned.pairs())
    (tmp_path / "cut.mcap").write_bytes(bag.read_bytes()[:5000])
    (tmp_path / "text.bag").write_text("no bag\n")
    for name in ("cut.mcap", "text.bag"):
        assert cli.main(["replay", str(tmp_path / name), "--out", str(tmp_path / "run")]) == 2
        said = capsys.readouterr().err
        assert said.startswith(f"error: {tmp_path / name} ")
        assert said.count("\n") == 1


def test_cameras_without_camera_info_are_known_by_their_names_once_the_rig_is_given(tmp_path, capsys):
    """As in the bags of EuRoC."""
    bag = bag_of(tmp_path / "bag", ("/cam0/image_raw", "/cam1/image_raw"))
    calibration(tmp_path)
    rig = ["--rig", str(tmp_path / "calib.txt")]
    assert cli.main(["convert", str(bag), str(tmp_path / "found"), *rig]) == 0
    assert_the_drive(open_image_sequence(tmp_path / "found"), truth=False)
    topics = ["--image-topics", "/cam0/image_raw,/cam1/image_raw"]
    assert cli.main(["convert", str(bag), str(tmp_path / "named"), *rig, *topics]) == 0
    assert_the_drive(open_image_sequence(tmp_path / "named"), truth=False)
    capsys.readouterr()
    for more, complaint in (
        ([], "give a rig; images: /cam0/image_raw with no CameraInfo, /cam1/image_raw with no CameraInfo"),
        (["--image-topics", "/cam0/image_raw"], "--image-topics needs two topics, LEFT,RIGHT"),
    ):
        assert cli.main(["convert", str(bag), str(tmp_path / "none"), *more]) == 2
        assert complaint in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda info: {**info, "P": np.abs(info["P"])}, r"no pair of cameras .* P\[3\] = 0.*P\[3\] = \d"),
        (lambda info: {**info, "P": info["P"] * [1, 1, 1, 1000, *[1] * 8]}, r"the baseline is \d+ m: .* is it in mm"),
        (lambda info: {**info, "P": info["P"] * [1e3, 1, 1, 1e3, 1, 1e3, *[1] * 6]}, r"focal length of \d+ px .* no c"),
        (lambda info: {**info, "K": np.full(9, np.nan)}, "'camera_matrix' has NaN or infinity"),
        (lambda info: {**info, "P": np.zeros(12)}, "no pair of cameras"),
        (lambda info: {**info, "R": np.zeros(9)}, "the rectification matrix holds no rotation"),
        (lambda info: {**info, "size": (1280, 720)}, "160x120 where CameraInfo says 1280x720"),
    ],
)
def test_a_camera_info_that_cannot_be_is_refused_with_what_is_wrong(tmp_path, change, complaint):
    bag = bag_of(tmp_path / "bag", ("/left/image_raw", "/right/image_raw"), change)
    with pytest.raises(ValueError, match=complaint) as error:
        list(open_image_sequence(bag).pairs())
    assert "\n" not in str(error.value)


def test_images_that_show_nothing_are_refused(tmp_path, capsys):
    folder = plain_folder(tmp_path)
    for image in folder.glob("*/*.png"):
        write_png(image, np.zeros((CAMERA.height, CAMERA.width), np.uint8))
    assert cli.main(["replay", str(folder), "--out", str(tmp_path / "run")]) == 2
    assert f"shows no landmark in any of its {FRAMES} pairs: are the images dark" in capsys.readouterr().err


def test_a_bag_without_images_is_told_so_and_not_to_name_topics():
    bag = real_data("field/bags") / "nav2_turtlebot.mcap"
    with pytest.raises(ValueError, match=r"nav2_turtlebot\.mcap holds no images, on none of its \d+ topics"):
        open_image_sequence(bag)


def test_an_image_that_is_not_what_it_says_is_named():
    class Message:
        encoding, width, height, step, is_bigendian, data = "mono8", 4, 3, 4, 0, np.zeros(11, np.uint8)

    with pytest.raises(ValueError, match="has 11 bytes, too few for its size"):
        grey_of(Message, (4, 3), "bag: an image")
    Message.encoding = "nv21"
    with pytest.raises(ValueError, match="has the encoding 'nv21': known are mono8"):
        grey_of(Message, (4, 3), "bag: an image")
    Message.encoding, Message.step, Message.data = "16UC1", 8, np.arange(24, dtype=np.uint8)
    np.testing.assert_array_equal(grey_of(Message, (4, 3), "")[0], [1, 3, 5, 7])


# --- folders ---------------------------------------------------------------------------------------------------------


def test_vslam_lab_gives_the_drive_and_poses_of_the_camera(tmp_path):
    sequence = open_image_sequence(vslam_lab(tmp_path))
    assert sequence.source["reader"] == "vslam_lab"
    assert_the_drive(sequence)
    listing = tmp_path / "rgb.csv"
    good = listing.read_text()
    listing.write_text(good.replace("rgb_1/", "../rgb_1/", 1))
    with pytest.raises(ValueError, match=r"rgb\.csv: line 2 is not 'time in ns, image"):
        open_image_sequence(tmp_path)
    first, stamp = good.splitlines()[1], round(1e9 * EPOCH)
    for apart in (5_000_000, -5_000_000, 5_000_001):
        listing.write_text(good.replace(first, first.replace(f"{stamp + 1000}", f"{stamp + apart}")))
        if abs(apart) <= 5_000_000:
            assert len(open_image_sequence(tmp_path)) == FRAMES
        else:
            with pytest.raises(ValueError, match="in line 2 the images are 5000001 ns apart: no pair"):
                open_image_sequence(tmp_path)
    listing.write_text(good.replace("path_rgb_1", "path_depth_0"))
    with pytest.raises(ValueError, match="lacks the columns path_rgb_1: it must list the images of both cameras"):
        open_image_sequence(tmp_path)


def test_a_plain_folder_needs_a_few_lines(tmp_path):
    assert_the_drive(open_image_sequence(plain_folder(tmp_path)), truth=False)
    T_bc = np.eye(4)
    T_bc[:3, :3], T_bc[:3, 3] = Rotation.from_rotvec([0.1, 0.7, -1.2]).as_matrix(), [0.2, 0.0, -0.4]
    truth_file(tmp_path / "truth.tum", EPOCH, T_bc)
    (tmp_path / "T.json").write_text(f'{{"R": {T_bc[:3, :3].tolist()}, "t": {T_bc[:3, 3].tolist()}}}')
    (tmp_path / "times.txt").write_text("".join(f"{EPOCH + DT * k:.9f}\n" for k in range(FRAMES)))
    about = 'rig = "calib.txt"\ntimes = "times.txt"\ntruth = "truth.tum"\nbody = "T.json"\nreference = "surveyed"\n'
    (tmp_path / "recording.toml").write_text(about)
    sequence = open_image_sequence(tmp_path)
    assert sequence.truth_from.kind == "surveyed"
    assert_the_drive(sequence)


UNITS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("where", ["names", "times.txt"])
def test_times_are_read_in_the_unit_that_their_size_says(tmp_path, unit, where):
    stamps = [10 * 170_000_000 + k for k in range(FRAMES)]  # tenths of a second
    words = [f"{stamp / 10:.1f}" if unit == "s" else str(stamp * UNITS[unit] // 10) for stamp in stamps]
    folder = plain_folder(tmp_path, f'rig = "calib.txt"\ntimes = "{where}"\n')
    if where == "names":
        for k, word in enumerate(words):
            for side in ("left", "right"):
                (folder / side / f"{k:04d}.png").rename(folder / side / f"{word}.png")
    else:
        (folder / where).write_text("\n".join(words))
    sequence = open_image_sequence(folder)
    np.testing.assert_allclose([pair.timestamp for pair in sequence.pairs()], DT * np.arange(FRAMES), atol=1e-6)
    assert sequence.source["epoch_s"] == pytest.approx(170000000.0)


@pytest.mark.parametrize(
    ("step", "likely"), [(100.0, "milliseconds"), (1e5, "microseconds"), (1e8, "nanoseconds"), (5e-5, "write them")]
)
def test_times_at_the_rate_of_no_camera_are_refused_with_the_likely_unit(tmp_path, step, likely):
    folder = plain_folder(tmp_path, 'rig = "calib.txt"\ntimes = "times.txt"\n')
    np.savetxt(folder / "times.txt", step * np.arange(FRAMES))
    with pytest.raises(ValueError, match=rf"times\.txt: its times are .* Hz are read: .*{likely}"):
        open_image_sequence(folder)
    (folder / "recording.toml").write_text('rig = "calib.txt"\nrate_hz = 20000\n')
    with pytest.raises(ValueError, match=r"at 2e\+04 Hz"):
        open_image_sequence(folder)


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_deep_images_of_a_folder_have_one_scale(tmp_path, bits):
    folder = plain_folder(tmp_path)
    for path in [*(folder / "left").iterdir(), *(folder / "right").iterdir()]:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        image[0, 0] = 255
        write_png(path, image.astype(np.uint16) << (bits - 8))
    for pair, original in zip(open_image_sequence(folder).pairs(), drive().pairs(), strict=True):
        np.testing.assert_array_equal(pair.left[1:], original.left[1:])
        np.testing.assert_array_equal(pair.right[1:], original.right[1:])


@pytest.mark.parametrize("baseline", [10.0, 3.0, 0.002])
def test_a_baseline_in_a_table_asks_for_its_unit(tmp_path, baseline):
    numbers = {"fx": CAMERA.fx, "fy": CAMERA.fy, "cx": CAMERA.cx, "cy": CAMERA.cy, "width": 160, "height": 120}
    rig = {**numbers, "baseline": baseline}
    with pytest.raises(ValueError, match=rf"the baseline is {baseline:g} m: metres are expected"):
        open_image_sequence(plain_folder(tmp_path), rig=rig)


def test_a_folder_of_rectified_images_beside_raw_lenses_is_read_as_it_is(tmp_path):
    """The street, for the small drive has too few corners."""
    for k, (left, right) in enumerate(zip(*street(), strict=True)):
        write_png(tmp_path / "left" / f"{k:04d}.png", left)
        write_png(tmp_path / "right" / f"{k:04d}.png", right)
    camera = "  camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [-0.3, 0.1, 0.001, 0.0005]\n"
    camera += "  intrinsics: [310, 310, 250, 125]\n  resolution: [480, 240]\n"
    turn = Rotation.from_rotvec([0.01, 0.01, -0.01]).as_matrix()
    T = np.column_stack([turn, [-0.6, 0.001, 0.002]])
    T = "".join(f"  - {row.tolist()}\n" for row in np.vstack([T, [0, 0, 0, 1]]))
    (tmp_path / "camchain.yaml").write_text(f"cam0:\n{camera}cam1:\n  T_cn_cnm1:\n{T}{camera}")
    (tmp_path / "recording.toml").write_text('rig = "camchain.yaml"\nrate_hz = 10\n')
    sequence = open_image_sequence(tmp_path)
    np.testing.assert_array_equal(next(sequence.pairs()).left, street()[0][0])
    assert "are rectified, although their calibration or name says raw" in sequence.source["notes"][0]


@pytest.mark.parametrize(
    ("about", "complaint"),
    [
        ("rate_hz = 10", "lacks 'rig'"),
        ('rig = "calib.txt"', "must say either rate_hz or times"),
        ('rig = "calib.txt"\nrate_hz = 0', "rate_hz must be"),
        ('rig = "calib.txt"\nrate_hz = 10\ncolour = 1', "has no entry 'colour'"),
        ('rig = "../calib.txt"\nrate_hz = 10', "is a link out of its folder|does not exist"),
        ('rig = "calib.txt"\ntimes = "names"', "is no time in s, ms, us or ns"),
        ("rig = [", "is no TOML"),
        ('rig = "calib.txt"\nrate_hz = 10\ntruth = "none.tum"', "does not exist"),
    ],
)
def test_a_wrong_line_of_the_toml_is_named(tmp_path, about, complaint, capsys):
    folder = plain_folder(tmp_path, about, names="pair{}")
    with pytest.raises(ValueError, match=complaint) as error:
        open_image_sequence(folder)
    assert "\n" not in str(error.value)
    assert cli.main(["replay", str(folder), "--out", str(tmp_path / "run")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_tartanair_is_known_by_its_folders_and_its_poses_are_those_of_a_body_in_ned(tmp_path):
    rows = []
    for k, (pair, pose) in enumerate(zip(drive().pairs(), true_poses(), strict=True)):
        write_png(tmp_path / "image_left" / f"{k:06d}_left.png", pair.left)
        write_png(tmp_path / "image_right" / f"{k:06d}_right.png", pair.right)
        R = Rotation.from_matrix(R_BODY_CAMERA)  # the world of the file: north, east, down
        rows.append([*R.apply(pose.position), *(R * Rotation.from_quat(pose.orientation) * R.inv()).as_quat()])
    np.savetxt(tmp_path / "pose_left.txt", rows)
    sequence = open_image_sequence(tmp_path)
    assert_same_poses([pair.truth for pair in sequence.pairs()], true_poses(), atol=1e-9)
    assert (sequence.camera.fx, sequence.camera.baseline) == (320.0, 0.25)


def test_tracks_of_the_real_clip_of_tartanair_move_by_its_exact_poses():
    recording = load(real_data("field") / "tartanair_v2_clip")
    assert recording.reference.kind == "simulation"
    errors = []
    ids, seen = np.unique(np.concatenate([frame.observation.ids for frame in recording.frames]), return_counts=True)
    followed = ids[seen > 3]  # corners that are no points of the scene are not found again for long
    for before, now in zip(recording.frames[:-1], recording.frames[1:], strict=True):
        both = np.intersect1d(before.observation.ids, now.observation.ids)
        i, j = (np.searchsorted(f.observation.ids, np.intersect1d(both, followed)) for f in (before, now))
        points = (now.truth.inverse() @ before.truth) @ recording.camera.backproject(before.observation.uvd[i])
        errors.append(recording.camera.project(points) - now.observation.uvd[j])
    assert len(np.concatenate(errors)) > 100
    assert np.median(np.abs(np.concatenate(errors)), axis=0).max() < 0.2  # px


def test_the_real_clip_of_tartanair_is_followed_with_the_accelerations_that_its_tracks_show():
    recording = load(real_data("field") / "tartanair_v2_clip")
    poses = [frame.truth for frame in recording.frames]
    turns = [(one.inverse() @ two).log()[3:] / 0.1 for one, two in pairwise(poses)]
    motion = needed_motion(recording)
    true = np.sqrt(np.mean((np.diff(turns, axis=0) / 0.1) ** 2))
    assert motion.sigma_angular_acceleration == pytest.approx(true, rel=0.05)  # 2.6 rad/s^2; of a car 0.6
    for name in ("inverse-depth", "coloured-noise"):
        on_road, followed = (evaluate(name, recording, motion=one) for one in (ConstantVelocity(), motion))
        assert on_road.figures.diverged == 1
        assert followed.figures.diverged == 0
        assert followed.figures.position_rmse_m < 0.03
    assert followed.figures.pose_anees / 6 < 1.0  # 7.5 while a turn of the camera alone moved all rays


# --- calibrations, plug-ins ------------------------------------------------------------------------------------------


def test_another_calibration_may_be_given_for_any_images(tmp_path, capsys):
    folder = kitti_odometry(tmp_path)
    rig = {"fx": 121.0, "fy": 121.0, "cx": 80.0, "cy": 60.0, "baseline": 0.6, "width": 160, "height": 120}
    sequence = open_image_sequence(folder, rig=rig)
    assert sequence.camera.baseline == 0.6
    assert next(sequence.pairs()).truth is not None
    with pytest.raises(ValueError, match="rig qvga is of images 320x240, those of kitti_odometry_07 are 160x120"):
        open_image_sequence(folder, rig="qvga")
    out = ["--out", str(tmp_path / "run")]
    assert cli.main(["replay", str(folder), "--rig", "none.yaml", *out]) == 2
    assert capsys.readouterr().err.startswith("error: none.yaml does not exist")


PLUG_IN = '''
"""Recordings of our robot."""
from stereo_slam_env.datasets.kitti_odometry import open_sequence as read_kitti

NAME, FILES = "our-robot", (("our_robot.txt",),)

def open_sequence(path, choice, *, cameras=None):
    return read_kitti(path, choice, cameras=cameras)
'''


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Two layouts of strangers, one of which cannot be loaded."""
    place = tmp_path / "site"
    about = place / "our_robot-1.dist-info"
    about.mkdir(parents=True)
    (place / "our_robot_reader.py").write_text(PLUG_IN)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: our-robot\nVersion: 1\n")
    points = "[stereo_slam.recordings]\nour-robot = our_robot_reader\nbroken = nobody_has_this\n"
    (about / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(str(place))
    yield
    sys.modules.pop("our_robot_reader", None)


def test_a_layout_of_a_third_party_is_read_and_a_broken_one_takes_nothing_down(tmp_path, installed):
    folder = kitti_odometry(tmp_path)
    (folder / "our_robot.txt").write_text("")
    (folder / "calib.txt").rename(folder / "our_calib.txt")
    with pytest.raises(ValueError, match=r"calib\.txt is missing"):  # by the plug-in: the folder is its own
        open_image_sequence(folder)
    (folder / "our_calib.txt").rename(folder / "calib.txt")
    listed = available_recordings()
    assert listed["our-robot"] == "Recordings of our robot."
    assert listed["broken"].startswith("not available: ModuleNotFoundError")
    assert {"ros_bag", "euroc", "starry_night"} <= listed.keys()
