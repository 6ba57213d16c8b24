"""Files of runs by a pattern: any name for a seed, truths beside them, what is missing (< 1 s)."""

from pathlib import Path

import pytest

from stereo_slam_env.recording.seed_files import has_seed, seed_files, truth_beside

TRUTH = "mav0/state_groundtruth_estimate0/data.csv"


def touched(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("")


def test_a_seed_is_any_part_of_a_name_and_the_same_wherever_it_stands(tmp_path):
    touched(tmp_path, "run_a/est_a.tum", "run_b/est_b.tum", "run_b/est_a.tum", "true/a.csv", "true/b.csv", "x.tum")
    found = seed_files(tmp_path / "run_{seed}" / "est_{seed}.tum", tmp_path / "true" / "{seed}.csv")
    assert found.pairs == {s: (tmp_path / f"run_{s}/est_{s}.tum", tmp_path / f"true/{s}.csv") for s in "ab"}
    assert not found.missing
    assert has_seed(Path("{seed}.tum"))
    assert not has_seed(Path("seed.tum"))


def test_seeds_are_in_the_order_of_their_numbers(tmp_path):
    touched(tmp_path, *(f"{k}.tum" for k in (10, 9, 2)), "truth.tum")
    assert list(seed_files(tmp_path / "{seed}.tum", tmp_path / "truth.tum").pairs)[:3] == ["2", "9", "10"]


def test_signs_of_patterns_are_letters(tmp_path):
    touched(tmp_path, "a[1].(x)/a.tum", "b[1].(x)/a.tum", "b[1]+(x)/a.tum", "t.tum")
    assert list(seed_files(tmp_path / "{seed}[1].(x)" / "a.tum", tmp_path / "t.tum").pairs) == ["a", "b"]


def test_the_truth_is_found_beside_an_estimate(tmp_path):
    touched(tmp_path, "0/est.tum", f"0/{TRUTH}", "0/truth_body.tum", "1/est.tum", "1/truth_body.tum")
    pairs = seed_files(tmp_path / "{seed}" / "est.tum").pairs
    assert [truth for _, truth in pairs.values()] == [tmp_path / "0" / TRUTH, tmp_path / "1" / "truth_body.tum"]
    assert truth_beside(tmp_path / "est.tum") is None


def test_a_drive_without_an_estimate_is_missing_and_a_folder_that_is_none_is_not(tmp_path):
    touched(tmp_path, "0/est.tum", f"0/{TRUTH}", f"1/{TRUTH}", "figures/a.png")
    found = seed_files(tmp_path / "{seed}" / "est.tum")
    assert (list(found.pairs), list(found.missing)) == (["0"], ["1"])
    assert "no estimate: " in found.missing["1"]
    found = seed_files(tmp_path / "{seed}" / "est.tum", tmp_path / "{seed}" / TRUTH)
    assert (list(found.pairs), list(found.missing)) == (["0"], ["1"])


def test_estimates_without_a_truth_are_named_in_a_line(tmp_path):
    touched(tmp_path, *(f"{k}/est.tum" for k in range(12)), f"0/{TRUTH}")
    with pytest.raises(ValueError, match=r"\Ano truth for \{seed\} = 1, 2, 3, 4, 5, 6, 7, 8 and 3 more: [^\n]+\Z"):
        seed_files(tmp_path / "{seed}" / "est.tum")
    with pytest.raises(ValueError, match=r"\Ano truth for \{seed\} = 1, .*data.csv is not there"):
        seed_files(tmp_path / "{seed}" / "est.tum", tmp_path / "{seed}" / TRUTH)


@pytest.mark.parametrize(
    ("pattern", "reason"),
    [
        ("est.tum", "is one estimate: write {seed}"),
        ("none/{seed}.tum", "is no folder"),
        ("{seed}/nothing.tum", "matches no file"),
    ],
)
def test_patterns_that_match_nothing_are_refused(tmp_path, pattern, reason):
    touched(tmp_path, "0/est.tum")
    with pytest.raises(ValueError, match=reason.replace("{", r"\{")):
        seed_files(tmp_path / pattern, tmp_path / "truth.tum")
