"""The paper's filter: inverse depth, range and bearing in one update."""

from __future__ import annotations

from typing import Any

from filters.camera import StereoCamera
from filters.engine.ekf import StereoEKF
from filters.noise import StereoNoise


class InverseDepthStereoEKF(StereoEKF):
    """Inverse-depth stereo EKF with joint (u, v, d) updates (the paper's).

    Landmarks are stored with shared anchors, which gives the paper's estimates in half the numbers;
    `landmark="inverse-depth"` stores the paper's six each.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        landmark: str = "shared-anchor",
        measurement: str = "joint",
        **options: Any,
    ) -> None:
        super().__init__(camera, noise, landmark=landmark, measurement=measurement, **options)
