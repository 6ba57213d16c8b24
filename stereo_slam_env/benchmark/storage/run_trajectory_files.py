"""Files of trajectories in a run directory: estimates and truth, for other programs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.run_trajectories import estimate_of, reference_of, truth_of
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import save_trajectory

WRITTEN = 10
"""Recordings whose trajectories are written with the results; of more they are on demand."""


def seed_name(seed: int | None) -> str:
    """Name of files of one recording."""
    return "recording" if seed is None else f"seed-{seed:04d}"


def write_trajectories(out: Path, scenario: Scenario, runs: Iterable[FilterRun]) -> None:
    """Write the trajectories of runs of a scenario into its run directory `out`."""
    for run in runs:
        folder = out / "trajectories" / seed_name(run.seed)
        # A camera that looks elsewhere is elsewhere, by the arm of the head: each policy has its own truth.
        truth = f"{run.filter_name}-truth" if scenario.policies else "truth"
        _write(folder / run.filter_name, estimate_of(run), estimate_of(run))
        _write(folder / truth, truth_of(run), reference_of(run))


def _write(path: Path, poses: Trajectory | None, claimed: Trajectory | None) -> None:
    """Write poses as .tum and .kitti, and with what is claimed of them as .square; those that are not known are not."""
    for ending, trajectory in ((".tum", poses), (".kitti", poses), (".square", claimed)):
        if trajectory is not None:
            save_trajectory(path.with_name(path.name + ending), trajectory)
