"""Outputs of a filter: beliefs, named variables, predicted measurements, and the outcome of an update."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from filters.contract.validation import covariance_matrix, finite_array, unique_ids
from filters.geometry import derivatives, rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.poses import ADDITIVE, Retraction, RotationVector


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
    """Belief of the landmarks in the map."""

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
    """(N, 3, 3): innovation covariance H P H^T + R of each (Eq. 15), px^2; NaN where rounding leaves none."""
    in_view: BoolArray
    """(N,): in front of the camera and inside both images, with an innovation covariance."""


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
    """(K,): ids that left the map: they were not seen, or, with moving bodies, are not on what they were taken for."""
    gated: IntArray = field(default_factory=_no_ids)
    """(K,): known ids whose measurement failed the chi-square gate (Mahalanobis distance too large), in the first or in
    a later stage of the update; the stages before it have used the measurement."""
    rejected: IntArray = field(default_factory=_no_ids)
    """(K,): new ids the filter did not initialise from (for XYZ: d <= 0 or below `min_disparity`; with moving bodies:
    it is not known yet whether they stand)."""
    behind_camera: IntArray = field(default_factory=_no_ids)
    """(K,): known ids predicted behind the camera, so not used."""
    failed: IntArray = field(default_factory=_no_ids)
    """(K,): known ids whose innovation covariance had no Cholesky factor, or is so large that R is lost in its rounding
    (a landmark as good as in the image plane), so not used (or not in every stage)."""
    nis: float = 0.0
    """Normalised innovation squared over the accepted measurements, chi-square with `nis_dof` if consistent."""
    nis_dof: int = 0
    """Degrees of freedom of `nis`."""
    born: IntArray = field(default_factory=_no_ids)
    """(K,): numbers of moving bodies that entered the state."""
    died: IntArray = field(default_factory=_no_ids)
    """(K,): numbers of moving bodies that left it."""
    joined: IntArray = field(default_factory=_no_ids)
    """(K,): ids that are on a moving body from now on."""
    left: IntArray = field(default_factory=_no_ids)
    """(K,): ids that are on it no longer."""

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


POSE, VELOCITY = "pose", "velocity"
"""The variables that every filter has."""


@dataclass(frozen=True, eq=False)
class Variable:
    """A variable of the state as it is at the start.

    Parameters
    ----------
    name : str
        Of `StereoEKF.belief`; "pose" and "velocity" are taken.
    value : (v,) array_like
        Its numbers.
    covariance : (s, s) array_like
        Of its error, in the coordinates of the retraction.
    retraction : Retraction
        How a correction (s,) changes the value: the default adds it; `RotationVector()` turns a quaternion, xyzw.
    considered : bool
        Schmidt's consider variable: it has a covariance and correlations, but no measurement changes its value or
        its own covariance.
    random_walk : (s,) array_like, optional
        Process noise, a standard deviation per square root of a second. None: the variable is constant.
    in_world : bool
        Whether the value is a vector in W, such as gravity, which turns with the world.

    Raises
    ------
    ValueError
        An argument has the wrong shape, is not finite, or is no covariance.

    References
    ----------
    S. F. Schmidt, "Application of state-space methods to navigation problems", Advances in Control Systems 3, 1966.
    P. Geneva et al., "OpenVINS: A research platform for visual-inertial estimation", ICRA 2020 (its `Type`).
    """

    name: str
    value: FloatArray
    covariance: FloatArray
    retraction: Retraction = ADDITIVE
    considered: bool = False
    random_walk: FloatArray | None = None
    in_world: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name or self.name in (POSE, VELOCITY):
            raise ValueError(f'name must be that of a new variable, not "{POSE}" or "{VELOCITY}", got {self.name!r}')
        what = f"variable {self.name!r}"
        shape: tuple[int | str, ...] = (3,) if self.in_world else ("v",)
        object.__setattr__(self, "value", finite_array(f"value of {what}", self.value, shape))
        size = len(np.atleast_1d(np.asarray(self.covariance, dtype=np.float64)))
        object.__setattr__(self, "covariance", covariance_matrix(f"covariance of {what}", self.covariance, size))
        self._check_retraction(what, size)
        if self.random_walk is not None:
            walk = finite_array(f"random_walk of {what}", self.random_walk, (size,))
            if (walk < 0.0).any():
                raise ValueError(f"random_walk of {what} must be standard deviations >= 0, got {walk.tolist()}")
            object.__setattr__(self, "random_walk", walk)

    def _check_retraction(self, what: str, size: int) -> None:
        shape = (4, 3) if isinstance(self.retraction, RotationVector) else (len(self.value),) * 2
        if self.retraction is not ADDITIVE and not isinstance(self.retraction, RotationVector):
            raise ValueError(
                f"retraction of {what} must be addition or RotationVector(), of a quaternion, got {self.retraction!r}"
            )
        if (len(self.value), size) != shape:
            raise ValueError(
                f"{what} must have {shape[0]} numbers and {shape[1]} errors, got {len(self.value)}, {size}"
            )

    @property
    def size(self) -> int:
        """Numbers of its error."""
        return len(self.covariance)

    def turned(self, value: FloatArray, R: FloatArray) -> FloatArray:
        """The value in a world rotated about its origin by R (3, 3)."""
        return R @ value if self.in_world else value

    def world_rotation(self, value: FloatArray) -> FloatArray:
        """Effect of a rotation of the world on the error; (s, 3)."""
        if not self.in_world:
            return np.zeros((self.size, 3))
        return derivatives.jacobian(lambda e: self.retraction.local(value, rotations.exp(e) @ value), 3)


@dataclass(frozen=True, eq=False)
class VariableBelief:
    """Belief of a named variable."""

    value: FloatArray
    """(v,): its numbers; of the pose, position (W, m) and orientation (xyzw)."""
    covariance: FloatArray
    """(s, s), of its error."""


@dataclass(frozen=True, eq=False)
class MovedLandmarks:
    """Landmarks that the step of a variable moves: N points of W after it, and their Jacobians."""

    ids: IntArray
    """(N,): which ones."""
    positions: FloatArray
    """(N, 3): m, after the step."""
    by_landmark: FloatArray
    """(N, 3, 3): by their positions before the step."""
    by_variable: FloatArray
    """(N, 3, s): by the error of the variable before the step."""

    def __post_init__(self) -> None:
        ids = unique_ids("landmarks.ids", np.asarray(self.ids))
        object.__setattr__(self, "ids", ids)
        for name, shape in (("positions", (3,)), ("by_landmark", (3, 3)), ("by_variable", (3, "s"))):
            value = finite_array(f"landmarks.{name}", getattr(self, name), (len(ids), *shape))
            object.__setattr__(self, name, value)

    @classmethod
    def none(cls, size: int) -> MovedLandmarks:
        """No landmark, beside a variable of so many error numbers."""
        empty = np.zeros((0, 3, size))
        return cls(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)), empty)


@dataclass(frozen=True, eq=False)
class VariableSteps:
    """Steps of G groups of variables and clones, with s error numbers each, and of landmarks that they carry along."""

    names: tuple[tuple[str, ...], ...]
    """(G,): the variables of each group."""
    values: FloatArray
    """(G, v): theirs after the step, one after the other; of a clone position and orientation."""
    F: FloatArray
    """(G, s, s): by their errors before the step."""
    Q: FloatArray
    """(G, s, s): noise of these errors, before the step."""
    landmarks: MovedLandmarks
    carriers: IntArray
    """(N,): group that carries each landmark."""
