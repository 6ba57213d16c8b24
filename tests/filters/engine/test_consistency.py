"""Where the model holds, a filter must be as sure as it is right: Monte Carlo over 50 drives of 12 frames into a turn.

Bands are two-sided 95 % chi-square bands of the mean over the runs; seeds are fixed, so these tests cannot flicker.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from filters import StereoNoise
from stereo_slam_env.benchmark.recordings.reference_problem import short_turn
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.recording.recording import Recording

SEEDS = 50
FULL_R = StereoNoise.independent_pixels(1.0)
PAPER_R = StereoNoise.diagonal(1.0, 1.0, 1.0)
LOW, HIGH = mean_band(6, SEEDS)


@cache
def drive(seed: int, noise: str) -> Recording:
    return short_turn(seed, noise)


@cache
def runs(filter_name: str, noise: str, assumed: StereoNoise, gate: float | None = None) -> tuple[FilterRun, ...]:
    options: dict[str, Any] = {"gate": gate}
    return tuple(
        run_filter(drive(seed, noise), filter_name, options, noise=assumed, seed=seed) for seed in range(SEEDS)
    )


def share_in_band(all_runs: tuple[FilterRun, ...]) -> float:
    anees = np.mean([run.pose_nees[1:] for run in all_runs], axis=0)
    return float(np.mean((anees >= LOW) & (anees <= HIGH)))


def nis_per_dof(all_runs: tuple[FilterRun, ...]) -> float:
    return float(sum(run.nis.sum() for run in all_runs) / sum(run.nis_dof.sum() for run in all_runs))


def landmark_nees_per_dof(all_runs: tuple[FilterRun, ...]) -> float:
    return float(np.mean([np.mean(run.landmark_nees[1:]) for run in all_runs]) / 3)


@pytest.mark.parametrize("filter_name", ["inverse-depth", "dual-bearing"])
def test_with_the_right_R_the_pose_is_consistent_in_nine_frames_of_ten(filter_name: str) -> None:
    assert share_in_band(runs(filter_name, "pixels", FULL_R)) >= 0.9


@pytest.mark.parametrize("gate", [None, 0.99])
def test_with_the_right_R_innovations_and_landmarks_are_consistent(gate: float | None) -> None:
    consistent = runs("inverse-depth", "pixels", FULL_R, gate)
    # Slightly below 1: the assumed accelerations are generous, and a gate cuts the tail.
    assert 0.93 < nis_per_dof(consistent) < 1.02
    assert 0.93 < landmark_nees_per_dof(consistent) < 1.05


def test_under_the_papers_noise_the_papers_R_is_the_right_one() -> None:
    assert share_in_band(runs("inverse-depth", "uvd", PAPER_R)) >= 0.9
    assert 0.93 < nis_per_dof(runs("inverse-depth", "uvd", PAPER_R)) < 1.02


@pytest.mark.parametrize(("noise", "wrong_R"), [("pixels", PAPER_R), ("uvd", FULL_R)])
def test_the_wrong_R_is_seen_in_every_figure(noise: str, wrong_R: StereoNoise) -> None:
    mismatched = runs("inverse-depth", noise, wrong_R)
    matched = runs("inverse-depth", noise, FULL_R if noise == "pixels" else PAPER_R)
    assert nis_per_dof(mismatched) > 1.15
    assert landmark_nees_per_dof(mismatched) > 1.15
    assert share_in_band(mismatched) < share_in_band(matched)
    ends = [np.linalg.norm([run.pose_errors[-1, :3] for run in some], axis=1) for some in (mismatched, matched)]
    assert np.mean(ends[0]) > np.mean(ends[1])


def test_unguarded_XYZ_diverges_on_far_points() -> None:
    pose_nees = np.mean([run.pose_nees[-5:] for run in runs("euclidean", "pixels", FULL_R)])
    assert pose_nees / 6 > 3.0


def test_joint_and_dual_agree_when_both_are_given_the_right_R() -> None:
    joint, dual = runs("inverse-depth", "pixels", FULL_R), runs("dual-bearing", "pixels", FULL_R)
    apart = np.array([a.positions[-1] - b.positions[-1] for a, b in zip(joint, dual, strict=True)])
    sigmas = np.array([np.sqrt(np.diag(run.pose_covariances[-1])[:3]) for run in joint])
    assert np.sqrt(np.mean((apart / sigmas) ** 2)) < 0.5
