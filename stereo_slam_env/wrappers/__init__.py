"""Gymnasium wrappers: a filter in the loop, information as reward, and shapes of the observation for learners."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stereo_slam_env.wrappers.belief_observation import BeliefObservation
    from stereo_slam_env.wrappers.belief_panorama import BeliefPanorama
    from stereo_slam_env.wrappers.flatten_uvd import FlattenUVD
    from stereo_slam_env.wrappers.information import InformationCriterion
    from stereo_slam_env.wrappers.information_gain import InformationGain
    from stereo_slam_env.wrappers.record_consistency import RecordConsistency
    from stereo_slam_env.wrappers.sequence_observation import SequenceObservation

_HOMES = {
    "BeliefObservation": "belief_observation",
    "BeliefPanorama": "belief_panorama",
    "FlattenUVD": "flatten_uvd",
    "InformationCriterion": "information",
    "InformationGain": "information_gain",
    "RecordConsistency": "record_consistency",
    "SequenceObservation": "sequence_observation",
}

__all__ = [
    "BeliefObservation",
    "BeliefPanorama",
    "FlattenUVD",
    "InformationCriterion",
    "InformationGain",
    "RecordConsistency",
    "SequenceObservation",
]


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for."""
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
