"""Scenarios as plain data, from files and as presets, and the measurement streams they stand for."""

from stereo_slam_env.benchmark.recordings.source import Source
from stereo_slam_env.benchmark.recordings.sources import (
    DatasetSource,
    FactorySource,
    GazeSource,
    ReferenceSource,
    StreetSource,
    source_of,
)
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, PolicyChoice, Scenario
from stereo_slam_env.benchmark.scenarios.streams import make_recording
from stereo_slam_env.benchmark.scenarios.study import Cell, Study, load_study, preset, preset_study, presets

__all__ = [
    "Cell",
    "DatasetSource",
    "FactorySource",
    "FilterChoice",
    "GazeSource",
    "PolicyChoice",
    "ReferenceSource",
    "Scenario",
    "Source",
    "StreetSource",
    "Study",
    "load_study",
    "make_recording",
    "preset",
    "preset_study",
    "presets",
    "source_of",
]
