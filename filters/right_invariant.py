"""Inverse depth with right-invariant errors: consistent when the orientation is very uncertain."""

from __future__ import annotations

from typing import Any

from filters.camera import StereoCamera
from filters.engine.ekf import StereoEKF
from filters.noise import StereoNoise


class RightInvariantEKF(StereoEKF):
    """Shared-anchor inverse-depth stereo EKF with right-invariant errors."""

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        landmark: str = "shared-anchor",
        error: str = "right-invariant",
        **options: Any,
    ) -> None:
        super().__init__(camera, noise, landmark=landmark, error=error, **options)
