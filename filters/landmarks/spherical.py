"""Bearing on the sphere with inverse distance, S^2 x R: inverse depth without a singular direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.landmarks.model import LandmarkModel
from filters.validation import FloatArray

_TURNED_OVER = -0.9
"""Below this z of a bearing its tangent basis is the other one; both are smooth there."""


def tangent_basis(m: FloatArray) -> FloatArray:
    """Two unit vectors perpendicular to each bearing, smooth outside a circle far behind the start; -> (M, 3, 2).

    The rotation by the shortest way from (0, 0, 1), or from (0, 0, -1), to m, applied to x and y (Duff et al.,
    "Building an orthonormal basis, revisited", JCGT 6(1), 2017).
    """
    x, y, z = m.T
    side = np.where(z > _TURNED_OVER, 1.0, -1.0)
    a = -1.0 / (side + z)
    first = [1.0 + side * x * x * a, side * x * y * a, -side * x]
    second = [x * y * a, side + y * y * a, -y]
    return np.stack([np.stack(first, axis=1), np.stack(second, axis=1)], axis=2)


@dataclass(frozen=True)
class Spherical(LandmarkModel):
    """A landmark is a unit vector in W from its anchor, and rho: four numbers.

    Its error is a rotation perpendicular to the bearing, two numbers in `tangent_basis`, and that of rho.
    """

    anchored: ClassVar[bool] = True
    shares_anchors: ClassVar[bool] = True
    value_size: ClassVar[int] = 4

    def parameters_of(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> FloatArray:
        """The unit vector of the direction, and scale / length."""
        m_rho: FloatArray = np.column_stack([h_w, scale]) / np.linalg.norm(h_w, axis=1, keepdims=True)
        return m_rho

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Direction = rho (anchor - r) + m, scale = rho."""
        assert anchors is not None
        m, rho = parameters[:, :3], parameters[:, 3:]
        return np.hstack([rho * (anchors - position) + m, rho])

    def rotated(self, anchors: FloatArray | None, parameters: FloatArray, R: FloatArray) -> FloatArray:
        """The bearing turns, rho stays."""
        return np.hstack([parameters[:, :3] @ R.T, parameters[:, 3:]])

    def retract(self, parameters: FloatArray, delta: FloatArray) -> FloatArray:
        """Exp(B a) m = cos|a| m + sin|a| / |a| (B a) x m, and rho plus its correction."""
        m, angle = parameters[:, :3], np.linalg.norm(delta[..., :2], axis=-1, keepdims=True)
        axis = (tangent_basis(m) @ delta[..., :2, None])[..., 0]
        turned = np.cos(angle) * m + np.sinc(angle / np.pi) * np.cross(axis, m)
        return np.hstack([turned / np.linalg.norm(turned, axis=1, keepdims=True), parameters[:, 3:] + delta[..., 2:]])

    def local(self, parameters: FloatArray, other: FloatArray) -> FloatArray:
        """The rotation vector by the shortest way from bearing to bearing, in the basis of the first."""
        m = parameters[:, :3]
        across = np.cross(m, other[:, :3])
        sine, cosine = np.linalg.norm(across, axis=1), np.einsum("mi,mi->m", m, other[:, :3])
        longer = np.divide(np.arctan2(sine, cosine), sine, out=np.ones(len(m)), where=sine > 0.0)
        turn = longer[:, None] * np.einsum("mij,mi->mj", tangent_basis(m), across)
        return np.hstack([turn, other[:, 3:] - parameters[:, 3:]])

    def first_estimates(self, anchors: FloatArray | None, first: FloatArray, current: FloatArray) -> FloatArray:
        """The first bearing, the current rho, as of inverse depth."""
        return np.hstack([first[:, :3], current[:, 3:]])
