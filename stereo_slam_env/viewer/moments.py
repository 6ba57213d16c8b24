"""A filter's drive, moment by moment, as the viewers show it: live, from a recording, or from a run directory."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from filters import LandmarkBelief, PoseBelief, StereoFilter, StereoNoise, StereoObservation, UpdateReport
from filters.camera import StereoCamera
from filters.validation import BoolArray, FloatArray
from stereo_slam_env.evaluation.consistency import nees
from stereo_slam_env.recording.recording import Frame, LandmarkTruth, Pose, Recording

SIGMAS = 3.0
"""Size of the ellipses and ellipsoids."""
LARGEST = 25.0
"""Half axis, m: what is less certain is drawn as a point alone, for its ellipse would hide everything else."""


@dataclass(frozen=True, eq=False)
class Moment:
    """What a filter believes after one frame, and what is true.

    Attributes
    ----------
    name : str
        The filter's, for colours and legends.
    time : float
        s.
    pose : PoseBelief
        Of the left camera.
    landmarks : LandmarkBelief
        The map.
    observation : StereoObservation
        What was seen.
    truth : Pose, optional
        The true pose.
    nees : float
        Of the pose, in the filter's own error (6 degrees of freedom); NaN without an independent truth.
    nis, nis_dof : float, int
        Of the update.
    """

    name: str
    time: float
    pose: PoseBelief
    landmarks: LandmarkBelief
    observation: StereoObservation
    truth: Pose | None
    nees: float
    nis: float
    nis_dof: int

    @property
    def position_error(self) -> float:
        """Distance to the true position, m; NaN without truth."""
        return float("nan") if self.truth is None else float(np.linalg.norm(self.truth.position - self.pose.position))

    @property
    def position_sigmas(self) -> float:
        """What the filter claims for it: `SIGMAS` times the root of the trace of the position's covariance, m."""
        return SIGMAS * float(np.sqrt(np.trace(self.pose.covariance[:3, :3])))


def moment_of(
    name: str,
    time: float,
    slam: StereoFilter,
    observation: StereoObservation,
    report: UpdateReport,
    truth: Pose | None = None,
    *,
    independent: bool = True,
) -> Moment:
    """What there is to see of `slam` after its `update(observation)` returned `report`.

    Parameters
    ----------
    name : str
        What the filter is called.
    time : float
        s.
    slam : StereoFilter
        Only read.
    observation, report
        Of the update.
    truth : Pose, optional
        The true pose of the left camera.
    independent : bool
        Whether the truth owes nothing to the images, see `Reference`: else there is no NEES.
    """
    value = float("nan")
    if truth is not None and independent:
        error, covariance = slam.pose_error(truth.position, truth.orientation)
        value = float(nees(error[None], covariance[None])[0])
    return Moment(
        name, time, slam.pose, slam.landmarks, observation, truth, value, float(report.nis), int(report.nis_dof)
    )


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive to watch: the filter runs as its moments are asked for.

    Attributes
    ----------
    title : str
        One line.
    name : str
        The filter's.
    camera : StereoCamera
        The rig.
    frames : int
        Number of moments.
    moments : callable
        Runs the filter from the start, yields a `Moment` a frame.
    landmarks : LandmarkTruth, optional
        The true map.
    """

    title: str
    name: str
    camera: StereoCamera
    frames: int
    moments: Callable[[], Iterator[Moment]]
    landmarks: LandmarkTruth | None = None


def drive_of(
    recording: Recording,
    make: Callable[[StereoCamera, StereoNoise], StereoFilter],
    name: str,
    *,
    noise: StereoNoise | None = None,
    use_odometry: bool = True,
    observe: Callable[[int, StereoFilter], StereoObservation] | None = None,
) -> Drive:
    """A filter's drive over a recording.

    Parameters
    ----------
    recording : Recording
        The stream.
    make : callable
        Takes camera and noise: a filter class, or a function.
    name : str
        What the filter is called.
    noise, use_odometry, observe
        As of `benchmark.runner.run_filter`, whose beliefs these are.

    Raises
    ------
    ValueError
        The recording has no frames.
    """
    if len(recording) == 0:
        raise ValueError(f"recording {recording.name!r} has no frames")

    independent = recording.reference.is_independent

    def moments() -> Iterator[Moment]:
        slam = make(recording.camera, recording.noise if noise is None else noise)
        slam.reset(**vars(recording.start))
        before: Frame | None = None
        for number, frame in enumerate(recording.frames):
            if before is not None:
                slam.predict(frame.timestamp - before.timestamp, frame.odometry if use_odometry else None)
            if observe is not None:
                frame = dataclasses.replace(frame, observation=observe(number, slam))
            report = slam.update(frame.observation)
            seen, truth = frame.observation, frame.truth
            yield moment_of(name, frame.timestamp, slam, seen, report, truth, independent=independent)
            before = frame

    return Drive(f"{name} on {recording.name}", name, recording.camera, len(recording), moments, recording.landmarks)


class Ellipsoids(NamedTuple):
    """Where covariances reach at `SIGMAS` standard deviations.

    Attributes
    ----------
    half_sizes : (N, n)
        Half axes, m.
    axes : (N, n, n)
        Directions as columns, a right-handed rotation.
    drawn : (N,) bool
        Whether to draw it: the covariance is finite and positive semi-definite, no half axis above `LARGEST`.
    """

    half_sizes: FloatArray
    axes: FloatArray
    drawn: BoolArray

    @property
    def quaternions(self) -> FloatArray:
        """The directions in three dimensions, xyzw; (N, 4)."""
        if len(self.axes) == 0:
            return np.zeros((0, 4))
        return np.asarray(Rotation.from_matrix(self.axes).as_quat(), dtype=np.float64)


def ellipsoids(covariances: FloatArray) -> Ellipsoids:
    """Principal axes of covariances; (N, n, n) m^2, n of 2 or 3."""
    count, size = covariances.shape[:2]
    known = np.asarray(np.isfinite(covariances).all(axis=(1, 2)), dtype=np.bool_)
    values, axes = np.zeros((count, size)), np.tile(np.eye(size), (count, 1, 1))
    values[known], axes[known] = np.linalg.eigh(covariances[known])
    axes[..., 0] *= np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None]
    half_sizes = SIGMAS * np.sqrt(np.maximum(values, 0.0))
    definite = values[:, 0] >= -1e-9 * np.abs(values[:, -1])  # but for rounding
    return Ellipsoids(half_sizes, axes, known & definite & (half_sizes[:, -1] <= LARGEST))
