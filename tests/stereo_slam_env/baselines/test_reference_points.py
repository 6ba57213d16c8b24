"""The baselines are where others have found them, and the filters' batch reference is no worse than the filters."""

from __future__ import annotations

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from filters import check_filter, make_filter
from filters.catalogue.registry import ENTRY_POINT_GROUP
from stereo_slam_env import baselines
from stereo_slam_env.benchmark.recordings.reference_problem import short_turn
from stereo_slam_env.datasets import load
from stereo_slam_env.datasets.single_data_sets import KITTI07_TRACKS
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.trajectory_metrics import ate_rigid
from stereo_slam_env.frontend.causal_noise import CausalNoiseEKF

from ..real_data import real_data

ROOT = Path(__file__).resolve().parents[3]


def ate(run: FilterRun) -> float:
    scored = np.isfinite(run.true_positions).all(axis=1)
    return ate_rigid(run.positions[scored], run.true_positions[scored])


@pytest.mark.parametrize("name", ["dead-reckoning", "frame-to-frame", "batch", "fixed-lag"])
def test_every_baseline_keeps_the_contract(name: str) -> None:
    if name in ("batch", "fixed-lag"):
        pytest.importorskip("gtsam", reason="needs the extra gtsam")
    check_filter(lambda camera, noise: make_filter(name, camera=camera, noise=noise))


def test_every_baseline_and_the_causal_filter_have_an_entry_point() -> None:
    """In `pyproject.toml`, since what is installed may be older."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = project["entry-points"][ENTRY_POINT_GROUP]
    made = {EntryPoint(name, value, ENTRY_POINT_GROUP).load() for name, value in named.items()}
    assert made == {*(getattr(baselines, name) for name in baselines.__all__), CausalNoiseEKF}
    assert named["filterpy-ekf"] == "stereo_slam_env.baselines.filterpy_ekf:FilterpyEKF"


def test_dead_reckoning_on_kitti_07_is_as_far_off_as_published_with_the_data() -> None:
    run = run_filter(KITTI07_TRACKS.read(real_data("kitti07_tracks")), "dead-reckoning")
    assert ate(run) == pytest.approx(15.7, abs=0.3)


@pytest.mark.slow
def test_frame_to_frame_on_kitti_00_follows_the_drive() -> None:
    run = run_filter(load(real_data("kitti00_stereo_tracks")), "frame-to-frame")
    assert run.failure is None
    assert ate(run) < 0.5


@pytest.mark.slow
def test_smoothing_everything_is_no_worse_than_filtering() -> None:
    pytest.importorskip("gtsam", reason="needs the extra gtsam")
    ends = {"batch": [], "inverse-depth": []}
    for seed in range(6):
        recording = short_turn(seed)
        for name, found in ends.items():
            run = run_filter(recording, name, {} if name == "batch" else {"gate": None})
            assert run.failure is None
            found.append(run.positions[-1] - run.true_positions[-1])
    rms = {name: np.sqrt(np.mean(np.sum(np.square(found), axis=1))) for name, found in ends.items()}
    assert rms["batch"] <= 1.15 * rms["inverse-depth"]
