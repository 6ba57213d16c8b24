"""The named filters: each is a choice of parts of the engine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from filters.camera import StereoCamera
from filters.engine.ekf import StereoEKF
from filters.interface import StereoFilter
from filters.landmarks.hybrid import Hybrid
from filters.measurements.rectified_pair import LeftThenRight
from filters.noise import StereoNoise
from filters.submaps.submap_ekf import SubmapEKF


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


class SharedAnchorEKF(StereoEKF):
    """Inverse-depth stereo EKF whose landmarks of one frame share their anchor: same estimates, smaller state."""

    def __init__(
        self, camera: StereoCamera, noise: StereoNoise, *, landmark: str = "shared-anchor", **options: Any
    ) -> None:
        super().__init__(camera, noise, landmark=landmark, **options)


class HybridEKF(StereoEKF):
    """Inverse-depth stereo EKF whose landmarks become XYZ once that is Gaussian enough.

    `linearity_limit` and `near_distance` are those of `Hybrid`.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        linearity_limit: float | None = Hybrid.linearity_limit,
        near_distance: float | None = Hybrid.near_distance,
        **options: Any,
    ) -> None:
        if "landmark" in options:
            raise ValueError(
                f"landmark is hybrid in this filter, got {options['landmark']!r}: use another filter for it"
            )
        super().__init__(camera, noise, landmark=Hybrid(linearity_limit, near_distance), **options)


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


class UnscentedStereoFilter(StereoEKF):
    """Shared-anchor inverse-depth stereo filter with unscented updates on the measured sub-state.

    Source: Li and Aouf, who use sigma points for a stereo rig.
    """

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


class MonocularEKF(StereoEKF):
    """Shared-anchor inverse-depth EKF that updates with the left camera only; disparity starts its landmarks."""

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


PRESETS: Mapping[str, type[StereoFilter]] = {
    "inverse-depth": InverseDepthStereoEKF,
    "dual-bearing": DualBearingEKF,
    "euclidean": EuclideanEKF,
    "shared-anchor": SharedAnchorEKF,
    "hybrid": HybridEKF,
    "right-invariant": RightInvariantEKF,
    "unscented": UnscentedStereoFilter,
    "monocular": MonocularEKF,
    "submaps": SubmapEKF,
}
"""The named filters by name; the first line of a class describes it."""
