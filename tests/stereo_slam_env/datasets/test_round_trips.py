"""What is written for other programs is read back the same: every format, every kind of data, from any start.

Images to the bit, numbers to 1e-9.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import yaml

from filters import BodyVelocity, InertialSamples, InertialUnit, Pose
from filters.geometry import rotations
from stereo_slam_env.datasets import FORMATS, open_image_sequence, write_recording
from stereo_slam_env.datasets.written_frame import KINDS
from stereo_slam_env.recording.recording import SIMULATION, Velocity
from stereo_slam_env.recording.trajectory_files import load_trajectory
from stereo_slam_env.sensing.rig_files import read_calibration
from stereo_slam_env.sensing.sensor_suite import T_BASE_CAMERA

from .small_image_folders import CAMERA, FRAMES, Drive, drive

UNIT = InertialUnit([0.05, -0.1, 0.2], [0.5, -0.5, 0.5, 0.5], 2.4e-4, 1.8e-3, 4e-5, 5e-3)
RATE = 200
STATES = "true velocities and biases"
NEEDS_ROSBAGS = ("mcap", "db3", "bag")


def full_drive():
    """The small drive with all that a recording may have."""
    rng, every = np.random.default_rng(5), list(drive().pairs())
    pairs = []
    for before, pair in zip([None, *every], every, strict=False):
        more = {
            "velocity": Velocity(rng.normal(size=3), rng.normal(size=3)),
            "biases": 0.01 * rng.normal(size=6),
        }
        if before is not None:
            dt = pair.timestamp - before.timestamp
            count = round(RATE * dt)
            ends = dt * np.arange(1, count + 1) / count
            forces = np.array([0.0, 0.0, 9.81]) + rng.normal(size=(count, 3))
            root = np.tril(0.1 * rng.normal(size=(6, 6))) + 0.2 * np.eye(6)
            more["inertial"] = InertialSamples(np.round(ends, 9), rng.normal(size=(count, 3)), forces, UNIT)
            more["odometry"] = BodyVelocity(rng.normal(size=3), 0.3 * rng.normal(size=3), root @ root.T)
        pairs.append(replace(pair, **more))
    return Drive(pairs)


def read_again(place, format_name, **options):
    if format_name in NEEDS_ROSBAGS:
        place, options = place / FORMATS[format_name].file, {"odometry": "/wheel/odometry", **options}
    return open_image_sequence(place, **options)


def place_of(tmp_path, format_name, sequence, **options):
    if format_name in NEEDS_ROSBAGS:
        pytest.importorskip("rosbags")
    lossy = KINDS - FORMATS[format_name].keeps
    return write_recording(sequence, tmp_path / "drive", format_name, may_lose=lossy, **options)


def assert_same_samples(one, other):
    np.testing.assert_allclose(one.times, other.times, rtol=0, atol=1.1e-9)
    np.testing.assert_allclose(one.angular_rates, other.angular_rates, rtol=0, atol=1e-12)
    np.testing.assert_allclose(one.specific_forces, other.specific_forces, rtol=0, atol=1e-12)
    np.testing.assert_allclose(one.unit.rows, other.unit.rows, rtol=0, atol=1e-12)


@pytest.mark.parametrize("format_name", FORMATS)
def test_what_is_written_is_read_the_same(tmp_path, format_name):
    sequence = read_again(place_of(tmp_path, format_name, full_drive()), format_name)
    keeps = FORMATS[format_name].keeps
    rig = [getattr(sequence.camera, name) for name in ("fx", "fy", "cx", "cy", "baseline", "width", "height")]
    assert rig == pytest.approx([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, 0.5, 160, 120], rel=1e-12)
    pairs = list(sequence.pairs())
    assert len(pairs) == FRAMES
    pairs_begin = next(
        full_drive().pairs()
    ).timestamp  # other formats have stamps since 1970: times count from the first
    for pair, original in zip(pairs, full_drive().pairs(), strict=True):
        begin = 0.0 if format_name == "kitti" else pairs_begin
        assert pair.timestamp == pytest.approx(original.timestamp - begin, abs=1e-9)
        np.testing.assert_array_equal(pair.left, original.left)
        np.testing.assert_array_equal(pair.right, original.right)
        np.testing.assert_allclose(pair.truth.position, original.truth.position, atol=1e-9)
        np.testing.assert_allclose(pair.truth.R_wc, original.truth.R_wc, atol=1e-9)
        if original.odometry is not None and "odometry" in keeps:
            np.testing.assert_allclose(pair.odometry.linear, original.odometry.linear, atol=1e-9)
            np.testing.assert_allclose(pair.odometry.angular, original.odometry.angular, atol=1e-9)
            np.testing.assert_allclose(pair.odometry.covariance, original.odometry.covariance, atol=1e-9)
        if original.inertial is not None and "inertial samples" in keeps:
            assert_same_samples(pair.inertial, original.inertial)
        if STATES in keeps:
            np.testing.assert_allclose(velocity_of_body(pair), velocity_of_body(original), atol=1e-9)
            np.testing.assert_allclose(pair.biases, original.biases, atol=1e-12)
            if format_name != "euroc":  # whose table has no angular velocity
                np.testing.assert_allclose(pair.velocity.angular, original.velocity.angular, atol=1e-12)
        else:
            assert pair.velocity is None
            assert pair.biases is None


def velocity_of_body(pair, place=UNIT.position):
    """Of the unit, in W, at its place in the camera's frame."""
    return pair.velocity.linear + pair.truth.R_wc @ np.cross(pair.velocity.angular, place)


@pytest.mark.parametrize("first", [0, 2])
@pytest.mark.parametrize("format_name", ["euroc", "tum-vi", "mcap", "bag"])
def test_a_recording_that_was_read_can_be_written_again(tmp_path, format_name, first):
    """Rows at stamps of their own, as a unit that is not triggered by the cameras has them, no two as far apart."""
    place = place_of(tmp_path, "euroc", full_drive())
    table, rng = place / "mav0" / "imu0" / "data.csv", np.random.default_rng(1)
    header, *lines = table.read_text().splitlines()
    rows = [line.split(",") for line in lines]
    moved = [[str(int(row[0]) + int(rng.uniform(-4e5, 4e5))), *row[1:]] for row in rows]
    table.write_text("\n".join([header, *(",".join(row) for row in moved)]) + "\n")
    once = open_image_sequence(place, first=first)
    written = write_recording(once, tmp_path / "again", format_name, may_lose=KINDS - FORMATS[format_name].keeps)
    again, before = list(read_again(written, format_name).pairs()), list(once.pairs())
    assert [pair.inertial is None for pair in again] == [True] + [False] * (FRAMES - first - 1)
    for pair, other in zip(again, before, strict=True):
        np.testing.assert_array_equal(pair.left, other.left)
        np.testing.assert_allclose(pair.truth.position, other.truth.position, atol=1e-9)
        assert (pair.inertial is None) == (other.inertial is None)
        if pair.inertial is not None:
            assert_same_samples(pair.inertial, other.inertial)
        if STATES in FORMATS[format_name].keeps:
            np.testing.assert_allclose(velocity_of_body(pair), velocity_of_body(other), atol=1e-9)
            np.testing.assert_allclose(pair.biases, other.biases, atol=1e-12)


@pytest.mark.parametrize("format_name", ["euroc", "tum-vi", "mcap", "bag"])
@pytest.mark.parametrize("by_settings", [False, True])
def test_the_clock_of_the_unit_may_be_another_one(tmp_path, format_name, by_settings):
    place = place_of(tmp_path, format_name, full_drive(), time_offset=0.0123)
    told = {"rig": str(place / "settings" / "kalibr" / "camchain.yaml")} if by_settings else {}
    for pair, original in zip(read_again(place, format_name, **told).pairs(), full_drive().pairs(), strict=True):
        if original.inertial is not None:
            assert_same_samples(pair.inertial, original.inertial)


@pytest.mark.parametrize("format_name", FORMATS)
def test_the_truth_of_body_and_camera_is_in_a_world_with_z_up(tmp_path, format_name):
    place = place_of(tmp_path, format_name, full_drive())
    body, camera = (load_trajectory(place / f"truth_{name}.tum") for name in ("body", "left_camera"))
    T_cb = Pose(UNIT.position, UNIT.orientation)
    for k, pair in enumerate(full_drive().pairs()):
        begin = 0 if format_name == "kitti" else 1_700_000_000
        assert camera.timestamps[k] == pytest.approx(begin + pair.timestamp, abs=1e-6)
        x, y, z = pair.truth.position
        np.testing.assert_allclose(camera.positions[k], [z, -x, -y], atol=1e-12)  # z forward, y down
        T_ub = camera.pose(k) @ (T_BASE_CAMERA.inverse() if format_name == "kitti" else T_cb)
        np.testing.assert_allclose(body.positions[k], T_ub.position, atol=1e-12)
        np.testing.assert_allclose(body.pose(k).R_wc, T_ub.R_wc, atol=1e-12)


def test_velocity_and_biases_are_those_of_the_body(tmp_path):
    place = place_of(tmp_path, "euroc", full_drive())
    table = place / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    rows = np.loadtxt(table, delimiter=",", comments="#")
    assert rows.shape == (FRAMES, 17)
    for row, pair in zip(rows, full_drive().pairs(), strict=True):
        of_unit = pair.velocity.linear + pair.truth.R_wc @ np.cross(pair.velocity.angular, UNIT.position)
        np.testing.assert_allclose(row[8:11], [of_unit[2], -of_unit[0], -of_unit[1]], atol=1e-12)
        np.testing.assert_allclose(row[11:], pair.biases, atol=1e-15)


def test_positions_and_velocities_of_the_body_agree(tmp_path):
    """Of a camera that turns about the lever arm of its unit, by differences."""
    turn, dt, every = np.array([0.0, 0.4, 0.1]), 1e-3, list(full_drive().pairs())
    poses = [Pose(np.zeros(3), rotations.exp_quaternion(k * dt * turn)) for k in range(3)]
    pairs = [
        replace(every[k], timestamp=k * dt, truth=pose, velocity=Velocity(np.zeros(3), turn), odometry=None, inertial=s)
        for k, (pose, s) in enumerate(
            zip(poses, [None, *2 * [InertialSamples([dt], [[0, 0, 0]], [[0, 0, 9.8]], UNIT)]], strict=True)
        )
    ]
    place = place_of(tmp_path, "euroc", Drive(pairs))
    rows = np.loadtxt(place / "mav0" / "state_groundtruth_estimate0" / "data.csv", delimiter=",", comments="#")
    np.testing.assert_allclose((rows[2, 1:4] - rows[0, 1:4]) / (2 * dt), rows[1, 8:11], atol=1e-6)


@pytest.mark.parametrize(
    ("format_name", "lost"),
    [
        ("kitti", "inertial samples and odometry and true velocities and biases"),
        ("tum-vi", "true velocities and biases"),
    ],
)
def test_what_a_format_has_no_place_for_is_named_before_anything_is_written(tmp_path, format_name, lost):
    with pytest.raises(ValueError, match=f"the format {format_name} has no place for {lost}.* choose euroc, mcap"):
        write_recording(full_drive(), tmp_path / "out", format_name)
    assert list(tmp_path.iterdir()) == []


def test_what_was_left_out_is_said_afterwards(tmp_path, caplog):
    write_recording(full_drive(), tmp_path / "out", "tum-vi", may_lose=KINDS)
    assert "left out, as the format tum-vi has no place for them: true velocities and biases" in caplog.text


@pytest.mark.parametrize(("format_name", "kind"), [("mcap", "odometry"), ("bag", "odometry")])
def test_an_odometry_of_a_bag_that_was_not_asked_for_is_not_lost_unsaid(tmp_path, format_name, kind):
    bag = place_of(tmp_path, format_name, full_drive()) / FORMATS[format_name].file
    with pytest.raises(ValueError, match=r"has /wheel/odometry, which would be lost.* name it \(--odometry-topic"):
        write_recording(open_image_sequence(bag), tmp_path / "out", "euroc")
    assert not (tmp_path / "out.partial").exists()
    out = write_recording(open_image_sequence(bag), tmp_path / "out", "euroc", may_lose={kind})
    assert all(pair.odometry is None for pair in open_image_sequence(out).pairs())


@pytest.mark.parametrize("format_name", ["euroc", "mcap", "bag"])
def test_a_camera_that_is_not_level_is_so_after_any_format(tmp_path, format_name):
    tilted = full_drive()
    tilted.gravity = rotations.exp(np.array([0.3, 0.1, -0.2])) @ [0.0, 9.81, 0.0]
    once = read_again(place_of(tmp_path, format_name, tilted), format_name)
    write_recording(once, tmp_path / "again", "euroc")
    np.testing.assert_allclose(once.gravity, tilted.gravity, atol=1e-9)
    one, other = (load_trajectory(tmp_path / name / "truth_body.tum") for name in ("drive", "again"))
    np.testing.assert_allclose(one.positions - one.positions[0], other.positions - other.positions[0], atol=1e-9)
    up_of_each = [each.pose(0).R_wc.T[:, 2] for each in (one, other)]
    np.testing.assert_allclose(*up_of_each, atol=1e-9)


def test_another_calibration_turns_all_that_the_left_camera_carries(tmp_path):
    place = place_of(tmp_path, "euroc", full_drive())
    chain = yaml.safe_load((place / "settings" / "kalibr" / "camchain.yaml").read_text())
    T_rl = np.array(chain["cam1"]["T_cn_cnm1"])
    T_rl[:3, :3] = rotations.exp(np.array([0.0, 0.03, 0.0]))
    chain["cam1"]["T_cn_cnm1"] = T_rl.tolist()
    del chain["cam1"]["T_cam_imu"]
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(chain))
    sequence = open_image_sequence(place, rig=str(tmp_path / "rig.yaml"))
    R = sequence.R_left
    assert np.linalg.norm(rotations.log(R)) > 0.01
    np.testing.assert_allclose(sequence.gravity, R @ [0.0, 9.81, 0.0], atol=1e-9)
    for pair, original in zip(sequence.pairs(), full_drive().pairs(), strict=True):
        if original.inertial is not None:
            np.testing.assert_allclose(pair.inertial.unit.position, R @ UNIT.position, atol=1e-9)
            np.testing.assert_allclose(
                Pose(np.zeros(3), pair.inertial.unit.orientation).R_wc,
                R @ Pose(np.zeros(3), UNIT.orientation).R_wc,
                atol=1e-9,
            )
        np.testing.assert_allclose(pair.truth.position, R @ original.truth.position, atol=1e-9)
        np.testing.assert_allclose(velocity_of_body(pair, R @ UNIT.position), R @ velocity_of_body(original), atol=1e-9)


def test_what_was_stopped_goes_on_and_ends_with_the_same_bytes(tmp_path):
    def stop(done, of):
        if done == 3:
            raise KeyboardInterrupt

    class Drawn(Drive):
        draws_on_demand, drawn = True, 0

        def pairs(self, is_drawn):
            nothing = np.zeros((0, 0), np.uint8)
            for number, pair in enumerate(super().pairs()):
                if is_drawn(number, pair.timestamp):
                    self.drawn += 1
                    yield pair
                else:
                    yield replace(pair, left=nothing, right=nothing)

    whole = write_recording(Drawn(full_drive()._pairs), tmp_path / "whole", "euroc")
    with pytest.raises(KeyboardInterrupt):
        write_recording(Drawn(full_drive()._pairs), tmp_path / "out", "euroc", on_pair=stop)
    with pytest.raises(ValueError, match="no known layout"):
        open_image_sequence(tmp_path / "out.partial")
    again = Drawn(full_drive()._pairs)
    resumed = write_recording(again, tmp_path / "out", "euroc")
    assert again.drawn == FRAMES - 3 + 2  # two are looked at before it is known where they go
    files = sorted(path.relative_to(whole) for path in whole.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(resumed) for path in resumed.rglob("*") if path.is_file())
    for file in files:
        assert (whole / file).read_bytes() == (resumed / file).read_bytes(), file


@pytest.mark.parametrize("format_name", NEEDS_ROSBAGS)
def test_the_same_drive_has_the_same_bytes_as_a_bag(tmp_path, format_name):
    one, other = (place_of(tmp_path / name, format_name, full_drive()) for name in "ab")
    for file in (path for path in one.rglob("*") if path.is_file()):
        assert file.read_bytes() == (other / file.relative_to(one)).read_bytes(), file


def test_a_drive_that_is_there_is_kept_where_it_is_the_same(tmp_path):
    place = place_of(tmp_path, "euroc", full_drive())
    assert write_recording(full_drive(), place, "euroc", keep_same=True) == place
    with pytest.raises(ValueError, match="drive is not empty: choose another name"):
        write_recording(full_drive(), place, "euroc")
    with pytest.raises(ValueError, match="drive is not empty: choose another name"):
        write_recording(full_drive(), place, "euroc", keep_same=True, time_offset=0.1)


def test_nothing_of_others_goes_and_two_do_not_write_one_drive(tmp_path):
    def check(done, of):
        if done == 2:
            with pytest.raises(ValueError, match=r"drive\.partial is in use by another process"):
                write_recording(full_drive(), tmp_path / "drive", "euroc")
            (tmp_path / "drive.partial" / "mine.txt").write_text("kept")

    place = place_of(tmp_path, "euroc", full_drive(), on_pair=check)
    assert (place / "mine.txt").read_text() == "kept"
    with pytest.raises(ValueError, match=r"out must end in \.mcap, or be a folder, for the format mcap, got .*d\.bag"):
        write_recording(full_drive(), tmp_path / "d.bag", "mcap")


@pytest.mark.parametrize("format_name", ["mcap", "bag"])
def test_images_in_a_bag_may_be_packed(tmp_path, format_name):
    place = place_of(tmp_path, format_name, full_drive(), compressed=True)
    sequence = read_again(place, format_name)
    assert sequence.source["topics"] == [f"/stereo/{side}/image_rect/compressed" for side in ("left", "right")]
    for pair, original in zip(sequence.pairs(), drive().pairs(), strict=True):
        np.testing.assert_array_equal(pair.left, original.left)
    with pytest.raises(ValueError, match="compressed must be left out of the format euroc: its images are PNG"):
        place_of(tmp_path / "e", "euroc", full_drive(), compressed=True)


@pytest.mark.parametrize("format_name", ["mcap", "db3", "bag"])
def test_the_pose_of_the_odometry_grows_in_doubt_as_its_steps_say(tmp_path, format_name):
    """By samples: steps with errors of their covariance, put one behind the other."""
    rng, doubt = np.random.default_rng(0), np.diag(np.repeat([1e-4, 1e-2], 3))
    step = BodyVelocity([0.3, 0.1, 8.0], [0.1, 0.4, -0.2], doubt)
    pairs = [pair if pair.odometry is None else replace(pair, odometry=step) for pair in full_drive().pairs()]
    place = place_of(tmp_path, format_name, Drive(pairs))
    stated = load_trajectory(f"{place / FORMATS[format_name].file}:/wheel/odometry")
    R_bc = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    dts = [after.timestamp - before.timestamp for before, after in pairwise(pairs)]

    def driven(errors):
        pose = Pose(np.zeros(3), [0.0, 0.0, 0.0, 1.0])
        for error, dt in zip(errors, dts, strict=True):
            v, turn = dt * (step.linear + error[:3]), dt * (step.angular + error[3:])
            pose = pose @ Pose(rotations.exp(0.5 * turn) @ v, rotations.exp_quaternion(turn))
        return pose

    true, ends = driven(np.zeros((len(dts), 6))), []
    for _ in range(4000):
        pose = driven(rng.multivariate_normal(np.zeros(6), doubt, len(dts)))
        apart = R_bc @ (pose.position - true.position)
        ends.append(np.concatenate([apart, rotations.log(R_bc @ true.R_wc.T @ pose.R_wc @ R_bc.T)]))
    spread, last = np.cov(np.array(ends).T), stated.pose_covariances[-1]
    sigmas = np.sqrt(np.diag(spread))
    np.testing.assert_allclose(last / np.outer(sigmas, sigmas), spread / np.outer(sigmas, sigmas), atol=0.1)


@pytest.mark.parametrize("format_name", FORMATS)
def test_the_settings_beside_it_state_the_rig(tmp_path, format_name):
    place = place_of(tmp_path, format_name, full_drive(), about={"Seed": "7"})
    stated = read_calibration(place / "settings" / "kalibr" / "camchain.yaml")
    assert stated.camera.baseline == pytest.approx(CAMERA.baseline, abs=1e-12)
    page = (place / "README.md").read_text()
    assert FORMATS[format_name].line in page
    assert ("the velocity of B" in page) == (STATES in FORMATS[format_name].keeps)


def test_evo_reads_the_truth(tmp_path):
    pytest.importorskip("evo")
    from evo.tools import file_interface

    place = place_of(tmp_path, "euroc", full_drive())
    truth = file_interface.read_tum_trajectory_file(place / "truth_body.tum")
    csv = file_interface.read_euroc_csv_trajectory(place / "mav0" / "state_groundtruth_estimate0" / "data.csv")
    np.testing.assert_allclose(truth.positions_xyz, csv.positions_xyz, atol=1e-12)
    assert truth.num_poses == FRAMES


@pytest.mark.parametrize("format_name", NEEDS_ROSBAGS)
def test_rosbags_reads_what_stands_on_the_topics(tmp_path, format_name):
    place = place_of(tmp_path, format_name, full_drive())
    from rosbags.highlevel import AnyReader

    with AnyReader([place / FORMATS[format_name].file]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    samples = round(RATE * (FRAMES - 1) * 0.1)
    assert counts == {
        **{f"/stereo/{side}/{kind}": FRAMES for side in ("left", "right") for kind in ("camera_info", "image_rect")},
        **dict.fromkeys(("/ground_truth", "/ground_truth/imu_bias", "/wheel/odometry"), FRAMES),
        **{"/imu/data": samples, "/imu/noise": 1, "/tf_static": 1, "/ground_truth/reference": 1},
    }


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda cells: [*cells[:3], "nan", *cells[4:]], r"odom0/data\.csv: the row of \d+ is no velocity with a cov"),
        (lambda cells: [*cells[:7], "-1.0", *cells[8:]], r"odom0/data\.csv: the row of \d+ is no velocity with a cov"),
        (lambda cells: cells[:12], r"odom0/data\.csv: line 2 is not a timestamp in ns and 27 numbers"),
        (lambda cells: ["17e17", *cells[1:]], r"odom0/data\.csv: line 2 is not a timestamp in ns and 27 numbers"),
    ],
)
def test_an_odometry_that_is_none_is_named(tmp_path, change, complaint):
    place = place_of(tmp_path, "euroc", full_drive())
    table = place / "mav0" / "odom0" / "data.csv"
    header, *lines = table.read_text().splitlines()
    table.write_text("\n".join([header, *(",".join(change(line.split(","))) for line in lines)]) + "\n")
    with pytest.raises(ValueError, match=complaint):
        open_image_sequence(place)


def test_rows_of_an_odometry_that_belong_to_no_image_give_no_step(tmp_path):
    place = place_of(tmp_path, "euroc", full_drive())
    table = place / "mav0" / "odom0" / "data.csv"
    header, *lines = table.read_text().splitlines()
    table.write_text("\n".join([header, "1" + lines[0][1:].replace(",", "1,", 1)[1:], *lines[1:]]) + "\n")
    steps = [pair.odometry for pair in open_image_sequence(place).pairs()]
    assert [step is None for step in steps] == [True, True] + [False] * (FRAMES - 2)


@pytest.mark.parametrize("format_name", FORMATS)
def test_the_folder_says_that_the_truth_is_of_a_simulation(tmp_path, format_name):
    """Also a single file, and a recording that was read and written again; its rig is then exact."""
    once = read_again(place_of(tmp_path, format_name, full_drive()), format_name)
    assert once.truth_from == SIMULATION
    again = write_recording(once, tmp_path / "again", "euroc")
    assert open_image_sequence(again / "mav0").truth_from == SIMULATION
    if format_name in ("mcap", "bag"):
        alone = (tmp_path / "drive" / FORMATS[format_name].file).rename(tmp_path / f"alone.{format_name}")
        assert open_image_sequence(alone).truth_from == SIMULATION
    given = open_image_sequence(again, truth=again / "truth_left_camera.tum")
    assert given.truth_from.kind == "unknown"


def test_a_file_of_that_name_that_says_nothing_or_nonsense(tmp_path):
    place = place_of(tmp_path, "euroc", full_drive())
    for text in ("", "\0", "[1, 2]", "{}", '{"format": "euroc"}', '{"truth_from": {"kind": "simulation"}}'):
        (place / "source.json").write_text(text)
        assert open_image_sequence(place).truth_from.kind == "unknown"
    (place / "source.json").write_text('{"format": "euroc", "truth_from": {"kind": "divine", "description": ""}}')
    with pytest.raises(ValueError, match=r"source\.json: truth_from is no reference \(kind of a reference must be"):
        open_image_sequence(place)


@pytest.mark.parametrize("format_name", NEEDS_ROSBAGS)
def test_the_folder_of_a_drive_that_is_a_bag_stands_for_it(tmp_path, format_name):
    place = place_of(tmp_path, format_name, full_drive())
    assert len(open_image_sequence(place)) == FRAMES
    (place / "source.json").unlink()
    if format_name != "db3":  # a folder by itself
        with pytest.raises(ValueError, match="no known layout"):
            open_image_sequence(place)


@pytest.mark.parametrize("format_name", NEEDS_ROSBAGS)
def test_true_velocities_and_biases_of_a_bag_are_a_truth_of_states(tmp_path, format_name):
    bag = place_of(tmp_path, format_name, full_drive()) / FORMATS[format_name].file
    table = place_of(tmp_path / "b", "euroc", full_drive()) / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    one, other = load_trajectory(f"{bag}:/ground_truth"), load_trajectory(table)
    assert set(one.states) == set(other.states) == {"velocity", "gyro-bias", "accelerometer-bias"}
    for name, belief in one.states.items():
        np.testing.assert_allclose(belief.values, other.states[name].values, atol=1e-9)
        assert belief.covariances is None
