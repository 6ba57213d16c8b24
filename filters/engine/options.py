"""Checked options of `StereoEKF`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from filters.bodies.rigid_bodies import RigidBodies
from filters.contract.inputs import InertialSamples, Start
from filters.contract.noise import LandmarkDrift
from filters.contract.outputs import VELOCITY
from filters.contract.validation import covariance_matrix, gate_probability, positive
from filters.errors import ErrorDefinition, Linearisation
from filters.joint_state import StateLayout
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel, Rig
from filters.motions.motion_model import CAMERA_SIZE, CameraState, MotionModel
from filters.parts import make_part


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
    bodies: RigidBodies | None

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
        bodies: Any,
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
            bodies=RigidBodies.of(bodies),
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
        for part in (self.landmark, self.measurement, self.motion):
            check_functions(part)
        _check_landmark(self.landmark)
        expected_size, taken = self.landmark.seen_size, self.measurement.seen_size
        if expected_size != taken:
            raise ValueError(
                f"measurement must have seen_size = {expected_size} with landmark={type(self.landmark).__name__}, "
                f"got {type(self.measurement).__name__} with {taken}: it measures other landmarks"
            )
        if self.update.sigma_points(CAMERA_SIZE):
            if self.error.first_estimates:
                raise ValueError(
                    f"error must linearise at the state with update={type(self.update).__name__}, which takes no "
                    f'Jacobians, got {type(self.error).__name__}: use "so3", or update="extended"'
                )
            if self.measurement.variables or self.measurement.sees_velocity:
                raise ValueError(
                    f"measurement must have no variables with update={type(self.update).__name__}, which takes no "
                    f'Jacobians, got {type(self.measurement).__name__}: use update="extended"'
                )
        if self.bodies is not None and not _is_rectified(self.measurement):
            raise ValueError(
                f"measurement must be of a rectified pair with bodies, got {type(self.measurement).__name__}: "
                'use "joint", or no bodies'
            )
        positive("gauge_walk", self.gauge_walk, allow_zero=True)
        if self.gauge_walk and not self.error.keeps_gauge:
            raise ValueError(
                "error must keep what cannot be observed unobservable with gauge_walk, "
                f'got {type(self.error).__name__}: use "first-estimates" or "right-invariant"'
            )
        _ = self.layout

    @cached_property
    def layout(self) -> StateLayout:
        """Rows of the named variables that the parts ask for."""
        return StateLayout.of(self.measurement.variables, self.motion.variables, self.measurement.sees_velocity)


def _is_rectified(measurement: MeasurementModel) -> bool:
    """Whether (u, v, d) means what it does to a rectified pair: bodies are told apart by such numbers."""
    rig, uvd = Rig(500.0, 500.0, 320.0, 240.0, 0.2), (330.0, 250.0, 25.0)
    named = measurement.named({**{x.name: x.value for x in measurement.variables}, VELOCITY: np.zeros(6)})
    point = np.array(measurement.unproject(rig, uvd, *named)[:4], dtype=np.float64)
    return bool(np.allclose(point / point[2], [0.02, 0.02, 1.0, 0.25]))


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
    if landmark.in_world and not landmark.additive:
        raise ValueError(f"landmark {name} is a point of W: its retraction must be addition, without retract_by")


_FUNCTIONS: Mapping[type, tuple[tuple[str, ...], tuple[str, ...]]] = {
    LandmarkModel: (
        ("point_of", "start_from"),
        ("started", "relative_to", "points", "inverse_distances"),
    ),
    MeasurementModel: (
        ("project", "unproject"),
        ("predict", "backproject", "in_front", "jacobians", "backprojection_jacobians", "stages"),
    ),
    MotionModel: (("step",), ("predict", "odometry_measurement", "stepped", "expected_odometry")),
}
"""Plain functions that a part gives, and what follows from them."""


def check_functions(part: LandmarkModel | MeasurementModel | MotionModel) -> None:
    """Raise a `ValueError` where a part lacks a plain function, overrides what follows, or gives another count."""
    cls = type(part)
    base = next(kind for kind in _FUNCTIONS if isinstance(part, kind))
    base_function, following = _FUNCTIONS[base]
    for name in base_function:
        if getattr(cls, name) is getattr(base, name):
            raise ValueError(f"{cls.__name__} must have {' and '.join(base_function)}: see {base.__name__}")
    for name in following:
        if getattr(cls, name) is not getattr(base, name):
            raise ValueError(
                f"{cls.__name__} must not have {name} of its own: it follows from {' and '.join(base_function)}"
            )
    for name, expected, call in _calls(part):
        try:
            numbers = call()
        except (ArithmeticError, ValueError):  # these numbers are none that it can have
            continue
        lengths = tuple(map(len, numbers)) if isinstance(expected, tuple) else len(numbers)
        if lengths != expected:
            raise ValueError(f"{cls.__name__}.{name} must give {expected} numbers, got {lengths}")


def _calls(part: Any) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Plain functions with how many numbers they must give, and a call with some numbers."""
    if isinstance(part, LandmarkModel):
        sample, value = (0.1, 0.2, 0.9, 0.05, *[0.1] * part.seen_size)[: part.seen_size], (0.1,) * part.value_size
        yield "point_of", part.seen_size, lambda: part.point_of(value)
        yield "start_from", part.value_size, lambda: part.start_from(sample)
        yield "retract_by", part.value_size, lambda: part.retract_by(value, (0.1,) * part.size)
    elif isinstance(part, MeasurementModel):
        rig = Rig(500.0, 500.0, 320.0, 240.0, 0.2)
        sample = (0.1, 0.2, 0.9, 0.05, *[0.1] * part.seen_size)[: part.seen_size]
        named = part.named({**{x.name: x.value for x in part.variables}, VELOCITY: np.full(6, 0.1)})
        yield "project", part.size, lambda: part.project(rig, sample, *named)
        yield "unproject", part.seen_size, lambda: part.unproject(rig, (330.0, 250.0, 10.0), *named)
    else:
        sizes = tuple(size for _, size in part.layout)
        x = part.numbers_of(CameraState.at(Start(), {variable.name: variable.value for variable in part.variables}))
        nothing, unit = (0.0, 0.0, 0.0), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        noise: Any = (nothing,) * 4 + unit if part.takes is InertialSamples else (nothing,) * 2
        if not part.driven:
            noise = (0.0,) * len(part.sigmas(0.1))
        yield "step", sizes, lambda: part.step(part.record(x), 0.1, noise)
