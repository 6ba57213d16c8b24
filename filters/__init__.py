"""Stereo EKF-SLAM filters behind one interface. Estimation only: numpy and scipy."""

from filters.camera import StereoCamera
from filters.conformance import ConformanceError, ConformanceReport, check_filter
from filters.dual_bearing import DualBearingEKF
from filters.engine.ekf import StereoEKF
from filters.euclidean_xyz import EuclideanEKF
from filters.hybrid_stereo import HybridEKF
from filters.interface import (
    BodyVelocity,
    Forecast,
    LandmarkBelief,
    PoseBelief,
    StereoFilter,
    StereoObservation,
    UpdateReport,
    VelocityBelief,
)
from filters.inverse_depth_stereo import InverseDepthStereoEKF
from filters.monitor import Alarm, Cause, DivergenceMonitor
from filters.monocular import MonocularEKF
from filters.motion import ConstantVelocity, VelocityDriven
from filters.noise import StereoNoise
from filters.registry import available_filters, make_filter
from filters.right_invariant import RightInvariantEKF
from filters.shared_anchor_stereo import SharedAnchorEKF
from filters.submaps.submap_ekf import SubmapEKF
from filters.trials.ekf import StereoEKFTrials
from filters.trials.series import TrialSeries, run_trials
from filters.unscented_stereo import UnscentedStereoFilter

__all__ = [
    "Alarm",
    "BodyVelocity",
    "Cause",
    "ConformanceError",
    "ConformanceReport",
    "ConstantVelocity",
    "DivergenceMonitor",
    "DualBearingEKF",
    "EuclideanEKF",
    "Forecast",
    "HybridEKF",
    "InverseDepthStereoEKF",
    "LandmarkBelief",
    "MonocularEKF",
    "PoseBelief",
    "RightInvariantEKF",
    "SharedAnchorEKF",
    "StereoCamera",
    "StereoEKF",
    "StereoEKFTrials",
    "StereoFilter",
    "StereoNoise",
    "StereoObservation",
    "SubmapEKF",
    "TrialSeries",
    "UnscentedStereoFilter",
    "UpdateReport",
    "VelocityBelief",
    "VelocityDriven",
    "available_filters",
    "check_filter",
    "make_filter",
    "run_trials",
]
