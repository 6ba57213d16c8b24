"""The interface of filters.

Frames: W is the world (the left camera at `reset`), C the left camera (x right, y down, z forward).
Orientations are unit quaternions xyzw; R_wc takes camera vectors into W. SI units, float64.
"""

from __future__ import annotations

import inspect
import logging
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from filters.contract.inputs import BodyVelocity, InertialSamples, Start, StereoObservation
from filters.contract.noise import StereoNoise
from filters.contract.outputs import Forecast, LandmarkBelief, PoseBelief, UpdateReport, VelocityBelief
from filters.contract.validation import positive, unique_ids
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera

_log = logging.getLogger(__name__)


def check_rig(camera: StereoCamera, noise: StereoNoise) -> None:
    """Raise a `ValueError` if these are not what every filter is made with."""
    if not isinstance(camera, StereoCamera):
        raise ValueError(f"camera must be a StereoCamera, got {camera!r}")
    if not isinstance(noise, StereoNoise):
        raise ValueError(f"noise must be a StereoNoise, got {noise!r}: see StereoNoise.independent_pixels")


LONGEST_STEP = 100.0
"""Of `predict`, s: in a longer one the constant-velocity model knows nothing any more."""


def time_step(dt: object) -> float:
    """Return `dt` as seconds that `StereoFilter.predict` takes, or raise a `ValueError`."""
    step = positive("dt", dt)
    if step > LONGEST_STEP:
        raise ValueError(f"dt must be at most {LONGEST_STEP:g} s, got {step:g}: reset the filter after so long a gap")
    return step


def check_step(dt: object, odometry: object, inertial: object) -> float:
    """Return `dt` as seconds, or raise a `ValueError` if these are not what `StereoFilter.predict` takes."""
    step = time_step(dt)
    if odometry is not None and type(odometry) is not BodyVelocity:
        if isinstance(odometry, BodyVelocity):
            type_words = type(odometry).__name__
            raise ValueError(
                f"odometry must be a BodyVelocity itself, got the subclass {type_words}: what it adds is not used"
            )
        raise ValueError(f"odometry must be a BodyVelocity or None, got {type(odometry).__name__}")
    if inertial is not None:
        if not isinstance(inertial, InertialSamples):
            raise ValueError(f"inertial must be InertialSamples or None, got {type(inertial).__name__}")
        inertial.check_step(step)
    return step


AT_ORIGIN = Start()
"""At the origin of W, looking along z, with an unknown velocity."""


def check_start(start: object) -> None:
    """Raise a `ValueError` if this is not what `StereoFilter.reset` takes."""
    if not isinstance(start, Start):
        raise ValueError(f"start must be a filters.Start, got {start!r}")


class StereoFilter(ABC):
    """A stereo SLAM filter. Implement these members and any bench, environment or test here can run it.

    Bad input raises `ValueError` naming the argument, and leaves the state as it was.
    """

    camera: StereoCamera
    noise: StereoNoise
    open_options: ClassVar[frozenset[str]] = frozenset()
    """Options of the constructor that the filter leaves to a comparison, which gives all filters the same gate, motion
    model and so on. A class that does not state them has those of its base which its constructor takes, by `**options`
    or with the default None: another default is a choice."""

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        if "__init__" in vars(cls) and "open_options" not in vars(cls):
            parameters = inspect.signature(cls.__init__).parameters
            takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
            cls.open_options = frozenset(
                name
                for name in cls.open_options
                if (parameters[name].default is None if name in parameters else takes_any)
            )

    @abstractmethod
    def reset(self, start: Start = AT_ORIGIN) -> None:
        """Start again from `start`, with an empty map. Raises `ValueError` if that is no `Start`."""

    @abstractmethod
    def predict(self, dt: float, odometry: BodyVelocity | None = None, inertial: InertialSamples | None = None) -> None:
        """Move the belief forward by `dt` seconds, above 0 and up to 100 (Eq. 6, 11, 12).

        What is known of the step besides is given as odometry, as samples of an inertial unit, or as both. A filter
        that makes no use of one of them says so once, in the log: see `say_unused`.
        """

    def say_unused(self, name: str) -> None:
        """Say in the log, once for this filter, that an input of `predict` has no effect: "odometry" or "inertial"."""
        said_before = vars(self).setdefault("_said_unused", set())
        if name not in said_before:
            said_before.add(name)
            what = "inertial samples" if name == "inertial" else name
            _log.warning("%s makes no use of the %s that it is given", type(self).__name__, what)

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
        wanted_ids = landmarks.ids if ids is None else unique_ids("ids", np.asarray(ids))
        missing = wanted_ids[~np.isin(wanted_ids, landmarks.ids)]
        if len(missing):
            raise ValueError(f"ids must be in the map, not there: {missing[:5].tolist()}: see landmarks.ids")
        index = np.searchsorted(landmarks.ids, wanted_ids)
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
        """Error of the pose against another one, in the filter's own error definition, for NEES.

        Runs ask for it near the estimate alone, and compute the error against the truth by the same definition:
        `filters.checks.consistency`.

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
