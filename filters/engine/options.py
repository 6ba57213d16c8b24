"""The parts a filter can be asked for by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import TypeVar

from filters.camera import StereoCamera
from filters.engine import unscented
from filters.engine.joint_state import JointState
from filters.engine.kalman import LinearisedMeasurements
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.inverse_depth import InverseDepth
from filters.landmarks.parametrisation import LandmarkModel
from filters.landmarks.shared_anchor import SharedAnchorInverseDepth
from filters.measurements.bearing import LeftOnly, LeftThenRight, Stacked
from filters.measurements.model import MeasurementModel, Stage
from filters.measurements.range_bearing import RangeBearing
from filters.validation import IntArray

LANDMARKS: Mapping[str, LandmarkModel] = {
    "inverse-depth": InverseDepth(),
    "shared-anchor": SharedAnchorInverseDepth(),
    "euclidean": Euclidean(),
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

T = TypeVar("T")


def choice(name: str, value: str, available: Mapping[str, T]) -> T:
    """The part called `value`.

    Raises
    ------
    ValueError
        No such part: the message names the option, what there is, and what may have been meant.
    """
    if isinstance(value, str) and value in available:
        return available[value]
    close = get_close_matches(str(value), available, 1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    raise ValueError(f"{name} must be one of {', '.join(map(repr, available))}, got {value!r}{hint}")
