"""Inverse depth where it is needed, XYZ where that is enough."""

from __future__ import annotations

from typing import Any

from filters.camera import StereoCamera
from filters.engine.ekf import StereoEKF
from filters.landmarks.hybrid import Hybrid
from filters.noise import StereoNoise


class HybridEKF(StereoEKF):
    """Inverse-depth stereo EKF whose landmarks become XYZ once that is Gaussian enough.

    `linearity_limit` and `near_disparity` are those of `Hybrid`.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        linearity_limit: float | None = Hybrid.linearity_limit,
        near_disparity: float | None = Hybrid.near_disparity,
        **options: Any,
    ) -> None:
        if "landmark" in options:
            raise ValueError(
                f"landmark is hybrid in this filter, got {options['landmark']!r}: use another filter for it"
            )
        super().__init__(camera, noise, landmark=Hybrid(linearity_limit, near_disparity), **options)
