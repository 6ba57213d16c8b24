"""Inverse depth with sigma points instead of Jacobians (as Li and Aouf did for a stereo rig)."""

from __future__ import annotations

from typing import Any

from filters.camera import StereoCamera
from filters.engine.ekf import StereoEKF
from filters.noise import StereoNoise


class UnscentedStereoFilter(StereoEKF):
    """Shared-anchor inverse-depth stereo filter with unscented updates on the measured sub-state."""

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        landmark: str = "shared-anchor",
        update: str = "unscented",
        **options: Any,
    ) -> None:
        super().__init__(camera, noise, landmark=landmark, update=update, **options)
