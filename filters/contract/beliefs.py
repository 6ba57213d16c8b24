"""Beliefs of a filter: pose, velocity, landmarks, and the measurements that it predicts."""

from __future__ import annotations

from dataclasses import dataclass

from filters.validation import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class PoseBelief:
    """Pose of the left camera.

    Attributes
    ----------
    position : (3,)
        r^WC, m, in W.
    orientation : (4,)
        q^WC, unit quaternion xyzw.
    covariance : (6, 6)
        Of e = [p_true - p_est in W (m) ; Log(R_est^T R_true) in the camera frame (rad)].
    """

    position: FloatArray
    orientation: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class VelocityBelief:
    """Velocity of the left camera.

    Attributes
    ----------
    linear : (3,)
        m/s, in W.
    angular : (3,)
        rad/s, camera frame.
    covariance : (6, 6)
        Of (linear, angular).
    """

    linear: FloatArray
    angular: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class LandmarkBelief:
    """The map.

    Attributes
    ----------
    ids : (N,) int64
        Landmarks in the map.
    positions : (N, 3)
        m, in W. A landmark at infinity or beyond (inverse distance <= 0) has no finite position: inf or NaN.
    covariances : (N, 3, 3)
        First-order covariance of the positions, m^2.
    inverse_distance : (N,)
        1/m, along the ray from the landmark's anchor (the camera position it was first seen from);
        for parametrisations without an anchor, from the current camera position.
    inverse_distance_variance : (N,)
        1/m^2.
    """

    ids: IntArray
    positions: FloatArray
    covariances: FloatArray
    inverse_distance: FloatArray
    inverse_distance_variance: FloatArray


@dataclass(frozen=True, eq=False)
class Forecast:
    """Predicted measurements of landmarks in the current frame, for active search, gating and planning.

    Attributes
    ----------
    ids : (N,) int64
        Landmarks.
    uvd : (N, 3)
        Predicted left pixel and disparity, px.
    S : (N, 3, 3)
        Innovation covariance H P H^T + R of each (Eq. 15), px^2.
    in_view : (N,) bool
        In front of the camera and inside both images.
    """

    ids: IntArray
    uvd: FloatArray
    S: FloatArray
    in_view: BoolArray
