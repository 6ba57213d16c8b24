"""The ready-made scenarios (0.2 s)."""

import pytest

from stereo_slam_env.benchmark.campaign import check_study
from stereo_slam_env.benchmark.scenarios.study import preset, preset_study, presets

REAL = ("kitti07_tracks", "kitti00_stereo_tracks", "starry_night_a", "kitti06_stereo51")


@pytest.fixture
def data(tmp_path):
    """Folders of the names of the real recordings."""
    for name in REAL:
        (tmp_path / name).mkdir()
    return tmp_path


@pytest.mark.parametrize("name", presets())
def test_a_preset_has_its_name_a_line_on_itself_and_filters_that_exist(name, data):
    study = preset_study(name, data=data)
    if any(choice.name in ("batch", "fixed-lag") for cell in study.cells for choice in cell.scenario.filters):
        pytest.importorskip("gtsam", reason="batch and fixed-lag need the extra gtsam")
    assert study.name == name
    assert 20 < len(presets()[name]) < 120
    if name in ("real", "systems"):  # the folders of their recordings are empty here
        with pytest.raises(ValueError, match="is empty"):
            check_study(study)
    else:
        check_study(study)


@pytest.mark.parametrize("name", ["quick", "town", "turn", "straight", "reference-drive", "reference-turn"])
def test_what_is_assumed_is_said(name):
    scenario = preset(name)
    assert scenario.name == name
    assert scenario.noise == {"independent_pixels": 1.0}
    assert scenario.gate is None
    assert {choice.name for choice in scenario.filters} == {"inverse-depth", "dual-bearing", "euclidean"}


def test_the_real_recordings_are_those_of_the_folder(data):
    assert [cell.name for cell in preset_study("real", data=data).cells] == list(REAL)
    (data / REAL[0]).rmdir()
    assert [cell.name for cell in preset_study("real", data=data).cells] == list(REAL[1:])


def test_noise_and_assumed_noise_are_factors():
    study = preset_study("mismatch")
    assert len(study.cells) == 12
    assert set(study.cells[0].factors) == {"options.noise", "noise"}


def test_the_choices_of_the_core_are_crossed():
    study = preset_study("attribution")
    crossed = study.factorial
    assert set(crossed) == {"landmark", "measurement", "error"}
    assert len(study.only_scenario().filters) == 2 * 4 * 3


def test_landmarks_with_and_without_anchors_are_crossed_with_the_errors():
    study = preset_study("anchored")
    assert {factor: len(levels) for factor, levels in study.factorial.items()} == {"landmark": 3, "error": 4}
    assert [cell.factors["options.point_level"] for cell in study.cells] == [0.05, 0.15]
    assert all(cell.scenario.use_odometry and cell.scenario.gate is None for cell in study.cells)


def test_an_unknown_preset_is_answered_with_the_known_ones():
    with pytest.raises(ValueError, match=r"preset must be one of quick, .*, got 'quik', did you mean 'quick'"):
        preset("quik")
    with pytest.raises(ValueError, match="'mismatch' is a grid of 12 scenarios"):
        preset("mismatch")
