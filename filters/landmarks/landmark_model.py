"""Base class of landmark parametrisations.

Every landmark is one block of `size` error numbers in the state, three or more, plus, where it is anchored, one block
for the anchor position. Its value is `value_size` numbers, and a correction of `size` numbers retracts it. A part gives
two functions of tuples of numbers: its homogeneous point, and the value that starts from one. What else a filter needs
is made of them, in machine code and for columns of landmarks; Jacobians are those of dual numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from filters.geometry import vectors
from filters.geometry.arrays import FloatArray
from filters.geometry.derivatives import columns_of, jacobian_of

Numbers = Any
"""Tuple of numbers: floats in machine code, columns or dual numbers."""


@dataclass(frozen=True, eq=False)
class StartedLandmarks:
    """Values of M new landmarks (Eq. 19) and the Jacobians of their error numbers (Eq. 25)."""

    parameters: FloatArray
    """(M, v): without the anchor, which is the camera position itself."""
    by_position: FloatArray
    """(M, size, 3): with respect to r^WC."""
    by_seen: FloatArray
    """(M, size, seen_size): with respect to the direction in W, the scale and what else is seen."""


@dataclass(frozen=True, eq=False)
class ScaledPoints:
    """M landmarks as seen from the camera centre, in homogeneous form: point - r^WC = direction / scale."""

    homogeneous: FloatArray
    """(M, seen_size): of points, the direction in W (3) and the scale."""
    by_position: FloatArray
    """(M, seen_size, 3): Jacobian by the camera position."""
    by_map: FloatArray
    """(M, seen_size, w): Jacobian by the anchor (where the model has anchors), then by the own error numbers."""


@dataclass(frozen=True, eq=False)
class Points:
    """M landmark positions (M, 3) in W, m, and their Jacobian (M, 3, w) by anchor (if any) and own error numbers."""

    positions: FloatArray
    by_map: FloatArray


@dataclass(frozen=True, eq=False)
class InverseDistances:
    """Inverse distances (M,), 1/m, their Jacobians by the camera position (M, 3) and by the own errors (M, size)."""

    values: FloatArray
    by_position: FloatArray
    by_parameters: FloatArray


class LandmarkModel:
    """Parametrisation of landmarks: its start, its place relative to a camera, its retraction, and their Jacobians.

    Everywhere below, `parameters` are (M, v) and `anchors` (M, 3), or None where the model has none; a row of NaN
    stands for a landmark that has become a point of W. The camera position is (3,), or one for each, (M, 3).

    References
    ----------
    Civera, Davison and Montiel, "Inverse depth parametrization for monocular SLAM", IEEE TRO 24(5), 2008.
    Sola, Vidal-Calleja, Civera and Montiel, "Impact of landmark parametrization on monocular EKF-SLAM with points and
    lines", IJCV 97(3), 2012.
    Huang, Mourikis and Roumeliotis, "Observability-based rules for designing consistent EKF SLAM estimators", IJRR
    29(5), 2010 (first estimates).
    """

    anchored: ClassVar[bool] = False
    """Whether landmarks have an anchor block in the state (with `Hybrid` some have none)."""
    shares_anchors: ClassVar[bool] = False
    """Whether landmarks that enter the map in one frame share one anchor block."""
    size: ClassVar[int] = 3
    """Error numbers of a landmark, at least 3: those that its first measurement determines, then those of `prior`."""
    value_size: ClassVar[int] = 3
    """Numbers of a landmark's value, at least `size`."""
    seen_size: ClassVar[int] = 4
    """Numbers by which a landmark is seen: of a point, direction (3) and scale. More: others behind them."""
    prior: FloatArray | None = None
    """Covariance (size - 3, size - 3) of the error numbers behind the third, which the first measurement of a landmark
    leaves open: about the values from `start_from`, independent of all else."""
    memory: float | None = None
    """Time constant with which those go back to zero, s: a Gauss-Markov process of first order, `prior` its covariance
    in the long run. They are the last numbers of the value, and add. None: they stay as they are."""
    steady: ClassVar[bool] = True
    """Whether a frame in which no landmark comes or goes leaves the map's structure as it is."""
    submaps: ClassVar[bool] = False
    """Whether `SubmapEKF` can keep such landmarks: their retraction is addition."""
    follows: ClassVar[tuple[int, ...]] = ()
    """Numbers of the value that first-estimates Jacobians take from the present estimate."""
    in_world: ClassVar[bool] = False
    """Whether the first three numbers of a value are a point of W, m, and others do not turn."""
    in_machine_code: bool = True
    """Whether the plain functions are compiled; else they run in Python, on columns."""

    # --- what a part gives: plain functions of tuples of numbers ---

    def point_of(self, y: Numbers) -> Numbers:
        """Homogeneous point (x, y, z, scale) of a value, from its anchor or the origin of W, in the axes of W.

        Behind these four may stand other numbers by which it is seen (`seen_size`), the same from everywhere.
        """
        raise NotImplementedError(f"{type(self).__name__} must have point_of and start_from: see LandmarkModel")

    def start_from(self, h: Numbers) -> Numbers:
        """Value of a new landmark at what `point_of` gives."""
        raise NotImplementedError(f"{type(self).__name__} must have point_of and start_from: see LandmarkModel")

    def can_start_from(self, h: Numbers) -> Any:
        """Whether a landmark can start from there."""
        return True

    def retract_by(self, y: Numbers, c: Numbers) -> Numbers:
        """Value corrected by `size` numbers; the default adds them."""
        return tuple(a + b for a, b in zip(y, c, strict=True))

    def local_by(self, y: Numbers, other: Numbers) -> Numbers:
        """Correction that takes one value to another one."""
        return tuple(b - a for a, b in zip(y, other, strict=True))

    def turned_by(self, y: Numbers, theta: Numbers, c: Numbers) -> Numbers:
        """Value corrected and turned with the world by Exp(theta), as the retraction of an invariant error wants it.

        The correction is without what the turn does. The default corrects, then turns, which is exact for points; a ray
        is better treated as a point of the group (docs/derivations/errors.md).
        """
        h = self.point_of(self.retract_by(y, c))
        return self.start_from((*vectors.turned_by(theta, h[:3]), *h[3:]))

    def becomes_point(self, to_anchor: Numbers, y: Numbers, variances: Numbers) -> Any:
        """Whether a landmark is to become XYZ after this frame; asked only of models that are not `steady`.

        Parameters
        ----------
        to_anchor : tuple of 3
            From the camera to the anchor, m.
        y, variances : tuples
            Value, and variances of its error numbers.
        """
        return False

    # --- maps of many landmarks at once ---

    def started(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> StartedLandmarks:
        """New landmarks at position + h_w / scale, directions (M, 3) in W and scales (M,), with their Jacobians.

        Of landmarks that are seen by other numbers, too, scale is (M, 1 + others).
        """
        homogeneous = np.column_stack([h_w, scale])
        if not self.anchored:
            homogeneous[:, :3] += position * homogeneous[:, 3:4]
        values = columns_of(self.start_from, homogeneous)
        J = jacobian_of(lambda h, y: self.local_by(y, self.start_from(h)), homogeneous, values)[1]
        by_position = np.zeros_like(J[:, :, :3])
        if not self.anchored:
            by_position = J[:, :, :3] * homogeneous[:, 3, None, None]
            J[:, :, 3] += J[:, :, :3] @ position
        return StartedLandmarks(values, by_position, J)

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """Landmarks as seen from the camera position, with the Jacobians."""
        none = np.zeros((len(parameters), self.size))
        derived, J = jacobian_of(lambda e, y: self.point_of(self.retract_by(y, e)), none, parameters)
        if anchors is not None:
            are_points = np.isnan(anchors[:, 0])
            derived[are_points, :3], derived[are_points, 3] = parameters[are_points, :3], 1.0
            J[are_points, :3], J[are_points, 3] = np.eye(3, self.size), 0.0
            anchors = np.where(are_points[:, None], 0.0, anchors)
        way = np.broadcast_to(-position if anchors is None else anchors - position, (len(derived), 3))
        derived[:, :3] += derived[:, 3:4] * way
        J[:, :3] += way[:, :, None] * J[:, 3:4]
        by_anchor = derived[:, 3, None, None] * np.eye(self.seen_size, 3)
        if anchors is None:
            return ScaledPoints(derived, -by_anchor, J)
        return ScaledPoints(derived, -by_anchor, np.concatenate([by_anchor * ~are_points[:, None, None], J], axis=2))

    @property
    def additive(self) -> bool:
        """Whether the retraction is addition."""
        return type(self).retract_by is LandmarkModel.retract_by

    def points(self, anchors: FloatArray | None, parameters: FloatArray) -> Points:
        """Landmark positions in W, direction / scale as seen from its origin; not finite at scale 0."""
        homogeneous = self.relative_to(np.zeros(3), anchors, parameters)
        scale = homogeneous.homogeneous[:, 3, None]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            positions = homogeneous.homogeneous[:, :3] / scale
            by_map = (homogeneous.by_map[:, :3] - positions[:, :, None] * homogeneous.by_map[:, 3:4]) / scale[
                :, :, None
            ]
        return Points(positions, by_map)

    def inverse_distances(
        self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray
    ) -> InverseDistances:
        """Inverse distances from the anchor, or from the camera position where there is no anchor."""
        origin, free = np.broadcast_to(position, (len(parameters), 3)), np.ones(len(parameters), dtype=bool)
        if anchors is not None:
            free = np.isnan(anchors[:, 0])
            origin = np.where(free[:, None], origin, anchors)
        homogeneous = self.relative_to(origin, anchors, parameters)
        direction, scale = homogeneous.homogeneous[:, :3], homogeneous.homogeneous[:, 3]
        inverse = 1.0 / np.linalg.norm(direction, axis=1)
        by_seen = np.concatenate([-(scale * inverse**3)[:, None] * direction, inverse[:, None]], axis=1)[:, None]
        by_position = (by_seen @ homogeneous.by_position[:, :4])[:, 0] * free[:, None]
        return InverseDistances(scale * inverse, by_position, (by_seen @ homogeneous.by_map[:, :4, -self.size :])[:, 0])
