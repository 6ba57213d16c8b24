"""A depth camera: the pixel and the depth of a point, (u, v, z)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from filters.measurements.model import MeasurementModel, Values


@dataclass(frozen=True)
class DepthCamera(MeasurementModel):
    """Columns of `uvd` are (u, v, z), px and m, and so is their R. Of the camera the intrinsics are used."""

    def predict(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> FloatArray:
        """The pixel, and z = direction_z / scale."""
        uvz = camera.project_scaled(points_c[..., :3], points_c[..., 3])
        with np.errstate(divide="ignore", invalid="ignore"):
            uvz[..., 2] = points_c[..., 2] / points_c[..., 3]
        return uvz

    def backproject(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> FloatArray:
        """The ray at z = 1, and 1 / z as its scale; no depth <= 0 is that of a point: NaN."""
        scale = np.full((len(uvd), 1), np.nan)
        return np.hstack([camera.ray(uvd), np.divide(1.0, uvd[:, 2:], out=scale, where=uvd[:, 2:] > 0.0)])

    def in_front(self, points_c: FloatArray) -> BoolArray:
        """A finite depth ahead: a point at infinity or beyond has none."""
        ahead: BoolArray = (points_c[:, 2] > 0.0) & (points_c[:, 3] > 0.0)
        return ahead
