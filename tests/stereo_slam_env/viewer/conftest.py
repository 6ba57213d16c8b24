"""A finished run of two filters on two seeds, to be watched."""

import pytest

from stereo_slam_env.benchmark import run_benchmark
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import Scenario, filter_choice


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory):
    """A short turn in pure geometry: the run directory."""
    out = tmp_path_factory.mktemp("watched") / "run"
    filters = (filter_choice("inverse-depth"), filter_choice("euclidean"))
    scenario = Scenario(
        "short turn", ReferenceSource("short_turn"), filters, seeds=(3, 4), frames=8, gate=0.99, metrics=("map",)
    )
    run_benchmark(scenario, out, jobs=1)
    return out
