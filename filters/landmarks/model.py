"""Base class of landmark parametrisations.

Every landmark is one block of three error numbers in the state, plus, where it is anchored, one block for the anchor
position. Its value is `value_size` numbers, three or more, and a correction of three numbers retracts it. A part gives
three functions: how a landmark starts, where it is seen from a camera, and how it turns with the world. The others have
numerical Jacobians by default. All functions take many landmarks at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.geometry import differences, rotations
from filters.validation import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class StartedLandmarks:
    """Values of M new landmarks (Eq. 19) and the Jacobians of their three error numbers (Eq. 25).

    Attributes
    ----------
    parameters : (M, v)
        Without the anchor, which is the camera position itself.
    by_position, by_direction : (M, 3, 3)
        With respect to r^WC, and to the direction in W.
    by_scale : (M, 3)
        With respect to the scale.
    anchored : (M,) bool
        Whether the landmark has an anchor.
    """

    parameters: FloatArray
    by_position: FloatArray
    by_direction: FloatArray
    by_scale: FloatArray
    anchored: BoolArray


@dataclass(frozen=True, eq=False)
class ScaledPoints:
    """M landmarks relative to the camera centre, in homogeneous form: point - r^WC = direction / scale.

    Attributes
    ----------
    homogeneous : (M, 4)
        Direction in W (3), and scale.
    by_position : (M, 4, 3)
        Jacobian by the camera position.
    by_map : (M, 4, w)
        Jacobian by the landmark's own error numbers: anchor (where the model has anchors), then its three.
    """

    homogeneous: FloatArray
    by_position: FloatArray
    by_map: FloatArray


@dataclass(frozen=True, eq=False)
class Points:
    """M landmark positions (M, 3) in W, m, and their Jacobian (M, 3, w) by anchor (if any) and own error numbers."""

    positions: FloatArray
    by_map: FloatArray


@dataclass(frozen=True, eq=False)
class InverseDistances:
    """Inverse distances (M,), 1/m, and their Jacobians by the camera position and by the own error numbers (M, 3)."""

    values: FloatArray
    by_position: FloatArray
    by_parameters: FloatArray


class LandmarkModel:
    """Parametrisation of landmarks: its start, its place relative to a camera, its retraction, and their Jacobians.

    Everywhere below, `parameters` are (M, v) and `anchors` (M, 3), or None where the model has none; a row of NaN
    stands for a landmark without one. The camera position is one for all landmarks, (3,), or one for each, (M, 3).

    Attributes
    ----------
    anchored : bool
        Whether landmarks have an anchor block in the state (with `Hybrid` some have none).
    shares_anchors : bool
        Whether landmarks that enter the map in one frame share one anchor block.
    value_size : int
        Numbers of a landmark's value, at least 3.
    steady : bool
        Whether a frame in which no landmark comes or goes leaves the map's structure as it is.
    submaps : bool
        Whether `SubmapEKF` can keep such landmarks: their retraction is addition.
    kernel : str or None
        Compiled counterpart. It holds for the class that states it, not for its subclasses.

    References
    ----------
    Civera, Davison and Montiel, "Inverse depth parametrization for monocular SLAM", IEEE TRO 24(5), 2008.
    Sola, Vidal-Calleja, Civera and Montiel, "Impact of landmark parametrization on monocular EKF-SLAM with points and
    lines", IJCV 97(3), 2012.
    Huang, Mourikis and Roumeliotis, "Observability-based rules for designing consistent EKF SLAM estimators", IJRR
    29(5), 2010 (`first_estimates`).
    """

    anchored: ClassVar[bool] = False
    shares_anchors: ClassVar[bool] = False
    value_size: ClassVar[int] = 3
    steady: ClassVar[bool] = True
    submaps: ClassVar[bool] = False
    kernel: ClassVar[str | None] = None

    # --- what a part gives ---

    def parameters_of(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> FloatArray:
        """Values of landmarks at position + h_w / scale, directions (M, 3) in W and scales (M,); (M, v)."""
        raise NotImplementedError(f"{type(self).__name__} must have parameters_of: see LandmarkModel")

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Landmarks as seen from the camera position: direction in W, and scale; (M, 4)."""
        raise NotImplementedError(f"{type(self).__name__} must have homogeneous: see LandmarkModel")

    def rotated(self, anchors: FloatArray | None, parameters: FloatArray, R: FloatArray) -> FloatArray:
        """Values in a world rotated about its origin, without the anchors; R (3, 3) -> (M, v)."""
        raise NotImplementedError(f"{type(self).__name__} must have rotated: see LandmarkModel")

    # --- what it may give instead of the default ---

    def can_start(self, h_w: FloatArray, scale: FloatArray) -> BoolArray:
        """Which directions (M, 3) in W and scales (M,) a landmark can start from; (M,)."""
        return np.ones(len(h_w), dtype=bool)

    def started(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> StartedLandmarks:
        """`parameters_of` with its Jacobians."""
        parameters = self.parameters_of(position, h_w, scale)

        def moved(delta: FloatArray) -> FloatArray:
            return self.local(parameters, self.parameters_of(position + delta[:3], h_w + delta[3:6], scale + delta[6]))

        J = differences.jacobian(moved, 7)
        anchored = np.full(len(h_w), self.anchored)
        return StartedLandmarks(parameters, J[:, :, :3], J[:, :, 3:6], J[:, :, 6], anchored)

    def retract(self, parameters: FloatArray, delta: FloatArray) -> FloatArray:
        """Values corrected by (M, 3); the default adds."""
        return parameters + delta

    def local(self, parameters: FloatArray, other: FloatArray) -> FloatArray:
        """The correction (M, 3) that takes `parameters` to `other`."""
        return other - parameters

    def transport(self, parameters: FloatArray, delta: FloatArray) -> FloatArray | None:
        """d local(retract(x, delta), retract(x, delta + e)) / d e, (M, 3, 3); None: the identity, as of addition."""
        if self.additive:
            return None
        there = self.retract(parameters, delta)
        return differences.jacobian(lambda e: self.local(there, self.retract(parameters, delta + e)), 3)

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """`homogeneous` with its Jacobians."""

        def moved(delta: FloatArray) -> FloatArray:
            own = self.retract(parameters, np.broadcast_to(delta[6:], (len(parameters), 3)))
            return self.homogeneous(position + delta[:3], None if anchors is None else anchors + delta[3:6], own)

        J = differences.jacobian(moved, 9)
        by_map = J[:, :, 6:] if anchors is None else J[:, :, 3:]
        return ScaledPoints(self.homogeneous(position, anchors, parameters), J[:, :, :3], by_map)

    def world_rotation(self, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """d own error numbers / d (rotation vector of the world about its origin); (M, 3, 3)."""
        return differences.jacobian(
            lambda e: self.local(parameters, self.rotated(anchors, parameters, rotations.exp(e))), 3
        )

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
        """Jacobians of `turned` by the correction and by theta (3,), (M, 3, 3) each."""
        there = self.turned(anchors, parameters, *_turn(theta), correction)

        def moved(delta: FloatArray) -> FloatArray:
            other = self.turned(anchors, parameters, *_turn(theta + delta[3:]), correction + delta[:3])
            return self.local(there, other)

        J = differences.jacobian(moved, 6)
        return J[:, :, :3], J[:, :, 3:]

    def first_estimates(self, anchors: FloatArray | None, first: FloatArray, current: FloatArray) -> FloatArray:
        """Values at which first-estimates Jacobians are taken; (M, v), (M, v) -> (M, v)."""
        return first

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
        seen = self.relative_to(np.zeros(3), anchors, parameters)
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
        seen = self.relative_to(origin, anchors, parameters)
        direction, scale = seen.homogeneous[:, :3], seen.homogeneous[:, 3]
        inverse = 1.0 / np.linalg.norm(direction, axis=1)
        by_seen = np.concatenate([-(scale * inverse**3)[:, None] * direction, inverse[:, None]], axis=1)[:, None]
        by_position = (by_seen @ seen.by_position)[:, 0] * free[:, None]
        return InverseDistances(scale * inverse, by_position, (by_seen @ seen.by_map[:, :, -3:])[:, 0])


def _turn(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Exp(theta) and its left Jacobian."""
    return rotations.exp(theta), rotations.right_jacobian(-theta)
