"""Filters head to head, on identical measurements.

>>> from stereo_slam_env.benchmark import compare, run
>>> result = run("quick", "runs/quick")                # doctest: +SKIP
>>> result.summaries[0].ate_rigid_m                    # doctest: +SKIP
>>> compare("runs/before", "runs/quick").changes       # doctest: +SKIP
"""

from stereo_slam_env.benchmark.campaign import BenchmarkResult, run_benchmark
from stereo_slam_env.benchmark.scenarios.presets import preset, preset_study, presets
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, PolicyChoice, Scenario
from stereo_slam_env.benchmark.scenarios.scenario_file import load_study
from stereo_slam_env.benchmark.scenarios.study import Cell, Study
from stereo_slam_env.benchmark.statistics.comparison import RunComparison, compare
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary, LandmarkTrace
from stereo_slam_env.evaluation.run_figures import figures_of
from stereo_slam_env.evaluation.summary import summarise, summarise_all

run = run_benchmark

__all__ = [
    "BenchmarkResult",
    "Cell",
    "FilterChoice",
    "FilterRun",
    "FilterSummary",
    "LandmarkTrace",
    "PolicyChoice",
    "RunComparison",
    "Scenario",
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
