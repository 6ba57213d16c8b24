"""The interface of filters, and the value types of its inputs and outputs.

Frames: W is the world (the left camera at `reset`), C the left camera (x right, y down, z forward).
Orientations are unit quaternions xyzw; R_wc takes camera vectors into W. SI units, float64.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from filters.camera import StereoCamera
from filters.constructor_calls import RecordedConstructors
from filters.noise import StereoNoise
from filters.start import Start
from filters.validation import BoolArray, FloatArray, IntArray, covariance_matrix, finite_array, unique_ids


@dataclass(frozen=True, eq=False)
class StereoObservation:
    """Measurements of the stereo camera in one frame.

    Parameters
    ----------
    ids : (M,) array_like of int
        Landmark identities, unique.
    uvd : (M, 3) array_like
        Left pixel and disparity, px. d <= 0 is legal: noise on a far point.
    v_right : (M,) array_like, optional
        Row measured in the right image, px, where the sensor measures it on its own.
    R : (M, 3, 3) array_like, optional
        Covariance of each measurement, px^2; where None, the filter's `noise` holds.

    Raises
    ------
    ValueError
        Wrong shapes, NaN or infinity, repeated ids, an R that is not symmetric positive definite.
    """

    ids: IntArray
    uvd: FloatArray
    v_right: FloatArray | None = None
    R: FloatArray | None = None

    def __post_init__(self) -> None:
        ids = unique_ids("ids", self.ids)
        uvd = finite_array("uvd", self.uvd, ("M", 3))
        if len(uvd) != len(ids):
            raise ValueError(f"uvd must have one row per id: {len(ids)} ids, {len(uvd)} rows")
        object.__setattr__(self, "ids", ids)
        object.__setattr__(self, "uvd", uvd)
        if self.v_right is not None:
            v_right = finite_array("v_right", self.v_right, ("M",))
            if len(v_right) != len(ids):
                raise ValueError(f"v_right must have one entry per id: {len(ids)} ids, {len(v_right)} entries")
            object.__setattr__(self, "v_right", v_right)
        if self.R is not None:
            R = np.zeros((0, 3, 3)) if len(ids) == 0 else self.R
            object.__setattr__(self, "R", covariance_matrix("R", R, 3, batch=len(ids), definite=True))

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, index: ArrayLike) -> StereoObservation:
        """The measurements at `index` (positions or a mask), in that order."""
        i = np.asarray(index)
        # Every measurement has been checked when this observation was made; only positions can repeat one.
        part = object.__new__(StereoObservation)
        fields = {name: None if value is None else value[i] for name, value in vars(self).items()}
        vars(part).update(fields)
        if i.dtype != np.bool_:
            unique_ids("ids", part.ids)
        return part

    def covariances(self, noise: StereoNoise) -> FloatArray:
        """R of each measurement: its own, or that of `noise`; (M, 3, 3) px^2."""
        return noise.R[None].repeat(len(self), axis=0) if self.R is None else self.R

    def ordered(self) -> StereoObservation:
        """The measurements in ascending order of ids."""
        return self if (self.ids[1:] > self.ids[:-1]).all() else self.select(np.argsort(self.ids))


@dataclass(frozen=True, eq=False)
class BodyVelocity:
    """Odometry: the mean velocity of the left camera over the step that ends now.

    Parameters
    ----------
    linear : (3,) array_like
        m/s, camera frame.
    angular : (3,) array_like
        rad/s, camera frame.
    covariance : (6, 6) array_like
        Of (linear, angular).

    Raises
    ------
    ValueError
        Wrong shapes, NaN or infinity, a covariance that is not symmetric positive semi-definite.
    """

    linear: FloatArray
    angular: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "linear", finite_array("odometry.linear", self.linear, (3,)))
        object.__setattr__(self, "angular", finite_array("odometry.angular", self.angular, (3,)))
        covariance = covariance_matrix("odometry.covariance", self.covariance, 6)
        object.__setattr__(self, "covariance", covariance)


_NO_IDS: IntArray = np.zeros(0, dtype=np.int64)
_NO_IDS.flags.writeable = False


def _no_ids() -> IntArray:
    return _NO_IDS


@dataclass(frozen=True, eq=False)
class UpdateReport:
    """Outcome of each measurement in one `update`, or of earlier ones where updates are delayed.

    Attributes
    ----------
    updated, initialised, dropped : (K,) int64
        Ids that corrected the state, entered the map, left the map.
    gated : (K,) int64
        Known ids whose measurement failed the chi-square gate (Mahalanobis distance too large), in the first or in a
        later stage of the update; the stages before it have used the measurement.
    rejected : (K,) int64
        New ids the filter did not initialise from: it could not (for XYZ: d <= 0 or below `min_disparity`), or it has
        room for better ones only (`max_landmarks`).
    behind_camera : (K,) int64
        Known ids predicted behind the camera, so not used.
    failed : (K,) int64
        Known ids whose innovation covariance had no Cholesky factor, or is so large that R is lost in its rounding (a
        landmark as good as in the image plane), so not used (or not in every stage).
    nis : float
        Normalised innovation squared over the accepted measurements, chi-square with `nis_dof` if consistent.
    nis_dof : int
        Degrees of freedom of `nis`.
    """

    updated: IntArray = field(default_factory=_no_ids)
    initialised: IntArray = field(default_factory=_no_ids)
    dropped: IntArray = field(default_factory=_no_ids)
    gated: IntArray = field(default_factory=_no_ids)
    rejected: IntArray = field(default_factory=_no_ids)
    behind_camera: IntArray = field(default_factory=_no_ids)
    failed: IntArray = field(default_factory=_no_ids)
    nis: float = 0.0
    nis_dof: int = 0

    @property
    def failed_factorisations(self) -> int:
        """Number of `failed` measurements."""
        return len(self.failed)


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


def check_rig(camera: StereoCamera, noise: StereoNoise) -> None:
    """Raise a `ValueError` if these are not what every filter is made with."""
    if not isinstance(camera, StereoCamera):
        raise ValueError(f"camera must be a StereoCamera, got {camera!r}")
    if not isinstance(noise, StereoNoise):
        raise ValueError(f"noise must be a StereoNoise, got {noise!r}: see StereoNoise.independent_pixels")


AT_ORIGIN = Start()
"""At the origin of W, looking along z, with an unknown velocity."""


def check_start(start: object) -> None:
    """Raise a `ValueError` if this is not what `StereoFilter.reset` takes."""
    if not isinstance(start, Start):
        raise ValueError(f"start must be a filters.Start, got {start!r}")


class StereoFilter(RecordedConstructors, ABC):
    """A stereo SLAM filter. Implement these members and any bench, environment or test here can run it.

    Bad input raises `ValueError` naming the argument, and leaves the state as it was.
    """

    camera: StereoCamera
    noise: StereoNoise

    @abstractmethod
    def reset(self, start: Start = AT_ORIGIN) -> None:
        """Start again from `start`, with an empty map. Raises `ValueError` if that is no `Start`."""

    @abstractmethod
    def predict(self, dt: float, odometry: BodyVelocity | None = None) -> None:
        """Move the belief forward by `dt` > 0 seconds (Eq. 6, 11, 12)."""

    @abstractmethod
    def update(self, observation: StereoObservation) -> UpdateReport:
        """Use the frame: known ids correct the state (Eq. 13-18), then new ones enter the map (Eq. 19-25).

        A filter may delay that (fixed lag, multi-state constraint): it uses and reports a measurement in a later
        update, or a whole track, by its id, once it has ended. The pose is that of the present frame all the same, and
        a frame without measurements may then correct it, too.
        """

    @abstractmethod
    def forecast(self, ids: Sequence[int] | IntArray | None = None) -> Forecast:
        """Predict the measurements of `ids` (None: of the whole map) at the current pose.

        Raises
        ------
        ValueError
            An id is not in the map.
        """

    @abstractmethod
    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Remove landmarks from the map (marginalise them); ids not in the map are ignored."""

    @property
    @abstractmethod
    def pose(self) -> PoseBelief:
        """Pose of the left camera."""

    @property
    @abstractmethod
    def velocity(self) -> VelocityBelief:
        """Velocity of the left camera."""

    @property
    @abstractmethod
    def landmarks(self) -> LandmarkBelief:
        """The map, in ascending order of ids."""

    def joint_covariance(self, ids: Sequence[int] | IntArray | None = None) -> FloatArray:
        """Covariance of the pose error together with the positions of landmarks, for planning and information gain.

        This one is for filters that have nothing better: it puts the marginals (`pose.covariance` and
        `landmarks.covariances`) on the diagonal and **leaves out all correlations**. That overstates the joint
        uncertainty, often by much: landmarks seen from one pose share its error. Override it where P is at hand.

        Parameters
        ----------
        ids : (N,) sequence of int, optional
            Landmarks, in the order wanted. None: the whole map, ascending.

        Returns
        -------
        (6 + 3 N, 6 + 3 N) ndarray
            Of the pose error as in `PoseBelief` (position in W, m; rotation in the camera frame, rad), then of the
            positions in W, m. Rows of landmarks without a finite position are not finite.

        Raises
        ------
        ValueError
            An id is not in the map.
        """
        landmarks = self.landmarks
        wanted = landmarks.ids if ids is None else unique_ids("ids", np.asarray(ids))
        missing = wanted[~np.isin(wanted, landmarks.ids)]
        if len(missing):
            raise ValueError(f"ids must be in the map, not there: {missing[:5].tolist()}: see landmarks.ids")
        index = np.searchsorted(landmarks.ids, wanted)
        rows = 6 + 3 * np.arange(len(index))[:, None] + np.arange(3)
        joint = np.zeros((6 + 3 * len(index), 6 + 3 * len(index)))
        joint[:6, :6] = self.pose.covariance
        joint[rows[:, :, None], rows[:, None, :]] = landmarks.covariances[index]
        return joint

    def pose_landmark_covariances(self, ids: Sequence[int] | IntArray | None = None) -> FloatArray:
        """The parts of `joint_covariance` that belong to the pose and to one landmark each: cheap for many landmarks.

        Takes the ids of `joint_covariance`; returns (N, 9, 9), of the pose error and the position of the landmark.
        """
        joint = self.joint_covariance(ids)
        pose, landmarks = np.arange(6), np.arange(6, len(joint)).reshape(-1, 3)
        rows = np.concatenate([np.broadcast_to(pose, (len(landmarks), 6)), landmarks], axis=1)
        parts: FloatArray = joint[rows[:, :, None], rows[:, None, :]]
        return parts

    @abstractmethod
    def pose_error(self, position: ArrayLike, orientation: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Error of the pose against a true one, in the filter's own error definition, for NEES.

        Parameters
        ----------
        position : (3,)
            True r^WC, m.
        orientation : (4,)
            True q^WC, xyzw.

        Returns
        -------
        error : (6,) ndarray
            Position part, then rotation part.
        covariance : (6, 6) ndarray
            The covariance the filter claims for that error.
        """
