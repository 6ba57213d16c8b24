"""Options of `StereoEKF`: the names of its parts, and the checked parts themselves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar, cast

from filters.camera import StereoCamera
from filters.engine import unscented
from filters.engine.arithmetic import arithmetic
from filters.engine.error_definition import ERRORS, StandardError
from filters.engine.joint_state import JointState
from filters.engine.kalman import LinearisedMeasurements
from filters.engine.steps import Arithmetic
from filters.known_names import did_you_mean
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.hybrid import Hybrid
from filters.landmarks.inverse_depth import InverseDepth
from filters.landmarks.parametrisation import LandmarkModel
from filters.landmarks.shared_anchor import SharedAnchorInverseDepth
from filters.measurements.bearing import LeftOnly, LeftThenRight, Stacked
from filters.measurements.model import MeasurementModel, Stage
from filters.measurements.range_bearing import RangeBearing
from filters.motion import MotionModel, motion_model
from filters.validation import IntArray, gate_probability, positive

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
    """Parts of a filter: the options of `StereoEKF`, checked, with names replaced by parts."""

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
    arithmetic: Arithmetic

    @cached_property
    def is_plain(self) -> bool:
        """Whether nothing happens between linearisation, gate and update."""
        by_jacobians = self.linearise is self.arithmetic.linearise and self.error.linearises_at_the_state
        return by_jacobians and self.iterations == 1 and not self.consensus and self.tail_dof is None

    @cached_property
    def is_steady(self) -> bool:
        """Whether a frame without landmarks that come or go leaves the map as it is."""
        return self.max_landmarks is None and not isinstance(self.landmark, Hybrid)


def checked_parts(
    *,
    motion: MotionModel | None,
    gate: float | None,
    landmark: str | LandmarkModel,
    measurement: str | MeasurementModel,
    error: str,
    update: str,
    consensus: bool,
    tail_dof: float | None,
    iterations: int,
    drop_unseen: bool,
    min_disparity: float | None,
    max_landmarks: int | None,
    compiled: bool,
) -> Parts:
    """The parts that the options of `StereoEKF` stand for.

    Raises
    ------
    ValueError
        An option has an unknown or impossible value; the message names it.
    """
    gate = gate_probability(gate)
    if type(iterations) is not int or iterations < 1:
        raise ValueError(f"iterations must be an integer >= 1, got {iterations!r}")
    for name, value in (("drop_unseen", drop_unseen), ("consensus", consensus)):
        if not isinstance(value, bool):
            raise ValueError(f"{name} must be True or False, got {value!r}")
    if consensus and gate is None:
        raise ValueError("gate must be a probability with consensus=True, got None: it is the limit of agreement")
    if update == "unscented" and error == "first-estimates":
        raise ValueError('error must not be "first-estimates" with update="unscented", which has no Jacobians')
    if min_disparity is not None and not (isinstance(min_disparity, float | int) and math.isfinite(min_disparity)):
        raise ValueError(f"min_disparity must be a finite number of px, or None, got {min_disparity!r}")
    if max_landmarks is not None and (type(max_landmarks) is not int or max_landmarks < 1):
        raise ValueError(f"max_landmarks must be an integer >= 1, or None for no limit, got {max_landmarks!r}")
    motion = motion_model(motion)
    chosen = arithmetic(compiled)
    return Parts(
        motion=motion,
        gate=gate,
        landmark=choice("landmark", landmark, LANDMARKS, LandmarkModel),
        measurement=choice("measurement", measurement, MEASUREMENTS, MeasurementModel),
        error=choice("error", error, ERRORS),
        linearise=choice("update", update, LINEARISATIONS) or chosen.linearise,
        consensus=consensus,
        tail_dof=None if tail_dof is None else positive("tail_dof", tail_dof),
        iterations=iterations,
        drop_unseen=drop_unseen,
        min_disparity=min_disparity,
        max_landmarks=max_landmarks,
        arithmetic=chosen,
    )


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
    hint = did_you_mean(value, available)
    raise ValueError(f"{name} must be one of {', '.join(map(repr, available))}, got {value!r}{hint}")
