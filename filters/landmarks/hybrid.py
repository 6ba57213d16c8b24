"""Hybrid: inverse depth while a landmark needs it, Euclidean XYZ once its position is practically Gaussian.

Two ways to tell, both on offer: Civera's linearity index (Civera, Davison and Montiel 2008) while the landmark is
being tracked, and a distance at first sight up to which it starts as XYZ (Paz et al. 2008). At first sight by a stereo
pair the index is 4 sigma_d / d, so the two are one question asked at different times.

Derivation: docs/derivations/euclidean.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from filters.contract.validation import positive
from filters.geometry.arrays import BoolArray, FloatArray
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.inverse_depth import InverseDepth, ray_of
from filters.landmarks.landmark_model import Numbers, ScaledPoints, StartedLandmarks

_INVERSE_DEPTH, _EUCLIDEAN = InverseDepth(), Euclidean()


@dataclass(frozen=True)
class Hybrid(InverseDepth):
    """Inverse depth with shared anchors, or XYZ; a landmark whose anchor is NaN is XYZ.

    Parameters
    ----------
    linearity_limit : float or None
        A landmark becomes XYZ as soon as its linearity index is below this; None: never. The default keeps the pose
        consistent on the reference drive, Civera's 0.1 does not (docs/verification.md).
    near_distance : float or None
        A landmark first seen at most this far away, m, starts as XYZ; None: none does.
    """

    linearity_limit: float | None = 0.03
    near_distance: float | None = None
    shares_anchors: ClassVar[bool] = True
    submaps: ClassVar[bool] = False
    steady: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for name in ("linearity_limit", "near_distance"):
            if getattr(self, name) is not None:
                positive(name, getattr(self, name))

    @property
    def in_machine_code(self) -> bool:  # type: ignore[override]
        """Whether all landmarks start with inverse depth: then the plain functions are all that there is to do."""
        return self.near_distance is None

    def becomes_point(self, to_anchor: Numbers, y: Numbers, variances: Numbers) -> Any:
        """Whether Civera's linearity index L_d = 4 sigma_depth |cos alpha| / d_1 is below the limit.

        sigma_depth = sigma_rho / rho^2 is along the first ray, d_1 the distance from here, alpha the angle between the
        two rays (the parallax). Never where rho <= 0.
        """
        m, rho = ray_of(y[0], y[1]), y[2]
        x, y_, z = rho * to_anchor[0] + m[0], rho * to_anchor[1] + m[1], rho * to_anchor[2] + m[2]
        across, squared = np.abs(x * m[0] + y_ * m[1] + z * m[2]), x * x + y_ * y_ + z * z
        sigma = np.sqrt(np.maximum(variances[2], 0.0))
        limit = 0.0 if self.linearity_limit is None else self.linearity_limit
        return (rho > 0.0) & (4.0 * sigma * across < limit * rho * squared)

    def started(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> StartedLandmarks:
        """Near ones as XYZ, the others with inverse depth."""
        near = np.zeros(len(scale), dtype=bool)
        if self.near_distance is not None:
            near = scale * self.near_distance >= np.linalg.norm(h_w, axis=1)
        new = _INVERSE_DEPTH.started(position, h_w, scale)
        if near.any():
            points = _EUCLIDEAN.started(position, h_w[near], scale[near])
            for name in vars(new):
                getattr(new, name)[near] = getattr(points, name)
        return new

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Landmarks as seen from the camera position: direction in W, and scale; (M, 4)."""
        seen = _INVERSE_DEPTH.homogeneous(position, anchors, parameters)
        xyz = self.are_points(anchors)
        if xyz.any():
            position = np.broadcast_to(position, parameters.shape)[xyz]
            seen[xyz] = _EUCLIDEAN.homogeneous(position, None, parameters[xyz])
        return seen

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """`homogeneous` with its Jacobians; that by a missing anchor is zero."""
        seen = _INVERSE_DEPTH.relative_to(position, anchors, parameters)
        xyz = self.are_points(anchors)
        if not xyz.any():
            return seen
        position = np.broadcast_to(position, parameters.shape)[xyz]
        points = _EUCLIDEAN.relative_to(position, None, parameters[xyz])
        by_position = seen.by_position.copy()
        seen.homogeneous[xyz], by_position[xyz] = points.homogeneous, points.by_position
        seen.by_map[xyz, :, :3], seen.by_map[xyz, :, 3:] = 0.0, points.by_map
        return ScaledPoints(seen.homogeneous, by_position, seen.by_map)

    def rotated(self, anchors: FloatArray | None, parameters: FloatArray, R: FloatArray) -> FloatArray:
        """The ray or the point turns."""
        moved, xyz = _INVERSE_DEPTH.rotated(anchors, parameters, R), self.are_points(anchors)
        moved[xyz] = _EUCLIDEAN.rotated(None, parameters[xyz], R)
        return moved

    def world_rotation(self, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """The ray or the point turns."""
        effect, xyz = _INVERSE_DEPTH.world_rotation(anchors, parameters), self.are_points(anchors)
        effect[xyz] = _EUCLIDEAN.world_rotation(None, parameters[xyz])
        return effect

    def world_translation(self, parameters: FloatArray) -> FloatArray:
        """Of points."""
        return _EUCLIDEAN.world_translation(parameters)

    def turned(
        self, anchors: FloatArray | None, parameters: FloatArray, theta: FloatArray, correction: FloatArray
    ) -> FloatArray:
        """As that of the parametrisation each landmark has."""
        moved, xyz = _INVERSE_DEPTH.turned(anchors, parameters, theta, correction), self.are_points(anchors)
        moved[xyz] = _EUCLIDEAN.turned(None, parameters[xyz], theta, correction[xyz])
        return moved

    def turned_jacobians(
        self, anchors: FloatArray | None, parameters: FloatArray, theta: FloatArray, correction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """As those of the parametrisation each landmark has."""
        both, xyz = _INVERSE_DEPTH.turned_jacobians(anchors, parameters, theta, correction), self.are_points(anchors)
        of_points = _EUCLIDEAN.turned_jacobians(None, parameters[xyz], theta, correction[xyz])
        for J, here in zip(both, of_points, strict=True):
            J[xyz] = here
        return both

    def first_estimates(self, anchors: FloatArray | None, first: FloatArray, current: FloatArray) -> FloatArray:
        """The first point, or the first angles with the current rho."""
        estimates, xyz = _INVERSE_DEPTH.first_estimates(anchors, first, current), self.are_points(anchors)
        estimates[xyz] = first[xyz]
        return estimates

    def are_points(self, anchors: FloatArray | None) -> BoolArray:
        """Which landmarks are XYZ: those without an anchor; (M, 3) -> (M,)."""
        assert anchors is not None
        missing: BoolArray = np.isnan(anchors[:, 0])
        return missing

    def become_points(
        self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray, variances: FloatArray
    ) -> BoolArray:
        """Those with inverse depth whose linearity index is below the limit."""
        return super().become_points(position, anchors, parameters, variances) & ~self.are_points(anchors)
