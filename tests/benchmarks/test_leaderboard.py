"""The leaderboard of claims is that of the packets that are kept (2 s)."""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from stereo_slam_env.benchmark.packets import read_packet
from stereo_slam_env.benchmark.scenarios.study import Study

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))  # as when it is run
board = importlib.import_module("leaderboard")


def trials(gaps, **figures):
    """A trial for each scale gap; None: one without a claim."""
    plain = {"recording": "drive", "position_rmse_m": 3.0, "pose_anees": 6.0, "diverged": 0, **figures}
    claims = [{"scale_gap": gap, "coverage_90": 0.8, "log_score": -3.0} for gap in gaps]
    return [
        {**plain, "seed": seed} | ({} if claim["scale_gap"] is None else {"claim": claim})
        for seed, claim in enumerate(claims)
    ]


def rows_of(systems):
    cell = {"name": "one", "recordings": [{"reference": "simulation"}], "trials": systems}
    return list(board.rows({"cells": [cell]}))


def test_the_page_is_made_from_the_packets():
    page = (ROOT / "docs" / "leaderboard.md").read_text(encoding="utf-8")
    assert page == board.leaderboard(map(read_packet, board.PACKETS))
    assert len(page.splitlines()) <= 40


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
    systems = {
        "loose": trials([0.5] * 10),
        "nothing": trials([None] * 10, pose_anees=None),
        "right": trials([1.1, 1.0] * 5),
        "lost": trials([1.0] * 10, diverged=1),
        "tight": trials([3.0] * 10),
    }
    rows = rows_of(systems)
    assert [row[1] for row in rows] == ["right", "loose", "tight", "nothing", "lost"]
    assert rows[0][2:5] == ["10", "3", "1.00"]
    assert rows[3][5] == "–"


def test_systems_with_fewer_than_ten_recordings_have_no_row():
    assert [row[1] for row in rows_of({"few": trials([1.0] * 9), "enough": trials([2.0] * 10)})] == ["enough"]


def test_k_has_the_interval_of_a_geometric_mean_and_labels_are_escaped():
    gaps = np.exp(np.random.default_rng(0).normal(0.2, 0.3, 10))
    ((_, label, *_, k, _, _),) = rows_of({"a|b": trials(gaps.tolist())})
    assert "|" not in label.replace(r"\|", "")
    middle, low, high = map(float, re.findall("[0-9.]+", k))
    expected = scipy.stats.ttest_1samp(np.log(gaps), 0.0).confidence_interval(0.95)
    np.testing.assert_allclose(np.log([low, high]), expected, atol=0.01)
    assert low < middle < high
