"""Checked options of `StereoEKF`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from filters.contract.drift import LandmarkDrift
from filters.errors.model import ErrorDefinition
from filters.landmarks.model import LandmarkModel
from filters.measurements.model import MeasurementModel
from filters.motions.model import MotionModel
from filters.parts import make_part
from filters.state.layout import Layout
from filters.updates.model import Linearisation
from filters.validation import gate_probability, positive


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
    drop_unseen: bool
    min_disparity: float | None
    max_landmarks: int | None

    @classmethod
    def of(
        cls,
        *,
        motion: Any,
        landmark: Any,
        measurement: Any,
        error: Any,
        update: Any,
        drift: Any,
        **others: Any,
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
        if self.max_landmarks is not None and (type(self.max_landmarks) is not int or self.max_landmarks < 1):
            raise ValueError(f"max_landmarks must be an integer >= 1, or None for no limit, got {self.max_landmarks!r}")
        if not self.update.by_jacobians:
            if not self.error.linearises_at_the_state:
                raise ValueError(
                    f"error must linearise at the state with update={type(self.update).__name__}, which takes no "
                    f'Jacobians, got {type(self.error).__name__}: use "so3", or update="extended"'
                )
            if self.measurement.variables:
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
        _ = self.layout

    @cached_property
    def layout(self) -> Layout:
        """Rows of the named variables that the parts ask for."""
        return Layout.of(self.measurement.variables, self.motion.variables)
