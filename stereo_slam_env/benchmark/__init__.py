"""Filters head to head, on identical measurements.

>>> from stereo_slam_env.benchmark import compare, run
>>> result = run("quick", "runs/quick")                # doctest: +SKIP
>>> result.summaries[0].ate_rigid_m                    # doctest: +SKIP
>>> compare("runs/before", "runs/quick").changes       # doctest: +SKIP
"""

from stereo_slam_env.benchmark.campaign import BenchmarkResult, run_benchmark
from stereo_slam_env.benchmark.recordings.source import Source
from stereo_slam_env.benchmark.recordings.sources import (
    DatasetSource,
    FactorySource,
    GazeSource,
    ReferenceSource,
    StreetSource,
)
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, PolicyChoice, Scenario
from stereo_slam_env.benchmark.scenarios.study import Cell, Study, load_study, preset, preset_study, presets
from stereo_slam_env.benchmark.statistics.comparison import RunComparison, compare
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.map_scoring import LandmarkTrace
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import figures_of, summarise, summarise_all

run = run_benchmark

__all__ = [
    "BenchmarkResult",
    "Cell",
    "DatasetSource",
    "FactorySource",
    "FilterChoice",
    "FilterRun",
    "FilterSummary",
    "GazeSource",
    "LandmarkTrace",
    "PolicyChoice",
    "ReferenceSource",
    "RunComparison",
    "Scenario",
    "Source",
    "StreetSource",
    "Study",
    "compare",
    "figures_of",
    "load_study",
    "preset",
    "preset_study",
    "presets",
    "run",
    "run_benchmark",
    "run_filter",
    "summarise",
    "summarise_all",
]
