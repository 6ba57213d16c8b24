"""The leaderboard of claims is that of the packets that are kept."""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from stereo_slam_env.benchmark.packets import read_packet
from stereo_slam_env.benchmark.scenarios.study import Study
from stereo_slam_env.report.leaderboard import leaderboard, read_results

ROOT = Path(__file__).resolve().parents[3]


def trial(seed, scale_gap, **figures):
    claim = {"scale_gap": scale_gap, "coverage_90": 0.8, "log_score": -3.0}
    known = {"recording": "drive", "seed": seed, "position_rmse_m": 3.0, "pose_anees": 6.0, "diverged": 0}
    return {**known, **figures} | ({} if scale_gap is None else {"claim": claim})


def test_the_page_is_made_from_the_packets():
    assert (ROOT / "docs" / "leaderboard.md").read_text(encoding="utf-8") == leaderboard(read_results(ROOT / "results"))


@pytest.mark.parametrize("path", sorted((ROOT / "results").glob("*.json")), ids=lambda path: path.stem)
def test_each_packet_that_is_kept_can_be_repeated(path):
    packet = read_packet(path)
    cells = Study.from_dict(packet["study"]).cells
    assert [cell.name for cell in cells] == [cell["name"] for cell in packet["cells"]]
    for asked, kept in zip(cells, packet["cells"], strict=True):
        seeds = [one["seed"] for one in kept["recordings"]]
        digests = [one["stream_sha256"] for one in kept["recordings"]]
        of_each = [each for one in digests for each in (one.values() if isinstance(one, dict) else [one])]
        assert all(re.fullmatch("[0-9a-f]{64}", each) for each in of_each)
        assert seeds == (list(asked.scenario.seeds) if asked.scenario.source.seeded else [None])
        assert set(kept["trials"]) == {choice.label for choice in asked.scenario.competitors}
        for trials in kept["trials"].values():
            assert [trial["seed"] for trial in trials] == seeds


def test_the_nearest_claim_comes_first_whichever_way_it_is_wrong_then_none_then_what_diverged():
    trials = {
        "loose": [trial(0, 0.5)],
        "nothing": [trial(0, None, pose_anees=None)],
        "right": [trial(0, 1.1), trial(1, 1.0, position_rmse_m=4.0)],
        "lost": [trial(0, 1.0, diverged=1)],
        "tight": [trial(0, 3.0)],
    }
    cell = {"name": "one", "recordings": [{"reference": "simulation"}], "trials": trials}
    missing = ["one: 3 frames of loose have no NEES"]
    page = leaderboard({"mine.json": {"study": {"name": "mine"}, "cells": [cell], "missing": missing}})
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| ")][1:]
    assert [row[0].lstrip("| ") for row in rows] == ["right", "loose", "tight", "nothing", "lost"]
    # The root mean square of 3 and 4, the geometric mean of 1 and 1.1.
    assert rows[0][1:] == ["2", "3.54", "1.00", "1.05", "80", "-3.00", "0 |"]
    assert rows[3][4] == "–"
    assert "Missing: 3 frames of loose have no NEES." in page


def test_a_grid_is_one_table_with_its_cells_in_their_order():
    cells = [
        {
            "name": name,
            "recordings": [{"reference": "simulation"}],
            "trials": {"a": [trial(0, 2.0)], "b": [trial(0, 1.0)]},
        }
        for name in ("sigma-1", "sigma-0.5")
    ]
    missing = ["sigma-0.5: a failed in 1 of 2 runs (hung)"]
    page = leaderboard({"mine.json": {"study": {"name": "mine"}, "cells": cells, "missing": missing}})
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| ")]
    assert [row[:2] for row in rows] == [
        ["cell", "system"],
        *(["sigma-1", "b"], ["sigma-1", "a"], ["sigma-0.5", "b"], ["sigma-0.5", "a"]),
    ]
    assert page.count("\n## ") == 1
    assert "Missing: sigma-0.5: a failed in 1 of 2 runs (hung)." in page


def test_k_of_many_recordings_has_its_interval_and_what_is_absurd_is_short():
    gaps = np.exp(np.random.default_rng(0).normal(0.2, 0.3, 10))
    trials = {"a": [trial(k, float(gap), pose_anees=6e9) for k, gap in enumerate(gaps)]}
    cell = {"name": "one", "recordings": [{"reference": "simulation"}], "trials": trials}
    page = leaderboard({"mine.json": {"study": {"name": "mine"}, "cells": [cell], "missing": []}})
    (row,) = [line.split(" | ") for line in page.splitlines() if line.startswith("| a")]
    assert row[3] == "1.0·10⁹"
    middle, low, high = map(float, re.findall("[0-9.]+", row[4]))
    expected = scipy.stats.ttest_1samp(np.log(gaps), 0.0).confidence_interval(0.95)
    np.testing.assert_allclose(np.log([low, high]), expected, atol=0.01)
    assert low < middle < high
