"""The paper's filter in fewer numbers: landmarks of one frame share their anchor."""

from __future__ import annotations

from typing import Any

from filters.camera import StereoCamera
from filters.engine.ekf import StereoEKF
from filters.noise import StereoNoise


class SharedAnchorEKF(StereoEKF):
    """Inverse-depth stereo EKF whose landmarks of one frame share their anchor: same estimates, smaller state."""

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        landmark: str = "shared-anchor",
        **options: Any,
    ) -> None:
        super().__init__(camera, noise, landmark=landmark, **options)
