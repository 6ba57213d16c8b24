"""Checked options of `StereoEKF`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from filters.contract.noise import LandmarkDrift
from filters.contract.validation import covariance_matrix, gate_probability, positive
from filters.errors.error_definition import ErrorDefinition
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel
from filters.motions.motion_model import MotionModel
from filters.parts import make_part
from filters.state.layout import StateLayout
from filters.updates.extended import Linearisation


@dataclass(frozen=True)
class Options:
    """Options of `StereoEKF` with names replaced by parts; see there.

    Raises
    ------
    ValueError
        An option has an unknown or impossible value, or two cannot be combined; the message names them.
    """

    motion: MotionModel
    landmark: LandmarkModel
    measurement: MeasurementModel
    error: ErrorDefinition
    update: Linearisation
    gate: float | None
    consensus: bool
    tail_dof: float | None
    drift: LandmarkDrift | None
    gauge_walk: float
    iterations: int
    relinearise_above: float
    drop_unseen: bool
    min_disparity: float | None

    @classmethod
    def of(
        cls, *, motion: Any, landmark: Any, measurement: Any, error: Any, update: Any, drift: Any, **others: Any
    ) -> Options:
        """Options with the parts that their names stand for."""
        return cls(
            motion=make_part("motion", "constant-velocity" if motion is None else motion),
            landmark=make_part("landmark", landmark),
            measurement=make_part("measurement", measurement),
            error=make_part("error", error),
            update=make_part("update", update),
            drift=LandmarkDrift.of(drift),
            **others,
        )

    def __post_init__(self) -> None:
        gate_probability(self.gate)
        if type(self.iterations) is not int or self.iterations < 1:
            raise ValueError(f"iterations must be an integer >= 1, got {self.iterations!r}")
        positive("relinearise_above", self.relinearise_above, allow_zero=True)
        for name in ("drop_unseen", "consensus"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"{name} must be True or False, got {getattr(self, name)!r}")
        if self.consensus and self.gate is None:
            raise ValueError("gate must be a probability with consensus=True, got None: it is the limit of agreement")
        if self.tail_dof is not None:
            positive("tail_dof", self.tail_dof)
        if self.min_disparity is not None and not (
            isinstance(self.min_disparity, float | int) and math.isfinite(self.min_disparity)
        ):
            raise ValueError(f"min_disparity must be a finite number of px, or None, got {self.min_disparity!r}")
        _check_landmark(self.landmark)
        for name in ("seen_size", "seen_vectors"):
            wanted, taken = getattr(self.landmark, name), getattr(self.measurement, name)
            if wanted != taken:
                raise ValueError(
                    f"measurement must have {name} = {wanted} with landmark={type(self.landmark).__name__}, "
                    f"got {type(self.measurement).__name__} with {taken}: it measures other landmarks"
                )
        if not self.update.by_jacobians:
            if not self.error.linearises_at_the_state:
                raise ValueError(
                    f"error must linearise at the state with update={type(self.update).__name__}, which takes no "
                    f'Jacobians, got {type(self.error).__name__}: use "so3", or update="extended"'
                )
            if self.measurement.variables or self.measurement.sees_velocity:
                raise ValueError(
                    f"measurement must have no variables with update={type(self.update).__name__}, which takes no "
                    f'Jacobians, got {type(self.measurement).__name__}: use update="extended"'
                )
        positive("gauge_walk", self.gauge_walk, allow_zero=True)
        if self.gauge_walk and not self.error.keeps_gauge:
            raise ValueError(
                "error must keep what cannot be observed unobservable with gauge_walk, "
                f'got {type(self.error).__name__}: use "first-estimates" or "right-invariant"'
            )
        landmark = self.landmark
        if landmark.in_anchor and self.error.constrains:
            raise ValueError(
                f"landmark {type(landmark).__name__} is in the frame of its anchor: error must not be first-estimates, "
                f"got {type(self.error).__name__}"
            )
        if self.gauge_walk and not (self.landmark.anchored or _can_shift(self.landmark)):
            raise ValueError(
                f"landmark must have shifted with gauge_walk, {type(self.landmark).__name__} has not: see LandmarkModel"
            )
        _ = self.layout

    @cached_property
    def layout(self) -> StateLayout:
        """Rows of the named variables that the parts ask for."""
        return StateLayout.of(self.measurement.variables, self.motion.variables, self.measurement.sees_velocity)


def _can_shift(landmark: LandmarkModel) -> bool:
    """Whether it says what a shift of the world does to landmarks without an anchor."""
    own = type(landmark)
    if own.in_anchor or own.in_world:
        return True
    return own.shifted is not LandmarkModel.shifted or own.world_translation is not LandmarkModel.world_translation


def _check_landmark(landmark: LandmarkModel) -> None:
    """Raise a `ValueError` where the numbers that a parametrisation states do not fit together."""
    name, size, prior = type(landmark).__name__, landmark.size, landmark.prior
    if not 3 <= size <= landmark.value_size:
        raise ValueError(f"size of landmark {name} must be from 3 to its value_size {landmark.value_size}, got {size}")
    if size > 3:
        covariance_matrix(f"prior of landmark {name}", np.zeros((0, 0)) if prior is None else prior, size - 3)
    elif prior is not None:
        raise ValueError(f"prior of landmark {name} must be None, got {prior!r}: all {size} numbers are measured")
    if landmark.memory is not None:
        positive(f"memory of landmark {name}", landmark.memory)
        if not 3 < size == landmark.value_size:
            raise ValueError(
                f"size of landmark {name} must be its value_size and more than 3 where it has memory, got {size}"
            )
    if size > 3 and not landmark.steady:
        raise ValueError(f"size of landmark {name} must be 3 where landmarks may become points, got {size}")
    others = landmark.anchored or landmark.submaps or not landmark.steady
    if landmark.in_anchor and others:
        raise ValueError(
            f"landmark {name} is in the frame of its anchor: it must have no anchors or submaps, and not become a point"
        )
