"""`BeliefObservation`: a filter runs along, and its belief is part of the observation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from filters.catalogue.registry import make_filter
from filters.consistency import nees
from filters.contract.beliefs import PoseBelief
from filters.contract.foreign_text import first_line, type_name
from filters.contract.noise import StereoNoise
from filters.contract.start import Start
from filters.contract.stereo_filter import StereoFilter
from filters.contract.update_report import UpdateReport
from filters.geometry import rotations
from filters.geometry.poses import Pose
from filters.motions.model import POSE_SIZE, POSITION, ROTATION
from filters.validation import FloatArray, IntArray, positive, whole_number
from stereo_slam_env.loop import FilterLoop
from stereo_slam_env.sensing.padding import NO_LANDMARK
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper, dict_space

FARTHEST = 1e4
"""Bound of positions, m."""
LARGEST_COVARIANCE = 1e6
"""Bound of entries of covariances, m^2, m rad and rad^2."""


@dataclass(frozen=True, eq=False)
class Belief:
    """Pose and map of a filter after a frame; properties must be read before the filter goes on.

    Attributes
    ----------
    slam : StereoFilter
        The filter.
    report : UpdateReport
        Of the frame.
    pose : PoseBelief
        Estimated pose.
    ids : (N,) int64
        Landmarks in front of their anchors, at a finite distance; ascending.
    points_w, points_c : (N, 3)
        Their positions in W and in the camera frame, m.
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
        """The current belief of a filter; an `ArithmeticError` where its pose is not finite."""
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

        p_c = R_wc^T (p_w - r), so the errors of pose and landmark, and their correlation, all count.
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


class BeliefObservation(RecordedWrapper):
    """Runs a filter on the frames of the environment, and adds its belief to the observation.

    At every reset the filter is started from `start` of the environment. It sees `frame`, in full precision, not the
    float32 observation. Added keys, float32 unless said; **values beyond the bounds are clipped to them**:

    | Key | Shape | Bounds | Meaning |
    |-----|-------|--------|---------|
    | `belief_position` | (3,) | 1e4 | left camera in W, m |
    | `belief_orientation` | (4,) | 1 | quaternion xyzw, camera to W |
    | `belief_covariance` | (6, 6) | 1e6 | of position (W, m) and rotation (camera frame, rad) |
    | `belief_landmark_ids` | (M,) int64 | | ascending; -1 in padding |
    | `belief_landmarks` | (M, 3) | 1e4 | positions in the **camera frame** (x right, y down, z forward), m |
    | `belief_landmark_covariances` | (M, 3, 3) | 1e6 | of those, m^2: errors of the pose count, with correlations |
    | `belief_mask` | (M,) int8 | | 1 where there is a landmark |

    Of more than M landmarks those nearest to the camera are shown. Landmarks without a finite position in front of
    where they were first seen are left out. `info` gains `belief_nis` and `belief_nis_dof` of the frame, and
    `belief_map_size`, the number of all landmarks in the map.

    A filter that raises, or whose pose is not finite, ends the episode with a RuntimeError from `reset` or `step` that
    names the filter, the frame and the cause; after `reset` it goes on.

    Parameters
    ----------
    env : gymnasium.Env
        With a Dict observation, and `camera`, `noise`, `start` and `frame`.
    filter : str
        A name of `filters.available_filters()`.
    max_landmarks : int
        M.
    use_odometry : bool
        Whether the filter is given the odometry.
    noise : float or nested list, optional
        Noise to assume of measurements that come without a covariance: a standard deviation in px (independent
        pixels), or R (3 x 3) of (u, v, d). None: the noise of the sensor.
    options : mapping, optional
        Options of the filter, JSON-able, as in scenario files: {"drop_unseen": False, "motion": {...}}.
    hold : int
        Frames for which an action holds. The filter uses all of them, the belief is read after the last one, and the
        reward is the sum; `info` is that of the last one.

    Raises
    ------
    ValueError
        An argument is unknown or impossible, or the environment offers no frames.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        filter: str = "shared-anchor",
        max_landmarks: int = 64,
        use_odometry: bool = True,
        noise: float | list[list[float]] | None = None,
        options: Mapping[str, Any] | None = None,
        hold: int = 1,
    ) -> None:
        super().__init__(env)
        self._hold = whole_number("hold", hold, 1)
        self._rows = whole_number("max_landmarks", max_landmarks, 1)
        camera, assumed = self.inner("camera"), assumed_noise(noise, self.inner("noise"))
        slam = make_filter(filter, camera=camera, noise=assumed, **dict(options or {}))
        self._loop = FilterLoop(slam, use_odometry=use_odometry)
        self._filter_name, self._number = filter, 0
        self._belief: Belief | None = None
        bounds: dict[str, tuple[float, tuple[int, ...]]] = {
            "belief_position": (FARTHEST, (3,)),
            "belief_orientation": (1.0, (4,)),
            "belief_covariance": (LARGEST_COVARIANCE, (6, 6)),
            "belief_landmarks": (FARTHEST, (max_landmarks, 3)),
            "belief_landmark_covariances": (LARGEST_COVARIANCE, (max_landmarks, 3, 3)),
        }
        added: dict[str, spaces.Space[Any]] = {
            key: spaces.Box(-bound, bound, shape, np.float32) for key, (bound, shape) in bounds.items()
        }
        added["belief_landmark_ids"] = spaces.Box(NO_LANDMARK, np.iinfo(np.int32).max, (max_landmarks,), np.int64)
        added["belief_mask"] = spaces.Box(0, 1, (max_landmarks,), np.int8)
        self.observation_space = spaces.Dict({**dict_space(env, "BeliefObservation").spaces, **added})

    @property
    def slam(self) -> StereoFilter:
        """The filter, after the current frame."""
        return self._loop.slam

    @property
    def belief(self) -> Belief:
        """Belief of the filter after the current frame."""
        if self._belief is None:
            raise RuntimeError("there is no belief yet: reset the environment first")
        return self._belief

    @property
    def report(self) -> UpdateReport:
        """Report of the update with the current frame."""
        return self.belief.report

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment, and start the filter."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._number = 0
        self._use_frame(self.inner("start"), last=True)
        return self._with_belief(observation), self._with_nis(info)

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment `hold` times, and let the filter use the new frames."""
        total, left, over = 0.0, self._hold, False
        while left > 0 and not over:
            observation, reward, terminated, truncated, info = self.env.step(action)
            total += float(reward)
            left, over = left - 1, terminated or truncated
            self._number += 1
            self._use_frame(None, last=over or left == 0)
        return self._with_belief(observation), total, terminated, truncated, self._with_nis(info)

    def _use_frame(self, start: Start | None, *, last: bool) -> None:
        """Let the filter use the current frame, after `start` if there is one; read its belief after the last one."""
        try:
            if start is not None:
                self._loop.reset(start)
            report = self._loop.step(self.inner("frame")).report
            if last:  # to read the map takes as long as to update it
                self._belief = Belief.of(self.slam, report)
        except Exception as error:  # a third-party filter may raise anything; the episode cannot go on without it
            what = f"{type_name(error)}: {first_line(error, empty='no message')}"
            raise RuntimeError(f"filter {self._filter_name!r} failed in frame {self._number}: {what}") from error

    def _with_nis(self, info: dict[str, Any]) -> dict[str, Any]:
        report = self.report
        added = {"belief_nis": np.float64(report.nis), "belief_nis_dof": np.int64(report.nis_dof)}
        return {**info, **added, "belief_map_size": np.int64(self.belief.map_size)}

    def _with_belief(self, observation: dict[str, Any]) -> dict[str, Any]:
        belief, rows = self.belief, self._rows
        shown = belief.nearest(rows)
        count = len(shown)
        landmarks, covariances = np.zeros((rows, 3)), np.zeros((rows, 3, 3))
        ids, mask = np.full(rows, NO_LANDMARK, dtype=np.int64), np.zeros(rows, dtype=np.int8)
        ids[:count], mask[:count], landmarks[:count] = belief.ids[shown], 1, belief.points_c[shown]
        covariances[:count] = belief.relative_covariances[shown]
        values = {
            "belief_position": belief.pose.position,
            "belief_orientation": belief.pose.orientation,
            "belief_covariance": belief.pose.covariance,
            "belief_landmarks": landmarks,
            "belief_landmark_covariances": covariances,
        }
        boxes: Any = self.observation_space
        added = {key: value.clip(boxes[key].low, boxes[key].high).astype(np.float32) for key, value in values.items()}
        return {**observation, **added, "belief_landmark_ids": ids, "belief_mask": mask}


def assumed_noise(given: Any, noise_of_sensor: StereoNoise) -> StereoNoise:
    """Noise that a filter assumes: None for the sensor's own, a standard deviation in px, or R as nested lists."""
    if given is None:
        return noise_of_sensor
    if np.ndim(given) == 0:
        return StereoNoise.independent_pixels(positive("noise", given))
    return StereoNoise(given)
