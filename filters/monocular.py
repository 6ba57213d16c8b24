"""What the right eye is worth: disparity starts a landmark, afterwards only the left pixel is used."""

from __future__ import annotations

from typing import Any

from filters.camera import StereoCamera
from filters.engine.ekf import StereoEKF
from filters.noise import StereoNoise


class MonocularEKF(StereoEKF):
    """Shared-anchor inverse-depth EKF that updates with the left eye only."""

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        landmark: str = "shared-anchor",
        measurement: str = "left",
        **options: Any,
    ) -> None:
        super().__init__(camera, noise, landmark=landmark, measurement=measurement, **options)
