"""Inverse depth with measurement errors of the landmark's own that last: a Gauss-Markov process in (u, v, d).

Derivation: docs/derivations/inverse_depth.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from filters.contract.validation import covariance_matrix, positive
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.machine_code import compiled
from filters.landmarks.inverse_depth import KERNELS, InverseDepth
from filters.landmarks.landmark_model import LandmarkKernels, LandmarkModel

assert KERNELS.turn is not None
assert KERNELS.rotation is not None
_ray_point, _ray_start = compiled(KERNELS.point), compiled(KERNELS.start)
_ray_turn, _ray_rotation = compiled(KERNELS.turn), compiled(KERNELS.rotation)


def _point(settings: FloatArray, values: FloatArray, points: FloatArray, J: FloatArray) -> None:
    _ray_point(settings, values[:, :3], points[:, :4], J[:, :4, :3])
    for i in range(len(values)):
        for a in range(3):
            points[i, 4 + a], J[i, 4 + a, 3 + a] = values[i, 3 + a], 1.0


def _start(settings: FloatArray, points: FloatArray, values: FloatArray, J: FloatArray, possible: BoolArray) -> None:
    _ray_start(settings, points[:, :4], values[:, :3], J[:, :3, :4], possible)
    for i in range(len(values)):
        for a in range(3):
            values[i, 3 + a], J[i, 3 + a, 4 + a] = points[i, 4 + a], 1.0


def _turn(
    settings: FloatArray,
    values: FloatArray,
    theta: FloatArray,
    correction: FloatArray,
    moved: FloatArray,
    J: FloatArray,
    J_theta: FloatArray,
) -> None:
    _ray_turn(settings, values[:, :3], theta, correction[:, :3], moved[:, :3], J[:, :3, :3], J_theta[:, :3])
    for i in range(len(values)):
        for a in range(3, 6):
            moved[i, a], J[i, a, a] = values[i, a] + correction[i, a], 1.0


def _rotation(settings: FloatArray, values: FloatArray, effect: FloatArray) -> None:
    _ray_rotation(settings, values[:, :3], effect[:, :3])


@dataclass(frozen=True)
class LastingErrors(LandmarkModel):
    """(theta, phi, rho) from a shared anchor, and the errors of its u, v and d that last, px: six numbers each.

    No single measurement tells such an error from the place; it starts with its covariance, is forgotten, and shows
    when the camera has moved. To be measured by a `PairWithLastingErrors`.

    Parameters
    ----------
    covariance : (3, 3) array_like
        Of the errors, px^2, whenever they are looked at.
    time : float
        Time constant of a Gauss-Markov process of first order, s: their correlation after t is exp(-t / time).

    Raises
    ------
    ValueError
        The matrix is not symmetric and positive semidefinite, or the time is not a number > 0.
    """

    covariance: ArrayLike = ((0.5, 0.0, 0.5), (0.0, 0.5, 0.0), (0.5, 0.0, 1.0))
    time: float = 2.0
    anchored: ClassVar[bool] = True
    shares_anchors: ClassVar[bool] = True
    size: ClassVar[int] = 6
    value_size: ClassVar[int] = 6
    seen_size: ClassVar[int] = 7
    follows: ClassVar[tuple[int, ...]] = (2, 3, 4, 5)
    kernels: ClassVar[LandmarkKernels | None] = LandmarkKernels(_point, _start, _turn, _rotation)

    def __post_init__(self) -> None:
        matrix = covariance_matrix("covariance of lasting errors", self.covariance, 3)
        object.__setattr__(self, "covariance", tuple(map(tuple, matrix.tolist())))
        positive("time of lasting errors", self.time)

    @property
    def prior(self) -> FloatArray:  # type: ignore[override]
        """Of the errors."""
        return np.array(self.covariance)

    @property
    def memory(self) -> float:  # type: ignore[override]
        """The time constant."""
        return self.time

    def can_start(self, h_w: FloatArray, scale: FloatArray) -> BoolArray:
        """As inverse depth."""
        return _RAY.can_start(h_w, scale[:, 0])

    def parameters_of(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> FloatArray:
        """As inverse depth, and the errors."""
        return np.hstack([_RAY.parameters_of(position, h_w, scale[:, 0]), scale[:, 1:]])

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Direction, scale, errors."""
        return np.hstack([_RAY.homogeneous(position, anchors, parameters[:, :3]), parameters[:, 3:]])

    def rotated(self, anchors: FloatArray | None, parameters: FloatArray, R: FloatArray) -> FloatArray:
        """The ray turns."""
        return np.hstack([_RAY.rotated(anchors, parameters[:, :3], R), parameters[:, 3:]])

    def turned(
        self,
        anchors: FloatArray | None,
        parameters: FloatArray,
        turn: FloatArray,
        spread: FloatArray,
        correction: FloatArray,
    ) -> FloatArray:
        """As inverse depth; the errors are added."""
        ray = _RAY.turned(anchors, parameters[:, :3], turn, spread, correction[:, :3])
        return np.hstack([ray, parameters[:, 3:] + correction[:, 3:]])


_RAY = InverseDepth()
