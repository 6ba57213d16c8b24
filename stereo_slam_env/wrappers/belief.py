"""Belief of a filter in the loop after a frame, for the wrappers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from filters import rotations
from filters.camera import StereoCamera
from filters.consistency import nees
from filters.interface import PoseBelief, StereoFilter, UpdateReport
from filters.motion import POSE_SIZE, POSITION, ROTATION
from filters.noise import StereoNoise
from filters.registry import filter_arguments, make_filter
from filters.validation import FloatArray, IntArray, positive
from stereo_slam_env.loop import FilterLoop
from stereo_slam_env.recording.recording import Frame, Pose, Start


@dataclass(frozen=True, eq=False)
class Belief:
    """Pose and map of a filter after a frame. Ask before the filter goes on.

    Attributes
    ----------
    slam : StereoFilter
        The filter.
    report : UpdateReport
        Of the frame.
    pose : PoseBelief
        As the filter has it.
    ids : (N,) int64
        Landmarks in front of their anchors, at a finite distance; ascending.
    points_w, points_c : (N, 3)
        Where they are, m, in W and in the camera frame.
    map_size : int
        Number of all landmarks, wherever they are.
    """

    slam: StereoFilter
    report: UpdateReport
    pose: PoseBelief
    ids: IntArray
    points_w: FloatArray
    points_c: FloatArray
    map_size: int

    @classmethod
    def of(cls, slam: StereoFilter, report: UpdateReport) -> Belief:
        """What the filter believes now.

        Raises
        ------
        ArithmeticError
            The pose is not finite.
        """
        pose, landmarks = slam.pose, slam.landmarks
        for name, value in vars(pose).items():
            if not np.isfinite(value).all():
                raise ArithmeticError(f"the filter returned NaN or infinity in its {name} of the pose")
        located = np.isfinite(landmarks.positions).all(axis=1) & np.isfinite(landmarks.covariances).all(axis=(1, 2))
        located &= landmarks.inverse_distance > 0
        points_w = landmarks.positions[located]
        points_c = (points_w - pose.position) @ rotations.matrix(pose.orientation)
        return cls(slam, report, pose, landmarks.ids[located], points_w, points_c, len(landmarks.ids))

    def __len__(self) -> int:
        return len(self.ids)

    @cached_property
    def joint_covariance(self) -> FloatArray:
        """Of the pose and the positions (W) of `ids`, (6 + 3 N, 6 + 3 N), see `StereoFilter.joint_covariance`."""
        return self.slam.joint_covariance(self.ids)

    @cached_property
    def relative_covariances(self) -> FloatArray:
        """Covariances of `points_c`, (N, 3, 3) m^2.

        p_c = R_wc^T (p_w - r), so the errors of pose and landmark, and what they have in common, all count.
        """
        R_cw = rotations.matrix(self.pose.orientation).T
        J = np.empty((len(self), 3, POSE_SIZE + 3))
        J[:, :, POSITION], J[:, :, POSE_SIZE:] = -R_cw, R_cw
        J[:, :, ROTATION] = rotations.skew(self.points_c)
        relative: FloatArray = J @ self.slam.pose_landmark_covariances(self.ids) @ J.transpose(0, 2, 1)
        return relative

    def nees(self, truth: Pose) -> FloatArray:
        """NEES of position, rotation, and both, (3,), in the filter's own error definition.

        Infinite where the covariance is not positive definite.
        """
        error, covariance = self.slam.pose_error(truth.position, truth.orientation)
        blocks = np.stack([covariance[POSITION, POSITION], covariance[ROTATION, ROTATION]])
        values = np.append(nees(error.reshape(2, 3), blocks), nees(error[None], covariance[None]))
        return np.where(np.isnan(values), np.inf, values)

    def nearest(self, count: int) -> IntArray:
        """Indices of the `count` landmarks nearest to the camera, in the order of their ids."""
        if len(self) <= count:
            return np.arange(len(self))
        squares = np.einsum("ni,ni->n", self.points_c, self.points_c)
        return np.sort(np.argpartition(squares, count)[:count])


class FilterInTheLoop:
    """A filter that is fed frame by frame.

    Parameters
    ----------
    name : str
        Of `filters.available_filters()`.
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        Of measurements that bring none of their own.
    options : mapping
        Of the filter, JSON-able, see `filters.registry.filter_arguments`.
    use_odometry : bool
        Whether `predict` is given the odometry.

    Raises
    ------
    ValueError
        The filter or an option is unknown or impossible.
    """

    def __init__(
        self, name: str, camera: StereoCamera, noise: StereoNoise, options: Mapping[str, Any], use_odometry: bool
    ) -> None:
        slam = make_filter(name, camera=camera, noise=noise, **filter_arguments(options))
        self._filter_name, self._number = name, 0
        self._loop = FilterLoop(slam, use_odometry=use_odometry)

    @property
    def slam(self) -> StereoFilter:
        """The filter, after the last frame."""
        return self._loop.slam

    def start(self, start: Start, frame: Frame) -> Belief:
        """Begin again with what a filter is told and the first frame; raises as `go_on`."""
        self._number = 0
        return self._used(frame, start)

    def go_on(self, frame: Frame) -> Belief:
        """Use the next frame.

        Raises
        ------
        RuntimeError
            The filter raised something or returned NaN; one line says what, which filter and which frame.
        """
        self._number += 1
        return self._used(frame, None)

    def _used(self, frame: Frame, start: Start | None) -> Belief:
        try:
            if start is not None:
                self._loop.reset(start)
            return Belief.of(self.slam, self._loop.step(frame).report)
        except Exception as error:  # a stranger's filter may raise anything; the episode cannot go on without it
            text = (str(error).strip() or "no message").splitlines()[0]
            raise RuntimeError(
                f"filter {self._filter_name!r} failed in frame {self._number}: {type(error).__name__}: {text}"
            ) from error


def assumed_noise(given: Any, of_the_sensor: StereoNoise) -> StereoNoise:
    """The noise a filter is to assume: None for the sensor's own, a standard deviation in px, or R as nested lists."""
    if given is None:
        return of_the_sensor
    if np.ndim(given) == 0:
        return StereoNoise.independent_pixels(positive("noise", given))
    return StereoNoise(given)
