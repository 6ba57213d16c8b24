"""Hybrid: inverse depth while a landmark needs it, Euclidean XYZ once its position is practically Gaussian.

Two ways to tell, both on offer: Civera's linearity index (Civera, Davison and Montiel 2008) while the landmark is
being tracked, and a distance at first sight up to which it starts as XYZ (Paz et al. 2008). At first sight by a stereo
pair the index is 4 sigma_d / d, so the two are one question asked at different times.

Derivation: docs/derivations/euclidean.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from filters.contract.validation import positive
from filters.geometry.arrays import BoolArray, FloatArray
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.inverse_depth import KERNELS, InverseDepth, ray, ray_direction
from filters.landmarks.landmark_model import LandmarkKernels, LandmarkModel, ScaledPoints, StartedLandmarks

_INVERSE_DEPTH, _EUCLIDEAN = InverseDepth(), Euclidean()


def linearity_index(
    position: FloatArray, anchors: FloatArray, parameters: FloatArray, rho_sigma: FloatArray
) -> FloatArray:
    """Civera's L_d = 4 sigma_depth |cos alpha| / d_1 of inverse-depth landmarks: how far from Gaussian XYZ would be.

    Parameters
    ----------
    position : (3,)
        Camera, m.
    anchors, parameters : (M, 3)
        Inverse-depth landmarks.
    rho_sigma : (M,)
        Standard deviation of rho, 1/m.

    Returns
    -------
    (M,) ndarray
        sigma_depth = sigma_rho / rho^2 is along the first ray, d_1 the distance from here, alpha the angle between the
        two rays (the parallax). Infinite where rho <= 0.
    """
    rho = parameters[:, 2]
    ray = ray_direction(parameters)
    # rho times the way from here to the landmark: finite for every rho.
    scaled = rho[:, None] * (anchors - position) + ray
    squared = np.einsum("mi,mi->m", scaled, scaled)
    with np.errstate(divide="ignore", invalid="ignore"):
        index: FloatArray = 4.0 * rho_sigma * np.abs(np.einsum("mi,mi->m", scaled, ray)) / (rho * squared)
    return np.where(rho > 0.0, index, np.inf)


def _become(
    settings: FloatArray, to_anchor: FloatArray, values: FloatArray, variances: FloatArray, becomes: BoolArray
) -> None:
    """Whether Civera's index is below the limit, the first setting."""
    for i in range(len(values)):
        rho, (x, y, z) = values[i, 2], ray(values[i, 0], values[i, 1])
        sx, sy, sz = rho * to_anchor[i, 0] + x, rho * to_anchor[i, 1] + y, rho * to_anchor[i, 2] + z
        across, squared = abs(sx * x + sy * y + sz * z), sx * sx + sy * sy + sz * sz
        sigma = math.sqrt(max(variances[i, 2], 0.0))
        becomes[i] = rho > 0.0 and 4.0 * sigma * across < settings[0] * rho * squared


@dataclass(frozen=True)
class Hybrid(LandmarkModel):
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
    anchored: ClassVar[bool] = True
    shares_anchors: ClassVar[bool] = True
    steady: ClassVar[bool] = False
    follows: ClassVar[tuple[int, ...]] = InverseDepth.follows

    def __post_init__(self) -> None:
        for name in ("linearity_limit", "near_distance"):
            if getattr(self, name) is not None:
                positive(name, getattr(self, name))

    @property
    def kernels(self) -> LandmarkKernels | None:  # type: ignore[override]
        """Those of inverse depth, and when that ends. None with a `near_distance`."""
        return None if self.near_distance is not None else replace(KERNELS, become=_become, settings=("limit",))

    @property
    def limit(self) -> float:
        """`linearity_limit`, 0 for none."""
        return self.linearity_limit or 0.0

    def can_start(self, h_w: FloatArray, scale: FloatArray) -> BoolArray:
        """As inverse depth."""
        return _INVERSE_DEPTH.can_start(h_w, scale)

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
        self,
        anchors: FloatArray | None,
        parameters: FloatArray,
        turn: FloatArray,
        spread: FloatArray,
        correction: FloatArray,
    ) -> FloatArray:
        """As that of the parametrisation each landmark has."""
        moved, xyz = _INVERSE_DEPTH.turned(anchors, parameters, turn, spread, correction), self.are_points(anchors)
        moved[xyz] = _EUCLIDEAN.turned(None, parameters[xyz], turn, spread, correction[xyz])
        return moved

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
        """Those whose linearity index is below the limit."""
        if self.linearity_limit is None:
            return np.zeros(len(parameters), dtype=bool)
        assert anchors is not None
        sigma = np.sqrt(np.maximum(variances[:, 2], 0.0))
        linear = linearity_index(position, anchors, parameters, sigma) < self.linearity_limit
        return linear & ~self.are_points(anchors)
