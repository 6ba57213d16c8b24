"""The parts that the slots name, with their default settings: tests run over all of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from filters.contract.inputs import BodyVelocity
from filters.errors import ErrorDefinition, Linearisation
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel
from filters.motions.motion_model import MotionModel
from filters.parts import SLOTS


def parts_of(slot: str) -> dict[str, Any]:
    """Parts of a slot by name."""
    return {name: make() for name, make in SLOTS[slot].named.items()}


LANDMARKS: Mapping[str, LandmarkModel] = parts_of("landmark")
MEASUREMENTS: Mapping[str, MeasurementModel] = parts_of("measurement")
MOTIONS: Mapping[str, MotionModel] = {
    name: motion for name, motion in parts_of("motion").items() if motion.takes is BodyVelocity
}
"""Those driven by a velocity or by nothing; `motions/test_strapdown.py` is of the one that takes inertial samples."""
ERRORS: Mapping[str, ErrorDefinition] = parts_of("error")
UPDATES: Mapping[str, Linearisation] = parts_of("update")
