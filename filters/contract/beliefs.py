"""Beliefs of a filter: pose, velocity, landmarks, and the measurements that it predicts."""

from __future__ import annotations

from dataclasses import dataclass

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
