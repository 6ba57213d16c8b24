"""Outputs of a filter: beliefs, predicted measurements, and the outcome of an update."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class PoseBelief:
    """Pose of the left camera."""

    position: FloatArray
    """(3,): r^WC, m, in W."""
    orientation: FloatArray
    """(4,): q^WC, unit quaternion xyzw."""
    covariance: FloatArray
    """(6, 6), of e = [p_true - p_est in W (m) ; Log(R_est^T R_true) in the camera frame (rad)]."""


@dataclass(frozen=True, eq=False)
class VelocityBelief:
    """Velocity of the left camera."""

    linear: FloatArray
    """(3,), m/s, in W."""
    angular: FloatArray
    """(3,), rad/s, camera frame."""
    covariance: FloatArray
    """(6, 6), of (linear, angular)."""


@dataclass(frozen=True, eq=False)
class LandmarkBelief:
    """The map."""

    ids: IntArray
    """(N,): landmarks in the map."""
    positions: FloatArray
    """(N, 3), m, in W. A landmark at infinity or beyond (inverse distance <= 0) has no finite position: inf or NaN."""
    covariances: FloatArray
    """(N, 3, 3): first-order covariance of the positions, m^2."""
    inverse_distance: FloatArray
    """(N,), 1/m, along the ray from the landmark's anchor (the camera position it was first seen from); for
    parametrisations without an anchor, from the current camera position."""
    inverse_distance_variance: FloatArray
    """(N,), 1/m^2."""


@dataclass(frozen=True, eq=False)
class Forecast:
    """Predicted measurements of landmarks in the current frame, for active search, gating and planning."""

    ids: IntArray
    """(N,): landmarks."""
    uvd: FloatArray
    """(N, 3): predicted left pixel and disparity, px."""
    S: FloatArray
    """(N, 3, 3): innovation covariance H P H^T + R of each (Eq. 15), px^2."""
    in_view: BoolArray
    """(N,): in front of the camera and inside both images."""


_NO_IDS: IntArray = np.zeros(0, dtype=np.int64)
_NO_IDS.flags.writeable = False


def _no_ids() -> IntArray:
    return _NO_IDS


@dataclass(frozen=True, eq=False)
class UpdateReport:
    """Outcome of each measurement in one `update`, or of earlier ones where updates are delayed."""

    updated: IntArray = field(default_factory=_no_ids)
    """(K,): ids that corrected the state."""
    initialised: IntArray = field(default_factory=_no_ids)
    """(K,): ids that entered the map."""
    dropped: IntArray = field(default_factory=_no_ids)
    """(K,): ids that left the map."""
    gated: IntArray = field(default_factory=_no_ids)
    """(K,): known ids whose measurement failed the chi-square gate (Mahalanobis distance too large), in the first or in
    a later stage of the update; the stages before it have used the measurement."""
    rejected: IntArray = field(default_factory=_no_ids)
    """(K,): new ids the filter could not initialise from (for XYZ: d <= 0 or below `min_disparity`)."""
    behind_camera: IntArray = field(default_factory=_no_ids)
    """(K,): known ids predicted behind the camera, so not used."""
    failed: IntArray = field(default_factory=_no_ids)
    """(K,): known ids whose innovation covariance had no Cholesky factor, or is so large that R is lost in its rounding
    (a landmark as good as in the image plane), so not used (or not in every stage)."""
    nis: float = 0.0
    """Normalised innovation squared over the accepted measurements, chi-square with `nis_dof` if consistent."""
    nis_dof: int = 0
    """Degrees of freedom of `nis`."""

    @property
    def failed_factorisations(self) -> int:
        """Number of `failed` measurements."""
        return len(self.failed)


@dataclass(frozen=True)
class Correction:
    """Outcome of a correction by a linearised measurement."""

    used: bool
    """Whether the state was corrected: the measurement passed the gate and its innovation covariance has a Cholesky
    factor."""
    nis: float
    """Normalised innovation squared, chi-square with `nis_dof` if consistent; -1 without a Cholesky factor."""
    nis_dof: int
    """Degrees of freedom of `nis`."""
