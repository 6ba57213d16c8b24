"""What is fuzzed: every reader of files, with a valid folder to begin with.

To add a reader: a function in `seeds` that makes its files, and a line in `targets`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from fuzz import seeds
from stereo_slam_env.benchmark import compare
from stereo_slam_env.benchmark.scenarios.study import load_study
from stereo_slam_env.benchmark.storage.run_archive import load_provenance, load_run
from stereo_slam_env.benchmark.storage.store import read_study
from stereo_slam_env.benchmark.storage.tables import results_of
from stereo_slam_env.datasets import load, open_image_sequence
from stereo_slam_env.evaluation.drift_model import DriftModel, claim
from stereo_slam_env.evaluation.trajectory_score import evaluate_trajectory
from stereo_slam_env.policies.network import Network
from stereo_slam_env.recording.archive import load_recording
from stereo_slam_env.recording.trajectory_files import load_trajectory
from stereo_slam_env.training.ppo import LearningCurve
from stereo_slam_env.world.routes import kitti_route

Read = Callable[[Path], object]


@dataclass(frozen=True)
class Target:
    """A reader and files that it reads."""

    name: str
    """For reports."""
    files: seeds.Files
    """A valid folder."""
    read: Read
    """Reads that folder; only a `ValueError` of one line may come out of it."""
    follows_links: bool = False
    """Whether what is read was named by the user, one file, so that it may be a link to anywhere."""


@cache
def targets() -> tuple[Target, ...]:
    """All of them."""
    return (
        Target("kitti07_tracks", seeds.kitti07(), load),
        Target("kitti00_stereo_tracks", seeds.kitti00(), load),
        Target("starry_night", seeds.starry_night(), load),
        Target("kitti06_stereo51", seeds.kitti06(), _pairs),
        Target("kitti_odometry", seeds.kitti_odometry(), lambda folder: _pairs(folder / "sequences" / "07")),
        Target("kitti_raw", seeds.kitti_raw(), _pairs),
        Target("karlsruhe", seeds.karlsruhe(), _pairs),
        Target("euroc", seeds.euroc(), _pairs),
        Target("recording", seeds.recording(), lambda folder: load_recording(folder / "drive.npz"), True),
        Target("run", seeds.run(), _run, True),
        Target("trajectories", seeds.trajectories(), _score, True),
        Target("layouts", seeds.layouts(), _layouts, True),
        Target("route", seeds.route(), lambda folder: kitti_route(folder / "poses.txt"), True),
        Target("network", seeds.network(), lambda folder: Network.load(folder / "network.npz"), True),
        Target("scenario", seeds.scenario(), _scenarios, True),
        Target("results", seeds.results(), _results),
        Target("finished", seeds.finished(), _finished),
        Target("training", seeds.training(), _training, True),
    )


def _finished(folder: Path) -> object:
    """What `report` and the next start of the same run read of a finished one."""
    (directory,) = read_study(folder).cells
    compare(folder, folder)
    return results_of(directory), directory.missing(), directory.recording_content(0)


def _training(folder: Path) -> object:
    """What a training that goes on reads."""
    return LearningCurve(folder / "learning_curve.csv").rows


def _pairs(folder: Path) -> object:
    """Every pair, however many are broken."""
    sequence = open_image_sequence(folder)
    return [pair.timestamp for pair in sequence.pairs()]


def _run(folder: Path) -> object:
    if not (folder / "run.npz").exists():  # looked at before it is read, wherever it is
        return None
    return load_provenance(folder / "run.npz"), load_run(folder / "run.npz")


def _score(folder: Path) -> object:
    """Every pair of formats."""
    return [
        evaluate_trajectory(folder / estimate, folder / reference, align=align)
        for estimate in ("run.square", "run.kitti")
        for reference in ("run.tum", "run.square")
        for align in ("none", "rigid")
    ]


def _layouts(folder: Path) -> object:
    """Trajectories in the layouts of others, and what a drift model claims for one of them."""
    found = [
        load_trajectory(folder / name)
        for name in ("openvins.txt", "euroc.csv", "cnspy.csv", "numbered.txt", "ros.txt", "claimed.square")
    ]
    return found, claim(found[0], DriftModel.read(folder / "model.json"))


def _scenarios(folder: Path) -> object:
    """Every file in the folder but the one that names a function; that one is refused, or it is a finding."""
    (folder / "kitti07").mkdir(exist_ok=True)
    try:
        called = load_study(folder / "called.toml")
    except ValueError:
        called = None
    if called is not None and any(cell.scenario.source.runs_code for cell in called.cells):
        raise AssertionError("a scenario file may call a function without consent")
    found = []
    for name in ("grid.toml", "crossed.toml", "cells.json"):
        found.append(load_study(folder / name, data=folder))
    return found


def _results(folder: Path) -> object:
    """A run directory; every folder in it is inside."""
    directories = [*read_study(folder).cells, *read_study(folder / "grid").cells]
    for directory in directories:
        for seed in directory.seeds:
            for choice in directory.scenario.competitors:
                if not directory.trial_path(seed, choice).resolve().is_relative_to(folder.resolve()):
                    raise AssertionError(f"a run directory leads out of itself, to {directory.out}")
    return directories
