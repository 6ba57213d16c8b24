"""Predicted views from imagined camera poses, and their information: pure maths, many poses at once.

A planner knows where landmarks are believed to be, the field of view, the route and the head. It does not know what
hides what.

Let e = p - r be a landmark seen from the camera, in the axes of W; its error
delta e = delta p - delta r + [e]x phi, with phi the error of the rotation in W, does not change when the camera makes a
*known* turn or step. A measurement from anywhere is H delta e with H = J R_cw (J: Eq. 10's Jacobian), so that

    S = H C H^T + R,    C = cov(delta e).                                                                  (Eq. 15)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from filters.contract.noise import StereoNoise
from filters.contract.stereo_filter import StereoFilter
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from filters.motions.model import POSE_SIZE, POSITION, ROTATION
from stereo_slam_env.world.routes import FRAME_PERIOD, Route
from stereo_slam_env.world.vehicle import Head, head_turn

_SPACING = 3.0
"""Distance of places along the route, m."""
_OFFSETS = np.array([-0.75, -0.5, -0.25, 0.25, 0.5, 0.75])
"""Places across the route, in shares of the farthest depth at which landmarks are measured."""


@dataclass(frozen=True, eq=False)
class CameraPoses:
    """Poses of the left camera in W with any leading dimensions: positions (..., 3), m, and R_wc (..., 3, 3)."""

    positions: FloatArray
    R_wc: FloatArray

    @classmethod
    def at(cls, pose: Pose) -> CameraPoses:
        """One pose, or many with the same leading dimensions in both of its fields."""
        return cls(pose.position, rotations.matrix(pose.orientation))

    def to_camera(self, points_w: FloatArray) -> FloatArray:
        """Points (N, 3) of W in each camera frame; (..., N, 3) m."""
        points_c: FloatArray = (points_w - self.positions[..., None, :]) @ self.R_wc
        return points_c


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Belief of a filter: the pose of the left camera and N landmarks, `points` (N, 3) in W, m.

    `covariance` (6 + 3 N, 6 + 3 N) is of the errors of the position (W, m), of the rotation (**in the axes of W**, rad)
    and of `points` (m).
    """

    ids: IntArray
    pose: Pose
    points: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, slam: StereoFilter, within: float = np.inf) -> Knowledge:
        """The current belief, with the landmarks `within` m of the camera that have a finite position."""
        belief, landmarks = slam.pose, slam.landmarks
        with np.errstate(invalid="ignore"):
            near = np.linalg.norm(landmarks.positions - belief.position, axis=1) <= within
        near &= np.isfinite(landmarks.positions).all(axis=1) & np.isfinite(landmarks.covariances).all(axis=(1, 2))
        near &= landmarks.inverse_distance > 0.0
        ids = landmarks.ids[near]
        covariance = slam.joint_covariance(ids).copy()
        R_wc = rotations.matrix(belief.orientation)
        covariance[ROTATION] = R_wc @ covariance[ROTATION]
        covariance[:, ROTATION] = covariance[:, ROTATION] @ R_wc.T
        return cls(ids, Pose(belief.position, belief.orientation), landmarks.positions[near], covariance)

    def of_landmarks(self, index: IntArray) -> Knowledge:
        """The same, with the landmarks at `index` (M,) only."""
        rows = np.concatenate([np.arange(POSE_SIZE), (POSE_SIZE + 3 * index[:, None] + np.arange(3)).ravel()])
        return Knowledge(self.ids[index], self.pose, self.points[index], self.covariance[np.ix_(rows, rows)])

    @property
    def by_pose(self) -> FloatArray:
        """d e / d (position, rotation), (N, 3, 6): [-I, [e]x]."""
        J = np.empty((len(self.points), 3, POSE_SIZE))
        J[:, :, POSITION] = -np.eye(3)
        J[:, :, ROTATION] = rotations.skew(self.points - self.pose.position)
        return J


class Sight(NamedTuple):
    """Predicted (u, v, d), px (..., N, 3); whether they are in view (..., N); points in each camera, m (..., N, 3)."""

    uvd: FloatArray
    in_view: BoolArray
    points_c: FloatArray


@dataclass(frozen=True)
class SensorModel:
    """The stereo sensor as a planner knows it: the rig, and R of (u, v, d).

    It measures landmarks at depths z from `nearest` to `farthest`, m, that are `margin` px inside both images, and at
    most `most` of them in one frame (None: all in view).
    """

    camera: StereoCamera
    noise: StereoNoise
    nearest: float = 0.0
    farthest: float = np.inf
    margin: float = 0.0
    most: int | None = None

    @cached_property
    def reach(self) -> float:
        """Largest distance of a landmark in view, m: that of the farthest depth at the corner of the image."""
        camera = self.camera
        corners = camera.ray([[u, v] for u in (0.0, camera.width - 1.0) for v in (0.0, camera.height - 1.0)])
        return self.farthest * float(np.linalg.norm(corners, axis=1).max())

    @cached_property
    def _whitening(self) -> FloatArray:
        """L^-1 with R = L L^T."""
        whitening: FloatArray = np.linalg.inv(np.linalg.cholesky(self.noise.R))
        return whitening

    def sight(self, points: FloatArray, cameras: CameraPoses) -> Sight:
        """Predicted view of the points (N, 3) of W, m, from each of the cameras."""
        points_c = cameras.to_camera(points)
        z = points_c[..., 2]
        uvd = self.camera.project(points_c)
        with np.errstate(invalid="ignore"):  # a point beside the camera has no image
            in_view = (z > 0.0) & (z >= self.nearest) & (z <= self.farthest) & self.camera.in_view(uvd, self.margin)
        return Sight(uvd, in_view, points_c)

    def information(self, points: FloatArray, cameras: CameraPoses) -> FloatArray:
        """H^T R^-1 H of each landmark in view, 0 of the others; (..., N, 3, 3) 1/m^2, in the axes of W.

        Where more are in view than are measured, each counts with the share of those that are.
        """
        sight = self.sight(points, cameras)
        seen = np.nonzero(sight.in_view)
        J = self.camera.project_jacobian(sight.points_c[seen])
        R_wc = np.broadcast_to(cameras.R_wc[..., None, :, :], (*sight.in_view.shape, 3, 3))[seen]
        H = self._whitening @ J @ R_wc.transpose(0, 2, 1)
        information = np.zeros((*sight.in_view.shape, 3, 3))
        information[seen] = H.transpose(0, 2, 1) @ H
        if self.most is not None:
            count = sight.in_view.sum(axis=-1)
            information *= (self.most / np.maximum(count, self.most))[..., None, None, None]
        return information


def planned_bodies(body: Pose, route: Route, step: int, steps: int) -> CameraPoses:
    """Poses of the camera, looking straight ahead, after each of the next steps of the car's route; K = `steps`.

    The car is believed to be at `body` now, after `step` steps. Speeds and yaw rates are the route's; after its end the
    car stands still.
    """
    frames = np.minimum(step + np.arange(1, steps + 1), route.frames - 1)
    now = min(step, route.frames - 1)
    R_wb = rotations.matrix(body.orientation)
    heading = np.zeros((steps, 3))
    heading[:, 1] = route.headings[frames] - route.headings[now]
    R_bw_nominal = rotations.exp(np.array([0.0, -route.headings[now], 0.0]))
    moved = (route.positions[frames] - route.positions[now]) @ R_bw_nominal.T
    return CameraPoses(body.position + moved @ R_wb.T, R_wb @ rotations.exp(heading))


def turning_head(head: Head, angles: FloatArray, targets: FloatArray, steps: int) -> FloatArray:
    """Pan and tilt after each step of turning from `angles` (2,) to each of the targets (B, 2), rad; (B, K, 2)."""
    command = targets[:, None, :] / np.maximum(head.max_angles, np.finfo(float).tiny)
    times: FloatArray = FRAME_PERIOD * np.arange(1.0, steps + 1.0)
    return head.turned(angles, command, times[:, None])


def seen_from(head: Head, bodies: CameraPoses, angles: FloatArray) -> CameraPoses:
    """Cameras with the head turned to `angles` (..., K, 2), rad, on bodies (K,), see `Head.camera_pose`."""
    R_bc = rotations.matrix(head_turn(angles))
    middle = np.array([0.5 * head.baseline, 0.0, 0.0])
    shift = middle - R_bc @ middle
    return CameraPoses(bodies.positions + (bodies.R_wc @ shift[..., None])[..., 0], bodies.R_wc @ R_bc)


class UnseenPlaces:
    """Places beside the route, at the height of the camera, that have not been in view of `sensor` so far.

    They go on straight ahead after the end of the route, as far as can be seen.
    """

    def __init__(self, route: Route, sensor: SensorModel) -> None:
        self._sensor = replace(sensor, most=None)
        station = np.arange(0.0, route.length + sensor.farthest, _SPACING)
        frame = np.minimum(np.searchsorted(route.arc_length, station), route.frames - 1)
        heading = route.headings[frame]
        ahead = np.stack([np.sin(heading), np.zeros_like(heading), np.cos(heading)], axis=1)
        across = np.stack([np.cos(heading), np.zeros_like(heading), -np.sin(heading)], axis=1)
        middle = route.positions[frame] + np.maximum(station - route.length, 0.0)[:, None] * ahead
        self._points = (middle[:, None] + sensor.farthest * _OFFSETS[:, None] * across[:, None]).reshape(-1, 3)

    def __len__(self) -> int:
        return len(self._points)

    def look(self, cameras: CameraPoses) -> None:
        """Remove the places in view of a camera."""
        in_view = self._sensor.sight(self._points, cameras).in_view.reshape(-1, len(self._points))
        self._points = self._points[~in_view.any(axis=0)]

    def discovered(self, cameras: CameraPoses) -> IntArray:
        """Number of places in view of each of B sequences of K looks, (B, K) cameras; (B,)."""
        low, high = (end(cameras.positions.reshape(-1, 3), axis=0) for end in (np.min, np.max))
        reach = self._sensor.reach
        near = self._points[((self._points >= low - reach) & (self._points <= high + reach)).all(axis=1)]
        discovered: IntArray = self._sensor.sight(near, cameras).in_view.any(axis=-2).sum(axis=-1)
        return discovered
