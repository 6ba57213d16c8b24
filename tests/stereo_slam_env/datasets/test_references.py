"""What is said of the true poses of a recording: their maker where it is known by its digest, else nothing (5 s)."""

import re
import shutil

import numpy as np
import pytest

from stereo_slam_env.datasets import layouts, load, open_image_sequence
from stereo_slam_env.datasets.layouts import KnownRecording, digest, known_by
from stereo_slam_env.recording.recording import Reference

from ..real_data import real_data
from .small_folders import R_CI, kitti00, kitti07, starry_night
from .small_image_folders import FRAMES, kitti06, kitti_odometry, kitti_raw
from .small_image_folders import karlsruhe as karlsruhe_folder
from .test_euroc import euroc

MAKERS = re.compile(r"KITTI|GPS|\bINS\b|RTK|[Mm]otion capture|[Ll]aser|EuRoC|no camera")
TRACKS = {"kitti07_tracks": kitti07, "kitti00_stereo_tracks": kitti00, "starry_night": starry_night}
SIZES = {"kitti07_tracks": (1226, 370), "kitti00_stereo_tracks": (1241, 376), "starry_night": (646, 480)}
IMAGES = {
    "kitti_odometry": kitti_odometry,
    "kitti_raw": kitti_raw,
    "karlsruhe": karlsruhe_folder,
    "kitti06_stereo51": kitti06,
    "euroc": euroc,
}
KITTI, EUROC, TUM_VI = (1.5e-3, 1.5e-4), (1e-3, 2.7e-3), (1e-4, 8e-4)
"""Jitter that is stated of the positions, m, and of the rotations, rad; sources: docs/covariances.md."""


def long_kitti06(folder, frames=20):
    """A folder of the layout `kitti06_stereo51` with more pairs than the INS of KITTI 06 takes to settle."""
    kitti06(folder)
    for k in range(FRAMES, frames):
        for side in ("image_l", "image_r"):
            shutil.copy(folder / side / f"{k % FRAMES:06d}.png", folder / side / f"{k:06d}.png")
    rows = np.tile([1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0], (frames, 1))
    rows[:, 11] = 0.4 * np.arange(frames)
    np.savetxt(folder / "poses.txt", rows)
    velocities = np.column_stack([0.1 * np.arange(frames + 1), np.full(frames + 1, 4.0), np.zeros((frames + 1, 5))])
    np.savetxt(folder / "odometry_oxts.csv", velocities, delimiter=",", header="t,vx,vy,vz,wx,wy,wz", comments="")
    return rows[:, 3::4]


def known_as(monkeypatch, positions, first_scored):
    """Let these positions be those of a known recording."""
    made = KnownRecording(Reference("surveyed", "By the makers."), first_scored)
    monkeypatch.setattr(layouts, "KNOWN", {digest(positions): made})


@pytest.mark.parametrize("layout", [*TRACKS, *IMAGES])
def test_of_a_strangers_recording_no_maker_is_named_whatever_its_layout(tmp_path, layout):
    folder = tmp_path / "mine"
    folder.mkdir()
    if layout in TRACKS:
        reference = load(TRACKS[layout](folder)).truth_from
    else:
        first = 60 if layout == "karlsruhe" else None
        reference = open_image_sequence(IMAGES[layout](folder), first=first).truth_from
    assert reference.kind == "unknown"
    assert str(reference).startswith("stated by the recording, origin unknown. ")
    assert not MAKERS.search(str(reference)), str(reference)


@pytest.mark.parametrize("layout", [*TRACKS, "kitti06_stereo51"])
def test_a_strangers_recording_has_the_name_of_its_folder_not_of_a_public_one(tmp_path, layout):
    folder = {**TRACKS, **IMAGES}[layout](tmp_path / "our_car")
    opened = load(folder) if layout in TRACKS else open_image_sequence(folder)
    assert opened.name == "our_car"
    assert opened.source["reader"] == layout


def test_no_pair_no_pose_and_no_step_of_a_strangers_recording_is_left_out(tmp_path):
    """What the makers' references are known for, an INS that settles or begins late, is nobody else's fault."""
    long_kitti06(tmp_path / "a")
    sequence = open_image_sequence(tmp_path / "a")
    assert sequence.frame_numbers == tuple(range(20))
    assert sequence.truth_from.settled_at is None
    recording = load(kitti00(tmp_path / "b"))
    assert all(frame.truth is not None for frame in recording.frames)
    np.testing.assert_allclose(recording.frames[0].truth.position, 0.0, atol=1e-9)
    assert len(load(starry_night(tmp_path / "c"))) == 12


def test_a_known_recording_has_its_maker_and_its_name_and_leaves_out_what_had_not_settled(tmp_path, monkeypatch):
    known_as(monkeypatch, long_kitti06(tmp_path / "a"), 12)
    sequence = open_image_sequence(tmp_path / "a")
    assert sequence.name == "kitti06_stereo51"
    assert sequence.frame_numbers == tuple(range(12, 20))
    assert (sequence.truth_from.kind, sequence.truth_from.settled_at) == ("surveyed", pytest.approx(1.2))
    assert open_image_sequence(tmp_path / "a", first=0).frame_numbers == tuple(range(20))


def test_where_the_poses_settle_belongs_to_them_and_not_to_the_layout(tmp_path, monkeypatch):
    folder = kitti_odometry(tmp_path)
    known_as(monkeypatch, np.loadtxt(tmp_path / "poses" / "07.txt")[:, 3::4], 2)
    assert open_image_sequence(folder).frame_numbers == tuple(range(2, FRAMES))


def test_a_digest_is_of_all_positions_to_the_last_bit_and_of_nothing_else():
    positions = np.random.default_rng(0).normal(size=(50, 3))
    nudged = positions.copy()
    nudged[31, 1] = np.nextafter(nudged[31, 1], 9.0)
    assert digest(positions) == digest(np.asfortranarray(positions))
    assert len({digest(rows) for rows in (positions, nudged, positions[:-1], positions[::-1])}) == 4
    assert known_by(positions) is None


@pytest.mark.parametrize(
    ("file", "kind", "said", "first_scored", "jitter"),
    [
        ("kitti_poses/00.txt", "ins", "KITTI", 16, KITTI),
        ("kitti_poses/02.txt", "ins", "KITTI", 0, KITTI),
        ("kitti_poses/06.txt", "ins", "KITTI", 12, KITTI),
        ("kitti00_stereo_tracks/poses.txt", "ins", "KITTI", 16, KITTI),
        ("kitti06_stereo51/poses.txt", "ins", "KITTI", 12, KITTI),
        ("kitti07_tracks/poses.txt", "ins", "KITTI", 0, KITTI),
        ("field/trajectories/euroc_v102/V102_groundtruth.csv", "surveyed", "motion capture", 0, EUROC),
        ("field/trajectories/openvins_mh04/MH_04_difficult.txt", "surveyed", "laser tracker", 0, EUROC),
        ("field/tumvi_gt/dataset-room1_512_16.csv", "surveyed", "TUM-VI", 0, TUM_VI),
    ],
)
def test_the_published_poses_are_known_with_the_errors_that_are_stated_of_them(file, kind, said, first_scored, jitter):
    folder, _, name = file.partition("/")
    path = real_data(folder) / name
    rows = np.loadtxt(path, delimiter="," if path.suffix == ".csv" else None)
    positions = rows[:, 3::4] if rows.shape[1] == 12 else rows[:, 1:4]
    known = known_by(positions)
    assert (known.reference.kind, known.first_scored) == (kind, first_scored)
    assert said in known.reference.description
    assert (known.reference.position_jitter, known.reference.rotation_jitter) == jitter
    assert known_by(positions[1:]) is None


def test_a_kind_can_be_stated_and_keeps_what_the_reader_knows():
    stated = Reference("unknown", "poses.txt of the recording.").stating({"kind": "ins", "position_jitter": 0.02})
    assert str(stated) == (
        "independent truth (GPS/INS). poses.txt of the recording. Its kind was stated for this run. "
        "Its stated errors: jitter of 20 mm."
    )
    assert stated.is_independent


@pytest.mark.parametrize(
    ("stated", "complaint"),
    [
        ({"kind": "gps"}, "kind of a reference must be one of 'simulation', 'surveyed', 'ins', 'odometry', 'unknown'"),
        ({"kind": 3.0}, "kind of a reference must be one of"),
        ({"kind": "none"}, "kind 'none' of a reference cannot be stated"),
        ({"position_jitter": "small"}, "position_jitter of a reference must be a number, got 'small'"),
        ({"kinds": "ins"}, "reference has no statement 'kinds', did you mean 'kind'"),
    ],
)
def test_what_cannot_be_stated_is_refused_in_one_line(stated, complaint):
    with pytest.raises(ValueError, match=complaint) as caught:
        Reference("unknown", "By hand.").stating(stated)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "independent", "truth"),
    [
        *(("simulation", True, True), ("surveyed", True, True), ("ins", True, True)),
        *(("unknown", False, True), ("odometry", False, False), ("none", False, False)),
    ],
)
def test_what_each_kind_is_good_for(kind, independent, truth):
    reference = Reference(kind, "By hand.")
    assert (reference.is_independent, reference.counts_as_truth) == (independent, truth)


@pytest.mark.parametrize("layout", TRACKS)
def test_a_strangers_recording_has_neither_the_image_size_nor_the_noise_of_a_public_one(tmp_path, layout, caplog):
    recording = load(TRACKS[layout](tmp_path / "our_car"))
    seen = np.vstack([frame.observation.uvd for frame in recording.frames])
    assert (recording.camera.width, recording.camera.height) != SIZES[layout]
    assert recording.camera.width - 1 >= seen[:, 0].max() > recording.camera.width - 60  # the smallest that hold all
    assert recording.camera.height - 1 >= seen[:, 1].max() > recording.camera.height - 60
    np.testing.assert_allclose(np.sqrt(np.diag(recording.noise.R)), [2.0, 2.0, 2.0 * np.sqrt(2.0)])
    if recording.frames[1].odometry is not None:
        np.testing.assert_allclose(np.diag(recording.frames[1].odometry.covariance)[3:], 0.05**2)
    (told,) = (record.getMessage() for record in caplog.records if "does not hold" in record.getMessage())
    assert "\n" not in told
    assert "image_size=" in told
    assert "our_car" in told


@pytest.mark.parametrize("layout", TRACKS)
def test_what_is_said_of_a_strangers_recording_holds(tmp_path, layout, caplog):
    noise = {"sigma_u": 1.0, "sigma_v": 1.0, "sigma_d": 1.5} if layout == "starry_night" else {"sigma_px": 1.0}
    velocities = {} if layout == "kitti00_stereo_tracks" else {"sigma_linear": 0.2, "sigma_angular": 0.01}
    folder = TRACKS[layout](tmp_path / "our_car")
    recording = load(folder, image_size=(800, 600), **noise, **velocities)
    assert (recording.camera.width, recording.camera.height) == (800, 600)
    assert recording.noise.R[0, 0] == 1.0
    assert not [record for record in caplog.records if "does not hold" in record.getMessage()]
    with pytest.raises(ValueError, match="image_size must be"):
        load(folder, image_size=800)


@pytest.mark.parametrize("layout", TRACKS)
def test_a_known_recording_keeps_its_image_size(tmp_path, layout, monkeypatch, caplog):
    folder = TRACKS[layout](tmp_path / "known")
    if layout == "starry_night":
        positions = np.load(folder / "starry_night.npz")["r_i_vk_i"].T
    else:
        positions = np.loadtxt(folder / "poses.txt")[:, 3::4]
    known_as(monkeypatch, positions, 0)
    recording = load(folder)
    assert (recording.camera.width, recording.camera.height) == SIZES[layout]
    assert not [record for record in caplog.records if "does not hold" in record.getMessage()]


def test_angular_velocities_of_a_stranger_are_read_at_their_time(tmp_path):
    """The delay is one of the gyro of a public recording."""
    with np.load(starry_night(tmp_path / "steady") / "starry_night.npz") as archive:
        rate = archive["w_vk_vk_i"] * np.linspace(1.0, 2.0, 12)
    folder = starry_night(tmp_path / "faster", w_vk_vk_i=rate)
    at_once, late = load(folder), load(folder, gyro_delay=0.1)
    mean = -0.5 * (rate[:, 4] + rate[:, 5])
    np.testing.assert_allclose(at_once.frames[5].odometry.angular, R_CI @ mean, atol=1e-12)
    np.testing.assert_allclose(late.frames[4].odometry.angular, R_CI @ mean, atol=1e-9)
