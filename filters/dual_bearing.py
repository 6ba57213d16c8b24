"""The paper's rival: the two eyes as two bearing-only observers, one update after the other."""

from __future__ import annotations

from typing import Any

from filters.camera import StereoCamera
from filters.engine.ekf import StereoEKF
from filters.measurements.bearing import LeftThenRight
from filters.noise import StereoNoise


class DualBearingEKF(StereoEKF):
    """Inverse-depth EKF that updates with the left, then the right bearing.

    `copied_row_variance` is that of `LeftThenRight`: how to take the left row for a right one that is not measured.
    Landmarks are stored with shared anchors, as in `InverseDepthStereoEKF`.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        landmark: str = "shared-anchor",
        copied_row_variance: float | None = None,
        **options: Any,
    ) -> None:
        options.setdefault("measurement", LeftThenRight(copied_row_variance))
        super().__init__(camera, noise, landmark=landmark, **options)
