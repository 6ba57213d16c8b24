"""The same judgements on a small rendered drive in the layout of the Karlsruhe sequences (5 s)."""

import pytest

from stereo_slam_env.studies.paper import karlsruhe
from stereo_slam_env.studies.paper.claims import ClaimVerdict
from stereo_slam_env.studies.paper.report import karlsruhe_section

from ...datasets.small_image_folders import karlsruhe as write_sequence

FRAMES = (60, 65)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_sequence(tmp_path_factory.mktemp("karlsruhe"))


@pytest.fixture(scope="module")
def results(folder):
    return {
        f"karlsruhe-{karlsruhe.TURN}": karlsruhe.turn(folder, FRAMES),
        f"karlsruhe-{karlsruhe.DRIVE}": karlsruhe.drive(folder, FRAMES),
    }


@pytest.fixture(scope="module")
def long_enough(folder, results):
    """As if six frames were a drive."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stereo_slam_env.studies.paper.long_drive.CHORD", 2)
        return results | {f"karlsruhe-{karlsruhe.DRIVE}": karlsruhe.drive(folder, FRAMES)}


def test_sequences_are_found_in_a_folder_or_are_it(folder):
    assert karlsruhe.sequences(folder.parent) == {karlsruhe.TURN: folder}
    assert karlsruhe.sequences(folder) == {karlsruhe.TURN: folder}


def test_a_folder_without_them_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"holds neither 2009_09_08_drive_0010 nor 2009_09_08_drive_0015"):
        karlsruhe.sequences(tmp_path)


def test_the_experiments_know_the_frames_and_the_files(folder):
    (turn,) = karlsruhe.experiments({karlsruhe.TURN: folder}).values()
    assert turn.args == (str(folder.resolve()), (61, 72))
    assert turn.keywords["files"][0] == len(list(folder.iterdir()))


def test_landmarks_of_the_turn_are_followed_throughout(results):
    depths = karlsruhe.depths(results)
    assert len(depths.label) >= 3  # the images are as small as a stamp
    assert depths.raw.shape == (len(depths.label), 6)
    assert set(depths.label) <= {"near", "far", "between"}


def test_the_drive_is_judged_against_the_weak_truth(results):
    judged = {claim.sentence.key: claim for claim in karlsruhe.judge(results)}
    assert judged["karlsruhe-consistent"].sentence.statement.startswith("NIS")
    assert "karlsruhe-trajectory" not in judged  # six frames are no drive


def test_without_truth_and_without_results_nothing_is_claimed():
    assert karlsruhe.judge({}) == ()


def test_a_number_of_one_drive_is_taken_as_it_is(long_enough):
    judged = {claim.sentence.key: claim for claim in karlsruhe.judge(long_enough)}
    trajectory = judged["karlsruhe-trajectory"]
    assert trajectory.sentence.section == "4.4 (Karlsruhe)"
    for finding in trajectory.findings:
        assert finding.measured.low == finding.measured.value == finding.measured.high
    assert trajectory.verdict is ClaimVerdict.HOLDS  # a rendered drive of two metres


def test_the_page_gets_a_section_of_its_own(long_enough, tmp_path):
    judged = karlsruhe.judge(long_enough)
    section = karlsruhe_section(tmp_path, judged, long_enough)
    assert {path.stem for path in tmp_path.iterdir()} == {"karlsruhe-4", "karlsruhe-6"}
    assert section.count("<details>") == len(judged) == 10
