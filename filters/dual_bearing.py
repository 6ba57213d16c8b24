"""The paper's rival: the two eyes as two bearing-only observers, one update after the other."""

from __future__ import annotations

from typing import Any

from filters.camera import StereoCamera
from filters.engine.ekf import StereoEKF
from filters.noise import StereoNoise


class DualBearingEKF(StereoEKF):
    """Inverse-depth EKF that updates with the left, then the right bearing.

    Landmarks are stored with shared anchors, as in `InverseDepthStereoEKF`.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        landmark: str = "shared-anchor",
        measurement: str = "sequential",
        **options: Any,
    ) -> None:
        super().__init__(camera, noise, landmark=landmark, measurement=measurement, **options)
