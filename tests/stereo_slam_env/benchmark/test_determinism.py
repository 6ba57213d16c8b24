"""The same scenario gives the same bits, whichever process, vector or backend computes it (40 s)."""

import dataclasses
import hashlib
import json

import numpy as np
import pytest

from stereo_slam_env.benchmark import Scenario, Study
from stereo_slam_env.benchmark.campaign import run_benchmark
from stereo_slam_env.benchmark.recordings.reference_problem import short_turn
from stereo_slam_env.benchmark.recordings.sources import GazeSource, ReferenceSource, StreetSource
from stereo_slam_env.benchmark.scenarios.scenario import filter_choice
from stereo_slam_env.benchmark.scenarios.streams import pairing_digest
from stereo_slam_env.evaluation import run_filter

from ..digest import Digest

FILTERS = (filter_choice("inverse-depth"),)
SHORT = {"filters": FILTERS, "seeds": (0, 1), "frames": 3}
SCENARIOS = {
    "street": Scenario("corner", StreetSource({"route": "right-turn", "rig": "qvga", "max_landmarks": 20}), **SHORT),
    "reference": Scenario("reference", ReferenceSource("short_turn"), **SHORT),
    "gaze": Scenario("gaze", GazeSource({"rig": "qvga"}), policies=("sweep",), metrics=("map",), **SHORT),
}
MEASURED_BY_A_CLOCK = ("milliseconds", "predict_milliseconds", "update_milliseconds", "memory_mb")


def digest_of_run(run):
    """SHA-256 of everything that a filter returned and what became of it, without time and memory."""
    digest = Digest()
    for field in dataclasses.fields(run):
        if field.name not in MEASURED_BY_A_CLOCK:
            digest.add(field.name, getattr(run, field.name))
    return digest.hex()


def parts_of(scenario, folder, jobs):
    """SHA-256 of the recordings, of the bounds, and of the runs of each filter."""
    result = run_benchmark(Study.of(scenario), folder, jobs=jobs)
    (cell,) = result.cells
    _, recordings = cell.directory.load()
    streams = [[about["seed"], pairing_digest(about), about.get("streams")] for about in recordings]
    bounds = Digest()
    for (name, seed), bound in sorted(cell.bounds.items(), key=str):
        bounds.add(f"{name} {seed}", bound.pose)
    return {
        "stream": hashlib.sha256(json.dumps(streams, sort_keys=True).encode()).hexdigest(),
        "bound": bounds.hex(),
        **{f"{run.filter_name}, seed {run.seed}": digest_of_run(run) for run in cell.runs},
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_benchmark_gives_the_same_bits_again_and_in_other_processes(name, tmp_path):
    scenario = SCENARIOS[name]
    first, again = (parts_of(scenario, tmp_path / folder, jobs=1) for folder in ("first", "again"))
    assert len(first) == 4
    assert again == first
    assert parts_of(scenario, tmp_path / "processes", jobs=2) == first


def test_the_digest_of_a_run_has_every_bit_and_no_clock():
    recording = short_turn(seed=0, frames=5)
    first, second = run_filter(recording, "inverse-depth"), run_filter(recording, "inverse-depth")
    assert digest_of_run(first) == digest_of_run(second)
    touched = first.positions.copy()
    touched[-1, 0] = np.nextafter(touched[-1, 0], np.inf)
    assert digest_of_run(dataclasses.replace(first, positions=touched)) != digest_of_run(first)
