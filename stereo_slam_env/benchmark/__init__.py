"""Filters head to head, on identical measurements.

>>> from stereo_slam_env.benchmark import preset, run
>>> result = run(preset("quick"), "runs/quick")        # doctest: +SKIP
>>> result.summaries[0].ate_rigid_m                    # doctest: +SKIP
"""

from stereo_slam_env.benchmark.campaign import BenchmarkResult, run_benchmark
from stereo_slam_env.benchmark.presets import PRESETS, preset
from stereo_slam_env.benchmark.results import FilterRun, FilterSummary, LandmarkTrace
from stereo_slam_env.benchmark.runner import run_filter
from stereo_slam_env.benchmark.scenario import FilterChoice, Scenario, load_scenario
from stereo_slam_env.benchmark.summary import summarise, summarise_all
from stereo_slam_env.benchmark.trials import run_filter_together

run = run_benchmark

__all__ = [
    "PRESETS",
    "BenchmarkResult",
    "FilterChoice",
    "FilterRun",
    "FilterSummary",
    "LandmarkTrace",
    "Scenario",
    "load_scenario",
    "preset",
    "run",
    "run_benchmark",
    "run_filter",
    "run_filter_together",
    "summarise",
    "summarise_all",
]
