"""The classic: landmarks as points XYZ, range and bearing in one update."""

from __future__ import annotations

from typing import Any

from filters.camera import StereoCamera
from filters.engine.ekf import StereoEKF
from filters.noise import StereoNoise


class EuclideanEKF(StereoEKF):
    """Euclidean XYZ stereo EKF with joint (u, v, d) updates.

    Without `min_disparity` it starts landmarks from any d > 0, as the textbook does, and diverges on far points;
    5 px is a usual guard, at the price of throwing far points away.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        landmark: str = "euclidean",
        measurement: str = "joint",
        **options: Any,
    ) -> None:
        super().__init__(camera, noise, landmark=landmark, measurement=measurement, **options)
