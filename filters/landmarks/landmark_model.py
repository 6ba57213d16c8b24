"""Base class of landmark parametrisations.

Every landmark is one block of `size` error numbers in the state, three or more, plus, where it is anchored, one block
for the anchor position. Its value is `value_size` numbers, and a correction of `size` numbers retracts it. A part gives
three functions: how a landmark starts, where it is seen from a camera, and how it turns with the world. The others have
numerical Jacobians by default. All functions take many landmarks at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.geometry import differences, rotations
from filters.geometry.arrays import BoolArray, FloatArray


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


@dataclass(frozen=True)
class LandmarkKernels:
    """Compiled functions of a parametrisation: all its landmarks in C-ordered arrays at once, outputs zero before.

    A kernel is a function that Numba can compile; it writes what it is to give into its last arguments. A landmark is
    related to its anchor, or to the origin of W where it has none; the engine does the rest. The first four of the k
    numbers by which it is seen are those of a point; the others are the same from everywhere. It has n error numbers.
    """

    point: Callable[..., None]
    """Function (settings, values (M, v), points (M, k), J (M, k, n)): homogeneous points, direction in W and scale, and
    what else is seen, and their Jacobians by the error numbers."""
    start: Callable[..., None]
    """Function (settings, points (M, k), values (M, v), J (M, n, k), possible (M,) bool): the inverse: values, the
    Jacobians of their error numbers, and where a landmark can start."""
    turn: Callable[..., None] | None = None
    """Function (settings, values (M, v), theta (3,), correction (M, n), moved (M, v), J (M, n, n), J_theta (M, n, 3)):
    `LandmarkModel.turned` and its Jacobians by the correction and theta. None: values are points of W, and numbers
    behind them that do not turn."""
    rotation: Callable[..., None] | None = None
    """Function (settings, values (M, v), effect (M, n, 3)): `LandmarkModel.world_rotation`."""
    become: Callable[..., None] | None = None
    """Function (settings, to_anchor (M, 3), values (M, v), variances (M, n), becomes (M,) bool): `become_points`, from
    the way from the camera to the anchor. The other kernels are of landmarks that have not become points."""
    settings: tuple[str, ...] = ()
    """Attributes of the part whose numbers are the first argument."""


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
    are no anchors, kernels or first-estimates Jacobians."""
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
    kernels: ClassVar[LandmarkKernels | None] = None
    """The same, compiled. They hold for the class that states them, not for its subclasses."""

    # --- what a part gives ---

    def parameters_of(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> FloatArray:
        """Values of landmarks at position + h_w / scale, directions (M, 3) in W and scales (M,); (M, v).

        Of landmarks that are seen by other numbers than those of a point: their vectors (M, 3 each) in W, and the
        others, (M,) if it is one and (M, k) if there are more.
        """
        raise NotImplementedError(f"{type(self).__name__} must have parameters_of: see LandmarkModel")

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Landmarks as seen from the camera position: direction in W, and scale; (M, seen_size)."""
        raise NotImplementedError(f"{type(self).__name__} must have homogeneous: see LandmarkModel")

    def rotated(self, anchors: FloatArray | None, parameters: FloatArray, R: FloatArray) -> FloatArray:
        """Values in a world rotated about its origin, without the anchors; R (3, 3) -> (M, v)."""
        if self.in_anchor:
            return parameters
        raise NotImplementedError(f"{type(self).__name__} must have rotated: see LandmarkModel")

    # --- what it may give instead of the default ---

    def can_start(self, h_w: FloatArray, scale: FloatArray) -> BoolArray:
        """Which directions (M, 3) in W and scales (M,) a landmark can start from; (M,)."""
        return np.ones(len(h_w), dtype=bool)

    def started(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> StartedLandmarks:
        """`parameters_of` with its Jacobians."""
        parameters, leading = self.parameters_of(position, h_w, scale), 3 + h_w.shape[1]

        def moved(delta: FloatArray) -> FloatArray:
            by_rest = delta[leading] if scale.ndim == 1 else delta[leading:]
            other = self.parameters_of(position + delta[:3], h_w + delta[3:leading], scale + by_rest)
            return self.local(parameters, other)

        J = differences.jacobian(moved, 3 + self.seen_size)
        by_scale = J[:, :, leading] if scale.ndim == 1 else J[:, :, leading:]
        anchored = np.full(len(h_w), self.anchored)
        return StartedLandmarks(parameters, J[:, :, :3], J[:, :, 3:leading], by_scale, anchored)

    def retract(self, parameters: FloatArray, delta: FloatArray) -> FloatArray:
        """Values corrected by (M, size); the default adds."""
        return parameters + delta

    def local(self, parameters: FloatArray, other: FloatArray) -> FloatArray:
        """The correction (M, size) that takes `parameters` to `other`."""
        return other - parameters

    def transport(self, parameters: FloatArray, delta: FloatArray) -> FloatArray | None:
        """d local(retract(x, delta), retract(x, delta + e)) / d e, (M, size, size); None: the identity, of addition."""
        if self.additive:
            return None
        there = self.retract(parameters, delta)
        return differences.jacobian(lambda e: self.local(there, self.retract(parameters, delta + e)), self.size)

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """`homogeneous` with its Jacobians."""

        def moved(delta: FloatArray) -> FloatArray:
            own = self.retract(parameters, np.broadcast_to(delta[6:], (len(parameters), self.size)))
            return self.homogeneous(position + delta[:3], None if anchors is None else anchors + delta[3:6], own)

        J = differences.jacobian(moved, 6 + self.size)
        by_map = J[:, :, 6:] if anchors is None else J[:, :, 3:]
        return ScaledPoints(self.homogeneous(position, anchors, parameters), J[:, :, :3], by_map)

    def world_rotation(self, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """d own error numbers / d (rotation vector of the world about its origin); (M, size, 3)."""
        return differences.jacobian(
            lambda e: self.local(parameters, self.rotated(anchors, parameters, rotations.exp(e))), 3
        )

    def shifted(self, parameters: FloatArray, shift: FloatArray) -> FloatArray:
        """Values of landmarks without an anchor in a world shifted by (3,); (M, v). A walk of the gauge needs it."""
        raise NotImplementedError(f"{type(self).__name__} must have shifted: see LandmarkModel")

    def world_translation(self, parameters: FloatArray) -> FloatArray:
        """d own error numbers / d (shift of the world), of landmarks without an anchor; (M, size, 3)."""
        return differences.jacobian(lambda e: self.local(parameters, self.shifted(parameters, e)), 3)

    def point(self, seen: FloatArray) -> FloatArray:
        """Homogeneous points (M, 4) that stand for landmarks seen so, (M, seen_size): what a map says of them.

        The default takes the first four numbers. A line may take its point nearest to where it is seen from.
        """
        return seen[:, :4]

    def turned(
        self,
        anchors: FloatArray | None,
        parameters: FloatArray,
        turn: FloatArray,
        spread: FloatArray,
        correction: FloatArray,
    ) -> FloatArray:
        """Values corrected and turned with the world, as the retraction of an invariant error wants it.

        Parameters
        ----------
        anchors, parameters : (M, 3), (M, v)
            Before.
        turn, spread : (3, 3)
            Exp(theta), and the left Jacobian of theta.
        correction : (M, 3)
            The correction without what the turn does.
        """
        return self.rotated(anchors, self.retract(parameters, correction), turn)

    def turned_jacobians(
        self, anchors: FloatArray | None, parameters: FloatArray, theta: FloatArray, correction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Jacobians of `turned` by the correction and by theta (3,), (M, size, size) and (M, size, 3)."""
        there = self.turned(anchors, parameters, *_turn(theta), correction)

        def moved(delta: FloatArray) -> FloatArray:
            other = self.turned(anchors, parameters, *_turn(theta + delta[:3]), correction + delta[3:])
            return self.local(there, other)

        J = differences.jacobian(moved, 3 + self.size)
        return J[:, :, 3:], J[:, :, :3]

    def first_estimates(self, anchors: FloatArray | None, first: FloatArray, current: FloatArray) -> FloatArray:
        """Values at which first-estimates Jacobians are taken; (M, v), (M, v) -> (M, v)."""
        estimates = first.copy()
        estimates[:, self.follows] = current[:, self.follows]
        return estimates

    def become_points(
        self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray, variances: FloatArray
    ) -> BoolArray:
        """Which landmarks are to become XYZ after this frame; asked only of models that are not `steady`.

        Parameters
        ----------
        position : (3,)
            Camera, m.
        anchors, parameters : (M, 3), (M, v)
            Landmarks.
        variances : (M, 3)
            Of their own error numbers.
        """
        return np.zeros(len(parameters), dtype=bool)

    # --- what follows from it ---

    @property
    def additive(self) -> bool:
        """Whether the retraction is addition."""
        return type(self).retract is LandmarkModel.retract

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
        J = differences.jacobian(lambda e: self.point(seen.homogeneous + e), self.seen_size)
        return ScaledPoints(self.point(seen.homogeneous), J @ seen.by_position, J @ seen.by_map)


def _turn(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Exp(theta) and its left Jacobian."""
    return rotations.exp(theta), rotations.right_jacobian(-theta)
