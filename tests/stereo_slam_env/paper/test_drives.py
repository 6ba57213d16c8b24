"""The drives of the study, and the same judgements on recordings that are not ours to simulate (20 s)."""

import os
from dataclasses import replace

import numpy as np
import pytest

from stereo_slam_env.benchmark import short_turn
from stereo_slam_env.paper import convergence, drives, long_drive
from stereo_slam_env.paper.paper_claims import OWN, REAL, RENDERED, ClaimVerdict
from stereo_slam_env.recording.archive import save_recording

from ..datasets.small_image_folders import karlsruhe as write_sequence


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A small rendered drive in the layout of the Karlsruhe sequences, called as the paper's turn."""
    return write_sequence(tmp_path_factory.mktemp("karlsruhe"))


@pytest.fixture
def without_gtsam(monkeypatch):
    monkeypatch.setattr(drives, "_has_gtsam", lambda: False)


@pytest.fixture(scope="module")
def recording_file(tmp_path_factory):
    """A drive of 49 frames in a file; for the study it is real."""
    from stereo_slam_env.benchmark import long_drive as simulate

    path = tmp_path_factory.mktemp("file") / "my drive.npz"
    save_recording(path, simulate(3, frames=49))
    return path


@pytest.fixture(scope="module")
def results(recording_file):
    drive = drives.RealDrive(str(recording_file))
    about = (f"{REAL}-mine", drive.source, drive.first, drive.last, drive.state)
    return {
        f"turn.{REAL}-mine.0000": convergence.turns(*about),
        f"drive.{REAL}-mine.0000": long_drive.drive(*about),
    }


def test_the_papers_recordings_are_found_in_a_folder_or_are_it(folder, without_gtsam):
    wanted = {drives.KARLSRUHE_TURN: drives.RealDrive(str(folder.resolve()), 61, 72)}
    assert drives.real_drives([], folder.parent) == drives.real_drives([], folder) == wanted


def test_a_folder_without_them_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"holds neither 2009_09_08_drive_0010 nor 2009_09_08_drive_0015"):
        drives.real_drives([], tmp_path)


def test_what_is_no_drive_and_two_of_one_name_are_refused_before_anything_runs(tmp_path, folder, without_gtsam):
    with pytest.raises(ValueError, match="does not exist: give what"):
        drives.real_drives([tmp_path / "nowhere"])
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match="has no known layout: give what"):
        drives.real_drives([tmp_path])
    (tmp_path / "cut.npz").write_text("no archive")
    with pytest.raises(ValueError, match=r"cut\.npz is damaged"):
        drives.real_drives([tmp_path / "cut.npz"])
    with pytest.raises(ValueError, match=f"two real drives have the name '{folder.name}'"):
        drives.real_drives([folder, folder])


def test_the_name_of_a_drive_can_name_a_file(recording_file, without_gtsam):
    assert list(drives.real_drives([recording_file])) == ["my_drive"]


def test_the_state_of_a_drive_is_that_of_its_files(folder, recording_file):
    assert drives.RealDrive(str(folder)).state[0] == len(list(folder.iterdir()))
    assert drives.RealDrive(str(recording_file)).state[:2] == [1, recording_file.stat().st_size]


def test_frames_of_images_are_those_that_were_asked_for(folder):
    recording = drives.RealDrive(str(folder), 61, 64).load()
    assert len(recording) == 4


def test_with_the_papers_R_no_measurement_keeps_its_own():
    recording = short_turn(0, frames=3)
    own = recording.with_observations(
        replace(frame.observation, R=np.tile(np.eye(3), (len(frame.observation.ids), 1, 1)))
        for frame in recording.frames
    )
    setting = drives.setting(RENDERED)
    with_own, noise = setting.seen(own, OWN)
    assert noise is None
    assert with_own.frames[0].observation.R is not None
    plain, noise = setting.seen(own, "diagonal")
    assert all(frame.observation.R is None for frame in plain.frames)
    np.testing.assert_array_equal(noise.R, np.eye(3))


def test_a_real_drive_is_cut_into_turns(results):
    (depths,) = convergence.settings(results)
    assert set(depths.drive) <= set(range(49 // (convergence.UPDATES + 1)))
    assert depths.raw.shape[1] == convergence.UPDATES + 1
    judged = {claim.sentence.key: claim for claim in convergence.judge(results)}
    assert all(finding.condition["drive"] == "mine" for finding in judged["uncertainty-converges"].findings)
    assert {finding.place for finding in judged["uncertainty-converges"].findings} == {REAL}


def test_accuracy_of_one_drive_is_taken_as_it_is_and_its_nees_is_not(results):
    judged = {claim.sentence.key: claim for claim in long_drive.judge(results)}
    for finding in judged["trajectory"].findings:
        assert finding.measured.low == finding.measured.value == finding.measured.high
    assert judged["trajectory"].verdict is ClaimVerdict.HOLDS
    by_pose = [one for one in judged["consistent"].findings if one.condition["by"] == "pose error"]
    assert by_pose
    for finding in by_pose:
        assert finding.measured.low < finding.measured.value < finding.measured.high


def test_a_truth_made_of_the_images_judges_no_accuracy(recording_file):
    """As that of KITTI 00 in the wheel of gtsam, which is visual odometry."""
    recording = drives.RealDrive(str(recording_file)).load()
    circular = replace(recording, truth_from=replace(recording.truth_from, kind="odometry"))
    run = long_drive.filtered(circular, drives.setting(f"{REAL}-x"), "inverse-depth", OWN, None)
    values = long_drive.quantities(run)
    assert np.isnan([values[name] for name in long_drive.ACCURACY]).all()
    assert np.isfinite(values["nis"])


def test_a_drive_that_is_too_short_for_a_turn_is_left_out(folder):
    assert convergence.turns(f"{REAL}-x", str(folder), 60, 65, []) == {}
    assert drives.settings_of({"turn.real-x.0000": {}}, "turn") == {}
