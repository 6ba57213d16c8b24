"""The rectified pinhole stereo pair (Eq. 10, 21).

Derivation: docs/derivations/camera.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from filters.geometry.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class StereoCamera:
    """Rectified stereo pair; the left camera is the origin, the right one sits at +x by `baseline`.

    Frame: x right, y down, z forward. Integer (u, v) is the centre of a pixel.

    Parameters
    ----------
    fx, fy : float
        Focal lengths, px.
    cx, cy : float
        Principal point, px.
    baseline : float
        Distance between the eyes, m.
    width, height : int
        Image size, px.

    Raises
    ------
    ValueError
        A focal length, the baseline or the size is not positive, or the principal point is not finite.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    baseline: float
    width: int
    height: int

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "baseline", "width", "height"):
            size = getattr(self, name)
            if not isinstance(size, float | int | np.number) or not np.isfinite(size) or size <= 0:
                raise ValueError(f"camera.{name} must be a finite number > 0, got {size!r}")
        for name in ("cx", "cy"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"camera.{name} must be finite, got {getattr(self, name)!r}")

    @property
    def disparity_constant(self) -> float:
        """The product f b: d = disparity_constant / z; px m."""
        return self.fx * self.baseline

    def project(self, points_c: ArrayLike) -> FloatArray:
        """Pixel and disparity of points, Eq. 10.

        Parameters
        ----------
        points_c : (..., 3) array_like
            Points in the left camera frame, m. A point at z = 0 has no image: inf or NaN is returned.

        Returns
        -------
        (..., 3) ndarray
            (u, v, d) in px, d = u_left - u_right. Points behind the camera get d < 0.
        """
        points = np.asarray(points_c, dtype=np.float64)
        return self.project_scaled(points, np.ones(points.shape[:-1]))

    def project_scaled(self, directions_c: ArrayLike, scales: ArrayLike) -> FloatArray:
        """Project the points `directions_c / scales` without ever forming them.

        This is Eq. 10 in homogeneous coordinates: regular at scale 0 (a point at infinity, d = 0) and below
        (a ray with d < 0), which is what an inverse-depth landmark needs.

        Parameters
        ----------
        directions_c : (..., 3) array_like
            Directions in the left camera frame.
        scales : (...) array_like
            Inverse lengths, so that the point is direction / scale.

        Returns
        -------
        (..., 3) ndarray
            (u, v, d) in px.
        """
        h = np.asarray(directions_c, dtype=np.float64)
        s = np.asarray(scales, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse_z = 1.0 / h[..., 2]
            uvd = np.empty(h.shape)
            uvd[..., 0] = self.fx * h[..., 0] * inverse_z + self.cx
            uvd[..., 1] = self.fy * h[..., 1] * inverse_z + self.cy
            uvd[..., 2] = self.disparity_constant * s * inverse_z
        return uvd

    def backproject(self, uvd: ArrayLike) -> FloatArray:
        """Points seen at (u, v, d), Eq. 21.

        Parameters
        ----------
        uvd : (..., 3) array_like
            px; every d must be > 0.

        Returns
        -------
        (..., 3) ndarray
            Points in the left camera frame, m.

        Raises
        ------
        ValueError
            Some d is not > 0: such a point has no finite position in front of the camera.
        """
        z = np.asarray(uvd, dtype=np.float64)
        if not (z[..., 2] > 0).all():
            raise ValueError("uvd must have d > 0 to be backprojected: drop the others or keep them as rays")
        depth = self.disparity_constant / z[..., 2]
        return self.ray(z) * depth[..., None]

    def ray(self, uvd: ArrayLike) -> FloatArray:
        """Direction of the pixel, scaled to z = 1; (..., 2 or 3) px -> (..., 3)."""
        z = np.asarray(uvd, dtype=np.float64)
        ray = np.ones((*z.shape[:-1], 3))
        ray[..., 0] = (z[..., 0] - self.cx) / self.fx
        ray[..., 1] = (z[..., 1] - self.cy) / self.fy
        return ray

    def project_jacobian(self, points_c: ArrayLike) -> FloatArray:
        """d(u, v, d) / d(point); (..., 3) m -> (..., 3, 3) px/m."""
        points = np.asarray(points_c, dtype=np.float64)
        return self.project_scaled_jacobian(points, np.ones(points.shape[:-1]))[..., :3]

    def project_scaled_jacobian(self, directions_c: ArrayLike, scales: ArrayLike) -> FloatArray:
        """d(u, v, d) / d(direction, scale); (..., 3), (...) -> (..., 3, 4)."""
        h = np.asarray(directions_c, dtype=np.float64)
        s = np.asarray(scales, dtype=np.float64)
        jacobian = np.zeros((*h.shape[:-1], 3, 4))
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse_z = 1.0 / h[..., 2]
            jacobian[..., 0, 0] = self.fx * inverse_z
            jacobian[..., 0, 2] = -self.fx * h[..., 0] * inverse_z**2
            jacobian[..., 1, 1] = self.fy * inverse_z
            jacobian[..., 1, 2] = -self.fy * h[..., 1] * inverse_z**2
            jacobian[..., 2, 2] = -self.disparity_constant * s * inverse_z**2
            jacobian[..., 2, 3] = self.disparity_constant * inverse_z
        return jacobian

    def in_view(self, uvd: ArrayLike, margin: float = 0.0) -> BoolArray:
        """Whether the pixel lies at least `margin` px inside both images; (..., 3) px -> (...)."""
        z = np.asarray(uvd, dtype=np.float64)
        u, v, u_right = z[..., 0], z[..., 1], z[..., 0] - z[..., 2]
        low, high_u, high_v = margin, self.width - 1 - margin, self.height - 1 - margin
        inside: BoolArray = (
            (u >= low) & (u <= high_u) & (u_right >= low) & (u_right <= high_u) & (v >= low) & (v <= high_v)
        )
        return inside
