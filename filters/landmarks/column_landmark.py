"""Base class of landmarks that are no points, such as lines, given by functions of many of them at once."""

from __future__ import annotations

import numpy as np

from filters.geometry import derivatives, rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.landmarks.landmark_model import LandmarkModel, ScaledPoints, StartedLandmarks


class ColumnLandmark(LandmarkModel):
    """Parametrisation given by `parameters_of`, `homogeneous` and `rotated`, on columns; Jacobians are differences.

    For landmarks that are seen by more vectors than the direction of a point (`seen_vectors`), or are of several kinds.
    """

    in_machine_code: bool = False

    def can_start(self, h_w: FloatArray, scale: FloatArray) -> BoolArray:
        """Which vectors (M, 3 each) in W and other numbers a landmark can start from; (M,)."""
        return np.ones(len(h_w), dtype=bool)

    def parameters_of(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> FloatArray:
        """Values of landmarks whose vectors (M, 3 each) in W and other numbers, (M,) or (M, k), are these; (M, v)."""
        raise NotImplementedError(f"{type(self).__name__} must have parameters_of: see ColumnLandmark")

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Landmarks as seen from the camera position: their vectors in W, and other numbers; (M, seen_size)."""
        raise NotImplementedError(f"{type(self).__name__} must have homogeneous: see ColumnLandmark")

    def rotated(self, anchors: FloatArray | None, parameters: FloatArray, R: FloatArray) -> FloatArray:
        """Values in a world rotated about its origin, without the anchors; R (3, 3) -> (M, v)."""
        if self.in_anchor:
            return parameters
        raise NotImplementedError(f"{type(self).__name__} must have rotated: see ColumnLandmark")

    def started(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> StartedLandmarks:
        """`parameters_of` with its Jacobians."""
        parameters, leading = self.parameters_of(position, h_w, scale), 3 + h_w.shape[1]

        def moved(delta: FloatArray) -> FloatArray:
            by_rest = delta[leading] if scale.ndim == 1 else delta[leading:]
            other = self.parameters_of(position + delta[:3], h_w + delta[3:leading], scale + by_rest)
            return self.local(parameters, other)

        J = derivatives.jacobian(moved, 3 + self.seen_size)
        by_scale = J[:, :, leading] if scale.ndim == 1 else J[:, :, leading:]
        anchored = np.full(len(h_w), self.anchored)
        return StartedLandmarks(parameters, J[:, :, :3], J[:, :, 3:leading], by_scale, anchored)

    def transport(self, parameters: FloatArray, delta: FloatArray) -> FloatArray | None:
        """d local(retract(x, delta), retract(x, delta + e)) / d e, (M, size, size); None: the identity, of addition."""
        if self.additive:
            return None
        there = self.retract(parameters, delta)
        return derivatives.jacobian(lambda e: self.local(there, self.retract(parameters, delta + e)), self.size)

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """`homogeneous` with its Jacobians."""

        def moved(delta: FloatArray) -> FloatArray:
            own = self.retract(parameters, np.broadcast_to(delta[6:], (len(parameters), self.size)))
            return self.homogeneous(position + delta[:3], None if anchors is None else anchors + delta[3:6], own)

        J = derivatives.jacobian(moved, 6 + self.size)
        by_map = J[:, :, 6:] if anchors is None else J[:, :, 3:]
        return ScaledPoints(self.homogeneous(position, anchors, parameters), J[:, :, :3], by_map)

    def world_rotation(self, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """d own error numbers / d (rotation vector of the world about its origin); (M, size, 3)."""
        return derivatives.jacobian(
            lambda e: self.local(parameters, self.rotated(anchors, parameters, rotations.exp(e))), 3
        )

    def turned(
        self, anchors: FloatArray | None, parameters: FloatArray, theta: FloatArray, correction: FloatArray
    ) -> FloatArray:
        """Values corrected, then turned with the world by Exp(theta)."""
        return self.rotated(anchors, self.retract(parameters, correction), rotations.exp(theta))

    def turned_jacobians(
        self, anchors: FloatArray | None, parameters: FloatArray, theta: FloatArray, correction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Jacobians of `turned` by the correction and by theta (3,), (M, size, size) and (M, size, 3)."""
        there = self.turned(anchors, parameters, theta, correction)

        def moved(delta: FloatArray) -> FloatArray:
            other = self.turned(anchors, parameters, theta + delta[:3], correction + delta[3:])
            return self.local(there, other)

        J = derivatives.jacobian(moved, 3 + self.size)
        return J[:, :, 3:], J[:, :, :3]
