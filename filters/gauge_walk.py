"""Gauge walk: camera and map together make a random walk in the six directions that vision cannot see.

It stands for errors that all landmarks have in common, such as those of calibration and mounting: they show in no
innovation, turn and shift the whole estimate, and grow with the way. A measurement says nothing about these directions,
so the walk costs it nothing, provided that the Jacobians know them: those of first-estimates and right-invariant
errors do, other ones take a large variance there for information.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from filters import rotations
from filters.validation import FloatArray, positive


@dataclass(frozen=True)
class GaugeWalk:
    """Random walk of camera and map together, by the way travelled.

    Parameters
    ----------
    rotation : float
        About the camera, rad per root of a metre.
    translation : float
        m per root of a metre.

    Raises
    ------
    ValueError
        A number is negative or not finite.
    """

    rotation: float = 0.0
    translation: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rotation", "translation"):
            positive(f"{name} of gauge_walk", getattr(self, name), allow_zero=True)

    @classmethod
    def of(cls, given: GaugeWalk | Mapping[str, Any] | None) -> GaugeWalk | None:
        """Gauge walk from itself or a table of its numbers; None stays None.

        Raises
        ------
        ValueError
            It is something else, or a number is impossible.
        """
        if given is None or isinstance(given, cls):
            return given
        if not isinstance(given, Mapping) or set(given) - {"rotation", "translation"}:
            raise ValueError(f"gauge_walk must be a table of rotation and translation, or None, got {given!r}")
        return cls(**given)

    def directions(
        self, rotation: FloatArray, translation: FloatArray, position: FloatArray, distance: float
    ) -> FloatArray:
        """B with P += B B^T for a step.

        Parameters
        ----------
        rotation, translation : (n, 3)
            Effects of a rotation of the world about its origin and of a shift of the world on the error state.
        position : (3,)
            Of the camera, W.
        distance : float
            Travelled, m.

        Returns
        -------
        (n, 6)
            Rotation about the camera, then translation.
        """
        about_camera = rotation + translation @ rotations.skew(position)
        root: float = np.sqrt(distance)
        return np.hstack([self.rotation * root * about_camera, self.translation * root * translation])
