"""The list of all readers of files: what is fuzzed, and attacked by special files, links, bombs and limits.

To add a reader: a function in `seeds` that makes its files, and a line in `targets`, with a valid folder to begin with.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from fuzz import seeds
from fuzz import seeds_of_others as others
from stereo_slam_env.benchmark import compare
from stereo_slam_env.benchmark.gate import gate
from stereo_slam_env.benchmark.packets import packet_of, read_packet, require_no_other
from stereo_slam_env.benchmark.scenarios.study import load_study
from stereo_slam_env.benchmark.storage.result_tables import results_of
from stereo_slam_env.benchmark.storage.run_files import load_provenance, load_run
from stereo_slam_env.benchmark.storage.store import read_study
from stereo_slam_env.datasets import load, open_image_sequence
from stereo_slam_env.datasets.measured_tracks import read_measured_tracks
from stereo_slam_env.evaluation.body_frames import read_body
from stereo_slam_env.evaluation.drift_model import DriftModel, claim
from stereo_slam_env.evaluation.trajectory_score import evaluate_trajectory
from stereo_slam_env.files.readers import read_arrays
from stereo_slam_env.paper import holds_paper
from stereo_slam_env.policies.named_policies import Network
from stereo_slam_env.policies.ppo import LearningCurve, require_own_training
from stereo_slam_env.recording.archive import load_recording
from stereo_slam_env.recording.trajectory_bags import read_bag
from stereo_slam_env.recording.trajectory_files import load_trajectory
from stereo_slam_env.sensing.rigs import calibration_of
from stereo_slam_env.world.meshes import obj_mesh, urdf_solids
from stereo_slam_env.world.routes import kitti_route
from stereo_slam_env.world.scene import Material

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
    calls: tuple[str, ...] = ()
    """Public functions and commands that read such files by the functions that `read` calls."""


_LOAD = ("datasets.load", "sources.DatasetSource", "stereo-slam replay", "stereo-slam convert")
_IMAGES = ("datasets.open_image_sequence", "datasets.open_for_front_end", "datasets.holds_images", "datasets.layout_of")
_TRAJECTORIES = ("trajectory_score.evaluate_trajectory", "trajectory_files.load_trajectory", "stereo-slam evaluate")
_CLAIMS = ("drift_calibration.calibrate", "DriftModel.read", "stereo-slam calibrate", "stereo-slam claim")
_STUDIES = ("campaign.run_benchmark", "study.load_study", "study.preset_study", "stereo-slam bench")
_HAND_IN = ("stereo-slam verify",)
_JSON = ("readers.read_json",)
_RUNS = ("comparison.compare", "stereo-slam report", "stereo-slam submit", "run_files.holds_run")


@cache
def targets() -> tuple[Target, ...]:
    """The list of all readers; `tests/fuzz/test_readers.py` fails for one that is not on it."""
    return (
        Target("kitti07_tracks", seeds.kitti07(), load, calls=_LOAD),
        Target("kitti00_stereo_tracks", seeds.kitti00(), load, calls=_LOAD),
        Target("starry_night", seeds.starry_night(), load, calls=_LOAD),
        Target("mono_tracks", others.mono_tracks(), load, calls=_LOAD),
        Target("measured_tracks", others.measured_tracks(), _measured_tracks, True, ("stereo-slam scenes noise",)),
        Target("kitti06_stereo51", seeds.kitti06(), _pairs, calls=_IMAGES),
        Target("kitti_odometry", seeds.kitti_odometry(), lambda folder: _pairs(folder / "sequences" / "07")),
        Target("kitti_raw", seeds.kitti_raw(), _pairs),
        Target("karlsruhe", seeds.karlsruhe(), _pairs, calls=("stereo-slam paper",)),
        Target("euroc", seeds.euroc(), _pairs),
        Target("tartanair", others.tartanair(), _pairs),
        Target("vslam_lab", others.vslam_lab(), _pairs),
        Target("stereo_folder", others.stereo_folder(), _pairs),
        Target("bag_of_images", others.bag_of_images(), lambda folder: _pairs(folder / "images.mcap"), True),
        Target("bags", others.bags(), _bags, True),
        Target("rigs", others.rigs(), _rigs, True),
        Target("recording", seeds.recording(), _recording, True, ("archive.load_recording",)),
        Target("run", seeds.run(), _run, True),
        Target("trajectories", seeds.trajectories(), _score, True, _TRAJECTORIES),
        Target("layouts", seeds.layouts(), _layouts, True, _CLAIMS),
        Target("body", others.body(), lambda folder: read_body(folder / "body.json"), True),
        Target("bodies", others.bodies(), _bodies, True, ("meshes.obj_mesh", "meshes.urdf_solids")),
        Target("route", seeds.route(), lambda folder: kitti_route(folder / "poses.txt"), True),
        Target("network", seeds.network(), lambda folder: Network.load(folder / "network.npz"), True),
        Target("scenario", seeds.scenario(), _scenarios, True, _STUDIES),
        Target("packet", others.packets(), _packet, True, _HAND_IN),
        Target("results", seeds.results(), _results, calls=_RUNS),
        Target("finished", seeds.finished(), _finished, calls=(*_RUNS, "watched_drive.revisit", "stereo-slam view")),
        Target(
            "paper",
            {"paper_settings.json": b'{"version": 1, "settings": {}, "versions": {}}'},
            holds_paper,
            calls=_JSON,
        ),
        Target("training", seeds.training(), _training, calls=("ppo.LearningCurve", "ppo.train", "stereo-slam train")),
        Target("arrays", seeds.network(), _arrays, True, ("readers.read_arrays",)),
    )


def _finished(folder: Path) -> object:
    """What `report`, `submit` and the next start of the same run read of a finished one."""
    (directory,) = read_study(folder).cells
    compare(folder, folder)
    packet_of(folder)
    return results_of(directory), directory.missing(), directory.recording_content(0)


def _training(folder: Path) -> object:
    """What a training that goes on reads, but for its state, which needs a network."""
    require_own_training(folder, json.loads(seeds.training()["run.json"]))
    return LearningCurve(folder / "learning_curve.csv").rows


def _recording(folder: Path) -> object:
    return load_recording(folder / "drive.npz")


def _arrays(folder: Path) -> object:
    return read_arrays(folder / "network.npz")


def _measured_tracks(folder: Path) -> object:
    return [read_measured_tracks(folder / name) for name in ("named.csv", "plain.txt")]


def _bags(folder: Path) -> object:
    return [read_bag(folder / "database", None), load_trajectory(folder / "poses.mcap")]


def _rigs(folder: Path) -> object:
    """Every file as a rig, on its own."""
    names = ("camchain.yaml", "opencv.yml", "orb.yaml", "orb.json", "info/left.yaml")
    size = {"width": seeds.CAMERA.width, "height": seeds.CAMERA.height}
    return [calibration_of({"name": str(folder / name), **size}) for name in (*names, "calib.txt")]


def _bodies(folder: Path) -> object:
    material = Material((0.5, 0.5, 0.5))
    return urdf_solids(folder / "robot.urdf", material), obj_mesh(folder / "mesh.obj", material)


def _packet(folder: Path) -> object:
    """What `verify` and `report --fail-if-worse` read, and what `submit` would replace."""
    packet = read_packet(folder / "packet.json")
    require_no_other(folder / "packet.json")
    return gate([packet], [packet])


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
        for name in (
            *("openvins.txt", "state_estimate.txt", "euroc.csv", "cnspy.csv", "numbered.txt", "ros.txt"),
            "claimed.square",
        )
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
