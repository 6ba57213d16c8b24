"""Stereo EKF-SLAM filters behind one interface. Estimation only: numpy and scipy.

A name is imported when it is first asked for: scipy alone takes longer than most programs want to wait for `--help`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from filters.camera import StereoCamera as StereoCamera
    from filters.conformance import ConformanceError as ConformanceError
    from filters.conformance import ConformanceReport as ConformanceReport
    from filters.conformance import check_filter as check_filter
    from filters.conformance_pytest import parametrize_with_checks as parametrize_with_checks
    from filters.dual_bearing import DualBearingEKF as DualBearingEKF
    from filters.engine.ekf import StereoEKF as StereoEKF
    from filters.euclidean_xyz import EuclideanEKF as EuclideanEKF
    from filters.hybrid_stereo import HybridEKF as HybridEKF
    from filters.interface import BodyVelocity as BodyVelocity
    from filters.interface import Forecast as Forecast
    from filters.interface import LandmarkBelief as LandmarkBelief
    from filters.interface import PoseBelief as PoseBelief
    from filters.interface import StereoFilter as StereoFilter
    from filters.interface import StereoObservation as StereoObservation
    from filters.interface import UpdateReport as UpdateReport
    from filters.interface import VelocityBelief as VelocityBelief
    from filters.inverse_depth_stereo import InverseDepthStereoEKF as InverseDepthStereoEKF
    from filters.monitor import Alarm as Alarm
    from filters.monitor import Cause as Cause
    from filters.monitor import DivergenceMonitor as DivergenceMonitor
    from filters.monocular import MonocularEKF as MonocularEKF
    from filters.motion import ConstantVelocity as ConstantVelocity
    from filters.motion import VelocityDriven as VelocityDriven
    from filters.noise import StereoNoise as StereoNoise
    from filters.poses import Pose as Pose
    from filters.registry import available_filters as available_filters
    from filters.registry import make_filter as make_filter
    from filters.right_invariant import RightInvariantEKF as RightInvariantEKF
    from filters.shared_anchor_stereo import SharedAnchorEKF as SharedAnchorEKF
    from filters.start import Start as Start
    from filters.submaps.submap_ekf import SubmapEKF as SubmapEKF
    from filters.unscented_stereo import UnscentedStereoFilter as UnscentedStereoFilter

_HOMES = {
    "Alarm": "monitor",
    "BodyVelocity": "interface",
    "Cause": "monitor",
    "ConformanceError": "conformance",
    "ConformanceReport": "conformance",
    "ConstantVelocity": "motion",
    "DivergenceMonitor": "monitor",
    "DualBearingEKF": "dual_bearing",
    "EuclideanEKF": "euclidean_xyz",
    "Forecast": "interface",
    "HybridEKF": "hybrid_stereo",
    "InverseDepthStereoEKF": "inverse_depth_stereo",
    "LandmarkBelief": "interface",
    "MonocularEKF": "monocular",
    "Pose": "poses",
    "PoseBelief": "interface",
    "RightInvariantEKF": "right_invariant",
    "SharedAnchorEKF": "shared_anchor_stereo",
    "Start": "start",
    "StereoCamera": "camera",
    "StereoEKF": "engine.ekf",
    "StereoFilter": "interface",
    "StereoNoise": "noise",
    "StereoObservation": "interface",
    "SubmapEKF": "submaps.submap_ekf",
    "UnscentedStereoFilter": "unscented_stereo",
    "UpdateReport": "interface",
    "VelocityBelief": "interface",
    "VelocityDriven": "motion",
    "available_filters": "registry",
    "check_filter": "conformance",
    "make_filter": "registry",
    "parametrize_with_checks": "conformance_pytest",
}

__all__ = list(_HOMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if not TYPE_CHECKING:  # a type checker knows the names from above, and a misspelt one from a right one

    def __getattr__(name: str) -> Any:
        """Import what is asked for, once."""
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        return globals()[name]
