"""The parts a filter can be asked for by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TypeVar, cast

from filters.camera import StereoCamera
from filters.engine import unscented
from filters.engine.error_definition import StandardError
from filters.engine.joint_state import JointState
from filters.engine.kalman import LinearisedMeasurements
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.hybrid import Hybrid
from filters.landmarks.inverse_depth import InverseDepth
from filters.landmarks.parametrisation import LandmarkModel
from filters.landmarks.shared_anchor import SharedAnchorInverseDepth
from filters.measurements.bearing import LeftOnly, LeftThenRight, Stacked
from filters.measurements.model import MeasurementModel, Stage
from filters.measurements.range_bearing import RangeBearing
from filters.motion import MotionModel
from filters.validation import IntArray

LANDMARKS: Mapping[str, LandmarkModel] = {
    "inverse-depth": InverseDepth(),
    "shared-anchor": SharedAnchorInverseDepth(),
    "euclidean": Euclidean(),
    "hybrid": Hybrid(),
}
MEASUREMENTS: Mapping[str, MeasurementModel] = {
    "joint": RangeBearing(),
    "sequential": LeftThenRight(),
    "stacked": Stacked(),
    "left": LeftOnly(),
}

Linearise = Callable[[StereoCamera, JointState, IntArray, Stage, JointState | None], LinearisedMeasurements]
LINEARISATIONS: Mapping[str, Linearise | None] = {"extended": None, "unscented": unscented.linearise}
"""None: by Jacobians, as the filter's arithmetic has them."""


@dataclass(frozen=True)
class Parts:
    """What a filter is composed of: the options of `StereoEKF`, checked, names replaced by what they stand for."""

    motion: MotionModel
    gate: float | None
    landmark: LandmarkModel
    measurement: MeasurementModel
    error: StandardError
    linearise: Linearise
    consensus: bool
    tail_dof: float | None
    iterations: int
    drop_unseen: bool
    min_disparity: float | None
    max_landmarks: int | None


T = TypeVar("T")


def choice(name: str, value: str | T, available: Mapping[str, T], kind: type | None = None) -> T:
    """The part called `value`, or `value` itself if it is a part of that `kind`.

    Raises
    ------
    ValueError
        No such part: the message names the option, what there is, and what may have been meant.
    """
    if isinstance(value, str) and value in available:
        return available[value]
    if kind is not None and isinstance(value, kind):
        return cast(T, value)
    close = get_close_matches(str(value), available, 1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    raise ValueError(f"{name} must be one of {', '.join(map(repr, available))}, got {value!r}{hint}")
