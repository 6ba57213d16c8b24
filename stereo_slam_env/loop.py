"""The loop that runs a filter: reset, then predict and update in every frame. Everything that runs a filter uses it."""

from __future__ import annotations

import dataclasses
import inspect
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from filters import (
    BodiesBelief,
    LandmarkBelief,
    Pose,
    PoseBelief,
    Start,
    StereoFilter,
    StereoNoise,
    StereoObservation,
    UpdateReport,
    nees,
)
from filters.catalogue.registry import FilterFactory, label_of, make_with_common_options, usual_options
from filters.checks.consistency import blind_pose_error, error_jacobian
from filters.geometry.arrays import FloatArray
from stereo_slam_env.recording.recording import SIMULATION, Frame, Recording, Reference, require_frames

Observe = Callable[[int, StereoFilter], StereoObservation]
"""Measures in the images where a filter expects its landmarks: frame number and predicted filter -> observation."""


@dataclass(frozen=True, eq=False)
class Moment:
    """A filter after the update of one frame. Its beliefs are read on first access: before the filter goes on."""

    number: int
    """Of the frame, from 0."""
    frame: Frame
    """Time, measurements that were used, odometry, and truth where there is one."""
    slam: StereoFilter
    """The filter."""
    report: UpdateReport
    """What the update did."""
    reference: Reference
    """What the truth is."""
    predict_seconds: float
    """Time that `predict` took, s."""
    update_seconds: float
    """Time that `update` took, s."""
    start: Pose | None = None
    """True pose of the first frame, from which the reference is counted."""

    @property
    def time(self) -> float:
        """Time of the frame, s."""
        return self.frame.timestamp

    @property
    def observation(self) -> StereoObservation:
        """Measurements that were used."""
        return self.frame.observation

    @property
    def truth(self) -> Pose | None:
        """True pose of the left camera; None where it is not known."""
        return self.frame.truth

    @cached_property
    def pose(self) -> PoseBelief:
        """Estimated pose of the left camera."""
        return self.slam.pose

    @cached_property
    def landmarks(self) -> LandmarkBelief:
        """Belief of the landmarks in the map."""
        return self.slam.landmarks

    @cached_property
    def bodies(self) -> BodiesBelief | None:
        """Belief of the moving bodies in the state; None where the filter has none by its options."""
        options = getattr(self.slam, "options", None)
        return getattr(self.slam, "bodies", None) if getattr(options, "bodies", True) is not None else None

    @cached_property
    def pose_error(self) -> tuple[FloatArray, FloatArray] | None:
        """Error (6,) in the filter's own definition and its claimed covariance (6, 6); None without truth.

        The filter is not shown the truth: see `filters.checks.consistency`.
        """
        return None if self.truth is None else blind_pose_error(self.slam, self.truth.position, self.truth.orientation)

    @cached_property
    def scored_error(self) -> tuple[FloatArray, FloatArray] | None:
        """`pose_error`, with what the reference states of its own errors added to the covariance.

        None where it is not to be scored: without a truth that is independent of the images, or before that has
        settled.
        """
        reference = self.reference
        if self.truth is None or self.pose_error is None:
            return None
        if not reference.counts_as_truth or not reference.has_settled(self.time):
            return None
        if reference.is_exact or self.start is None:
            return self.pose_error
        error, covariance = self.pose_error
        J = error_jacobian(self.slam)
        summed: FloatArray = covariance + J @ reference.covariance(self.start, self.truth) @ J.T
        return error, summed

    @property
    def nees(self) -> float:
        """NEES of the pose, 6 degrees of freedom; NaN where there is no `scored_error`, or its covariance is none."""
        if self.scored_error is None:
            return float("nan")
        error, covariance = self.scored_error
        return float(nees(error[None], covariance[None])[0])

    def hold(self) -> Moment:
        """Read all beliefs now, so that they stay when the filter goes on; returns itself."""
        _ = self.pose, self.landmarks, self.bodies, self.pose_error
        return self

    @property
    def position_error(self) -> float:
        """Distance to the true position, m; NaN without truth."""
        return float("nan") if self.truth is None else float(np.linalg.norm(self.truth.position - self.pose.position))


class FilterLoop:
    """A filter that is fed frame by frame: the first frame only updates, every later one predicts, then updates.

    Parameters
    ----------
    slam : StereoFilter
        The filter.
    reference : Reference
        What the truth of the frames is.
    use_odometry : bool
        Whether `predict` is given the odometry of the frames. It is given their inertial samples if it has an argument
        for them; the log says so once if not.
    """

    def __init__(self, slam: StereoFilter, reference: Reference = SIMULATION, *, use_odometry: bool = True) -> None:
        self.slam = slam
        self._reference, self._use_odometry = reference, use_odometry
        self._takes_samples = "inertial" in inspect.signature(slam.predict).parameters
        self._number, self._time = -1, 0.0
        self._first_truth: Pose | None = None

    def reset(self, start: Start) -> None:
        """Start the filter and the count of frames again."""
        self.slam.reset(start)
        self._number = -1

    def step(self, frame: Frame, observe: Observe | None = None) -> Moment:
        """Feed a frame; whatever the filter raises is passed on.

        After a `predict` that raised, the next frame is predicted from the last one that did not.

        Parameters
        ----------
        frame : Frame
            The next one in time.
        observe : callable, optional
            Called after `predict`, untimed: measures instead of the frame.
        """
        number, began = self._number + 1, time.perf_counter()
        if number:
            self._predict(frame)
        predicted = time.perf_counter()
        self._number, self._time = number, frame.timestamp
        if number == 0:
            self._first_truth = frame.truth
        if observe is not None:
            frame = dataclasses.replace(frame, observation=observe(number, self.slam))
        measured = time.perf_counter()
        report = self.slam.update(frame.observation)
        updated = time.perf_counter()
        seconds = predicted - began, updated - measured
        return Moment(number, frame, self.slam, report, self._reference, *seconds, self._first_truth)

    def _predict(self, frame: Frame) -> None:
        dt, odometry = frame.timestamp - self._time, frame.odometry if self._use_odometry else None
        if frame.inertial is None:
            self.slam.predict(dt, odometry)
        elif self._takes_samples:
            self.slam.predict(dt, odometry, frame.inertial)
        else:
            self.slam.say_unused("inertial")
            self.slam.predict(dt, odometry)


def run(
    slam: str | FilterFactory | StereoFilter,
    recording: Recording,
    *,
    noise: StereoNoise | None = None,
    use_odometry: bool | None = None,
    observe: Observe | None = None,
    **options: Any,
) -> Iterator[Moment]:
    """Run a filter over a recording; it computes a frame when its moment is asked for.

    It is set up as the recording states (`Recording.filter_setup`), but for what is given here.

    Parameters
    ----------
    slam : str, callable or StereoFilter
        A name of `filters.available_filters()`, a filter class or function called as `make(camera=..., noise=...,
        **options)`, or a filter, which is reset.
    recording : Recording
        The stream.
    noise : StereoNoise, optional
        Noise to assume; None: what the recording states. For a filter that is made here.
    use_odometry : bool, optional
        Whether `predict` is given the odometry of the recording; None: what that states.
    observe : callable, optional
        Measures instead of the recording, see `FilterLoop.step`.
    **options
        Of the filter that is made here.

    Yields
    ------
    Moment
        The filter after each frame.

    Raises
    ------
    ValueError
        The recording is empty, the filter or an option is unknown or refused, or options are given for a filter that
        is made already.
    """
    require_frames(recording)
    setup = recording.filter_setup
    if not isinstance(slam, StereoFilter):
        filter_options = {**usual_options(slam), **options}
        assumed, common = noise or setup.assumed_noise(recording.noise), setup.common_options(filter_options)
        slam = make_with_common_options(slam, recording.camera, assumed, filter_options, common).filter
    elif options or noise is not None:
        arguments = ", ".join([*(["noise"] if noise is not None else []), *options])
        raise ValueError(f"{arguments} must be given to {label_of(type(slam))} itself, which is made already")
    given_odometry = setup.use_odometry if use_odometry is None else use_odometry
    loop = FilterLoop(slam, recording.reference, use_odometry=given_odometry)
    loop.reset(recording.start)
    return (loop.step(frame, observe) for frame in recording.frames)
