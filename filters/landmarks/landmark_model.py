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

from filters.geometry import derivatives, rotations, vectors
from filters.geometry.arrays import BoolArray, FloatArray
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
    by_direction: FloatArray
    """(M, size, 3 for each vector): with respect to the direction, or all seen vectors, in W."""
    by_scale: FloatArray
    """(M, size): with respect to the scale; (M, size, k) to k other seen numbers."""
    anchored: BoolArray
    """(M,): whether the landmark has an anchor."""

    @property
    def by_seen(self) -> FloatArray:
        """With respect to all seen numbers, (M, size, seen_size)."""
        by_rest = self.by_scale[:, :, None] if self.by_scale.ndim == 2 else self.by_scale
        return np.concatenate([self.by_direction, by_rest], axis=2)


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
    stands for a landmark without one. The camera position is one for all landmarks, (3,), or one for each, (M, 3).

    References
    ----------
    Civera, Davison and Montiel, "Inverse depth parametrization for monocular SLAM", IEEE TRO 24(5), 2008.
    Sola, Vidal-Calleja, Civera and Montiel, "Impact of landmark parametrization on monocular EKF-SLAM with points and
    lines", IJCV 97(3), 2012.
    Huang, Mourikis and Roumeliotis, "Observability-based rules for designing consistent EKF SLAM estimators", IJRR
    29(5), 2010 (`first_estimates`).
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
    seen_vectors: ClassVar[int] = 1
    """How many vectors lead them, which turn with the camera: the direction of a point; two of a line."""
    in_anchor: ClassVar[bool] = False
    """Whether values are in the frame of the camera from which the landmark was first seen. That pose is its anchor, a
    clone in the state. All functions are in that frame: the camera position is zero when a landmark starts, and there
    are no anchors, no machine code and no first-estimates Jacobians."""
    prior: FloatArray | None = None
    """Covariance (size - 3, size - 3) of the error numbers behind the third, which the first measurement of a landmark
    leaves open: about the values from `parameters_of`, independent of all else."""
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
    """Whether the plain functions are all that it does, so that they can be compiled; else they run on columns."""

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

    # --- the same for columns: many landmarks at once, as the NumPy of the engine takes them ---

    def parameters_of(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> FloatArray:
        """Values of landmarks at position + h_w / scale, directions (M, 3) in W and scales (M,); (M, v).

        Of landmarks that are seen by other numbers, too, scale is (M, 1 + others).
        """
        return columns_of(self.start_from, self._from_origin(position, h_w, scale))

    def can_start(self, h_w: FloatArray, scale: FloatArray) -> BoolArray:
        """Which directions (M, 3) in W and scales (M,) a landmark can start from; (M,)."""
        seen = self._from_origin(np.zeros(3), h_w, scale)
        return columns_of(lambda h: (self.can_start_from(h),), seen)[:, 0].astype(np.bool_)

    def started(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> StartedLandmarks:
        """`parameters_of` with its Jacobians."""
        seen = self._from_origin(position, h_w, scale)
        values = columns_of(self.start_from, seen)
        J = jacobian_of(lambda h, y: self.local_by(y, self.start_from(h)), seen, values)[1]
        by_direction, by_scale, by_position = J[:, :, :3], J[:, :, 3:].copy(), np.zeros_like(J[:, :, :3])
        if not (self.anchored or self.in_anchor):
            by_position = by_direction * seen[:, 3, None, None]
            by_scale[:, :, 0] += by_direction @ position
        anchored = np.full(len(values), self.anchored)
        return StartedLandmarks(
            values, by_position, by_direction, by_scale[:, :, 0] if scale.ndim == 1 else by_scale, anchored
        )

    def _from_origin(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> FloatArray:
        """Seen numbers (M, k) from the anchor, which is the camera position, or from the origin of W."""
        seen = np.column_stack([h_w, scale])
        if not (self.anchored or self.in_anchor):
            seen[:, :3] += position * seen[:, 3:4]
        return seen

    def retract(self, parameters: FloatArray, delta: FloatArray) -> FloatArray:
        """Values corrected by (M, size)."""
        if self.additive:
            return parameters + delta
        return columns_of(self.retract_by, parameters, np.broadcast_to(delta, (len(parameters), self.size)))

    def local(self, parameters: FloatArray, other: FloatArray) -> FloatArray:
        """The correction (M, size) that takes `parameters` to `other`."""
        return other - parameters if self.additive else columns_of(self.local_by, parameters, other)

    def transport(self, parameters: FloatArray, delta: FloatArray) -> FloatArray | None:
        """d local(retract(x, delta), retract(x, delta + e)) / d e, (M, size, size); None: the identity, of addition."""
        if self.additive:
            return None

        def moved(e: Numbers, y: Numbers, c: Numbers) -> Numbers:
            return self.local_by(
                self.retract_by(y, c), self.retract_by(y, tuple(a + b for a, b in zip(c, e, strict=True)))
            )

        delta = np.broadcast_to(delta, (len(parameters), self.size))
        return jacobian_of(moved, np.zeros_like(delta), parameters, delta)[1]

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Landmarks as seen from the camera position: direction in W, and scale; (M, seen_size)."""
        seen = columns_of(self.point_of, parameters)
        seen[:, :3] += seen[:, 3:4] * (-position if anchors is None else anchors - position)
        return seen

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """`homogeneous` with its Jacobians."""
        none = np.zeros((len(parameters), self.size))
        seen, J = jacobian_of(lambda e, y: self.point_of(self.retract_by(y, e)), none, parameters)
        way = np.broadcast_to(-position if anchors is None else anchors - position, (len(seen), 3))
        seen[:, :3] += seen[:, 3:4] * way
        J[:, :3] += way[:, :, None] * J[:, 3:4]
        by_anchor = seen[:, 3, None, None] * np.eye(self.seen_size, 3)
        return ScaledPoints(seen, -by_anchor, J if anchors is None else np.concatenate([by_anchor, J], axis=2))

    def rotated(self, anchors: FloatArray | None, parameters: FloatArray, R: FloatArray) -> FloatArray:
        """Values in a world rotated about its origin, without the anchors; R (3, 3) -> (M, v)."""
        if self.in_anchor:
            return parameters
        seen = columns_of(self.point_of, parameters)
        seen[:, :3] = seen[:, :3] @ R.T
        return columns_of(self.start_from, seen)

    def world_rotation(self, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """d own error numbers / d (rotation vector of the world about its origin); (M, size, 3)."""
        if self.in_anchor:
            return np.zeros((len(parameters), self.size, 3))

        def turned(theta: Numbers, y: Numbers) -> Numbers:
            h = self.point_of(y)
            return self.local_by(y, self.start_from((*vectors.turned_by(theta, h[:3]), *h[3:])))

        return jacobian_of(turned, np.zeros((len(parameters), 3)), parameters)[1]

    def shifted(self, parameters: FloatArray, shift: FloatArray) -> FloatArray:
        """Values of landmarks without an anchor in a world shifted by (3,); (M, v). A walk of the gauge needs it."""
        if not self.in_world:
            raise NotImplementedError(f"{type(self).__name__} must have shifted: see LandmarkModel")
        moved: FloatArray = parameters + np.concatenate([shift, np.zeros(self.value_size - 3)])
        return moved

    def world_translation(self, parameters: FloatArray) -> FloatArray:
        """d own error numbers / d (shift of the world), of landmarks without an anchor; (M, size, 3)."""
        return derivatives.jacobian(lambda e: self.local(parameters, self.shifted(parameters, e)), 3)

    def turned(
        self, anchors: FloatArray | None, parameters: FloatArray, theta: FloatArray, correction: FloatArray
    ) -> FloatArray:
        """`turned_by` for values (M, v) and corrections (M, size); theta (3,) is one for all."""
        if self.in_anchor:
            return self.retract(parameters, correction)
        return columns_of(lambda y, c: self.turned_by(y, tuple(theta), c), parameters, correction)

    def turned_jacobians(
        self, anchors: FloatArray | None, parameters: FloatArray, theta: FloatArray, correction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Jacobians of `turned` by the correction and by theta (3,), (M, size, size) and (M, size, 3)."""
        there = self.turned(anchors, parameters, theta, correction)

        def by_correction(c: Numbers, y: Numbers, end: Numbers) -> Numbers:
            return self.local_by(end, self.retract_by(y, c) if self.in_anchor else self.turned_by(y, tuple(theta), c))

        def by_theta(turn: Numbers, y: Numbers, end: Numbers, c: Numbers) -> Numbers:
            return self.local_by(end, self.turned_by(y, turn, c))

        J = jacobian_of(by_correction, correction, parameters, there)[1]
        if self.in_anchor:
            return J, np.zeros((len(J), self.size, 3))
        return J, jacobian_of(by_theta, theta[None], parameters, there, correction)[1]

    def first_estimates(self, anchors: FloatArray | None, first: FloatArray, current: FloatArray) -> FloatArray:
        """Values at which first-estimates Jacobians are taken; (M, v), (M, v) -> (M, v)."""
        estimates = first.copy()
        estimates[:, self.follows] = current[:, self.follows]
        return estimates

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

    def become_points(
        self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray, variances: FloatArray
    ) -> BoolArray:
        """`becomes_point` for landmarks with anchors (M, 3), values (M, v), variances (M, size), from `position`."""
        given = np.zeros_like(parameters[:, :3]) if anchors is None else anchors - position, parameters, variances
        return columns_of(lambda *one: (self.becomes_point(*one),), *given)[:, 0].astype(np.bool_)

    def point(self, seen: FloatArray) -> FloatArray:
        """Homogeneous points (M, 4) that stand for landmarks seen so, (M, seen_size): what a map says of them.

        The default takes the first four numbers. A line may take its point nearest to where it is seen from.
        """
        return seen[:, :4]

    @property
    def additive(self) -> bool:
        """Whether the retraction is addition."""
        own = type(self)
        return own.retract_by is LandmarkModel.retract_by and own.retract is LandmarkModel.retract

    def points(self, anchors: FloatArray | None, parameters: FloatArray) -> Points:
        """Landmark positions in W, direction / scale as seen from its origin; not finite at scale 0."""
        seen = self._as_points(self.relative_to(np.zeros(3), anchors, parameters))
        scale = seen.homogeneous[:, 3, None]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            positions = seen.homogeneous[:, :3] / scale
            by_map = (seen.by_map[:, :3] - positions[:, :, None] * seen.by_map[:, 3:]) / scale[:, :, None]
        return Points(positions, by_map)

    def inverse_distances(
        self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray
    ) -> InverseDistances:
        """Inverse distances from the anchor, or from the camera position where there is no anchor."""
        origin, free = np.broadcast_to(position, (len(parameters), 3)), np.ones(len(parameters), dtype=bool)
        if anchors is not None:
            free = np.isnan(anchors[:, 0])
            origin = np.where(free[:, None], origin, anchors)
        seen = self._as_points(self.relative_to(origin, anchors, parameters))
        direction, scale = seen.homogeneous[:, :3], seen.homogeneous[:, 3]
        inverse = 1.0 / np.linalg.norm(direction, axis=1)
        by_seen = np.concatenate([-(scale * inverse**3)[:, None] * direction, inverse[:, None]], axis=1)[:, None]
        by_position = (by_seen @ seen.by_position)[:, 0] * free[:, None]
        return InverseDistances(scale * inverse, by_position, (by_seen @ seen.by_map[:, :, -self.size :])[:, 0])

    def apart(self, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Seen numbers (M, seen_size) as `parameters_of` takes them: the vectors, and the others."""
        rest = seen[:, 3 * self.seen_vectors :]
        return seen[:, : 3 * self.seen_vectors], rest[:, 0] if rest.shape[1] == 1 else rest

    def with_axes(self, R: FloatArray, seen: FloatArray) -> FloatArray:
        """Seen numbers (M, seen_size) whose vectors are turned by R (3, 3), or by (M, 3, 3)."""
        vectors = [rotations.turned(R, seen[:, 3 * i : 3 * i + 3]) for i in range(self.seen_vectors)]
        return np.concatenate([*vectors, seen[:, 3 * self.seen_vectors :]], axis=1)

    def _as_points(self, seen: ScaledPoints) -> ScaledPoints:
        """The points that stand for landmarks, with their Jacobians."""
        if type(self).point is LandmarkModel.point:
            return ScaledPoints(seen.homogeneous[:, :4], seen.by_position[:, :4], seen.by_map[:, :4])
        J = derivatives.jacobian(lambda e: self.point(seen.homogeneous + e), self.seen_size)
        return ScaledPoints(self.point(seen.homogeneous), J @ seen.by_position, J @ seen.by_map)
