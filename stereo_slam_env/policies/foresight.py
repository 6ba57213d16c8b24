"""Predicted views from imagined camera poses, and the expected information gain of sequences of looks: pure maths.

A planner knows where landmarks are believed to be, the field of view, the route and the head. It does not know what
hides what.

Let e = p - r be a landmark seen from the camera, in the axes of W; its error
delta e = delta p - delta r + [e]x phi, with phi the error of the rotation in W, does not change when the camera makes a
*known* turn or step. A measurement from anywhere is H delta e with H = J R_cw (J: Eq. 10's Jacobian), so that

    S = H C H^T + R,    C = cov(delta e).                                                                  (Eq. 15)

The information matrix (inverse covariance) of pose and map is carried along, in the errors delta r, phi (rotation in W)
and delta p of `Knowledge`, positions taken relative to the camera as it is now. In these,

- a known motion changes nothing;
- its noise, of covariance Q on the pose, takes L, the columns of the pose, to L A, with A = (I + Q L_pose)^-1, and the
  information of the map down by L_map A Q L_map^T; that of steps without a look adds up;
- a look adds H^T R^-1 H of every landmark to its own block, and what follows from d e / d pose = [-I, [e]x] to the
  rest: a step costs 6 columns instead of the whole matrix.

Only at the end is the matrix put together, with the pose last, and one Cholesky factor of it has the answer to both
questions: all of its diagonal is the log-determinant of pose and map, the last six are that of the pose, whatever the
map is.

Landmarks that a sequence never looks at say nothing of the pose, and nothing of what one look gains: they are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from filters.contract.noise import StereoNoise
from filters.contract.stereo_filter import StereoFilter
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from filters.kernels.compilation import entry
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
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
        """Pose as arrays: position and rotation matrix."""
        return cls(pose.position, rotations.matrix(pose.orientation))

    @classmethod
    def of(cls, poses: Sequence[Pose]) -> CameraPoses:
        """Poses (Q,) as arrays: positions and rotation matrices."""
        orientations = np.stack([pose.orientation for pose in poses])
        return cls(np.stack([pose.position for pose in poses]), rotations.matrix(orientations))

    @property
    def flat(self) -> tuple[FloatArray, FloatArray]:
        """Both, with one leading dimension."""
        return self.positions.reshape(-1, 3), self.R_wc.reshape(-1, 3, 3)

    def __getitem__(self, index: Any) -> CameraPoses:
        """Some of them, by an index of their leading dimensions."""
        return CameraPoses(self.positions[index], self.R_wc[index])


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
    def of(cls, slam: StereoFilter, pose: Pose, ids: IntArray, points: FloatArray) -> Knowledge:
        """The current belief of a filter: its pose, and these landmarks of its map, at their places in W."""
        covariance = slam.joint_covariance(ids).copy()
        R_wc = rotations.matrix(pose.orientation)
        covariance[ROTATION] = R_wc @ covariance[ROTATION]
        covariance[:, ROTATION] = covariance[:, ROTATION] @ R_wc.T
        return cls(ids, pose, points, covariance)

    @property
    def by_pose(self) -> FloatArray:
        """d e / d (position, rotation), (N, 3, 6): [-I, [e]x]."""
        J = np.empty((len(self.points), 3, POSE_SIZE))
        J[:, :, POSITION] = -np.eye(3)
        J[:, :, ROTATION] = rotations.skew(self.points - self.pose.position)
        return J


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

    def in_view(self, points: FloatArray, cameras: CameraPoses) -> BoolArray:
        """Whether each of the points (N, 3) of W, m, is measured from each of the cameras (...); (..., N)."""
        positions, R_wc = cameras.flat
        in_view = np.empty((len(positions), len(points)), dtype=np.bool_)
        _mark_in_view(self._numbers, points, positions, R_wc, in_view)
        return in_view.reshape(*cameras.positions.shape[:-1], len(points))

    def information(self, points: FloatArray, cameras: CameraPoses) -> FloatArray:
        """H^T R^-1 H of each landmark in view, 0 of the others; (..., N, 3, 3) 1/m^2, in the axes of W.

        Where more are in view than are measured, each counts with the share of those that are.
        """
        positions, R_wc = cameras.flat
        in_view = self.in_view(points, CameraPoses(positions, R_wc))
        count = in_view.sum(axis=1)
        shares = np.ones(len(count)) if self.most is None else self.most / np.maximum(count, self.most)
        information = np.zeros((*in_view.shape, 3, 3))
        _put_information(self._numbers, self._R_inverse, shares, points, positions, R_wc, in_view, information)
        return information.reshape(*cameras.positions.shape[:-1], len(points), 3, 3)

    @cached_property
    def _R_inverse(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self.noise.R), dtype=np.float64)

    @cached_property
    def _numbers(self) -> Numbers:
        camera, margin = self.camera, self.margin
        sides = margin, camera.width - 1.0 - margin, camera.height - 1.0 - margin
        numbers = camera.fx, camera.fy, camera.cx, camera.cy, camera.disparity_constant, self.nearest, self.farthest
        return *map(float, numbers), *map(float, sides)


Numbers = tuple[float, ...]
"""fx, fy, cx, cy, f b, nearest and farthest depth, smallest u and v, largest u, largest v."""


@entry
def _mark_in_view(numbers: Numbers, points: FloatArray, r: FloatArray, R_wc: FloatArray, in_view: BoolArray) -> None:
    fx, fy, cx, cy, fb, nearest, farthest, low, high_u, high_v = numbers
    for c in range(len(r)):
        R = R_wc[c]
        for n in range(len(points)):
            in_view[c, n] = False
            x, y, z = points[n, 0] - r[c, 0], points[n, 1] - r[c, 1], points[n, 2] - r[c, 2]
            depth = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
            if depth > 0.0 and nearest <= depth <= farthest:
                u = fx * (R[0, 0] * x + R[1, 0] * y + R[2, 0] * z) / depth + cx
                v = fy * (R[0, 1] * x + R[1, 1] * y + R[2, 1] * z) / depth + cy
                u_right = u - fb / depth
                in_view[c, n] = low <= u <= high_u and low <= u_right <= high_u and low <= v <= high_v


@entry
def _put_information(
    numbers: Numbers,
    R_inverse: FloatArray,
    shares: FloatArray,
    points: FloatArray,
    r: FloatArray,
    R_wc: FloatArray,
    in_view: BoolArray,
    information: FloatArray,
) -> None:
    fx, fy, fb = numbers[0], numbers[1], numbers[4]
    H = np.empty((3, 3))
    for place in np.argwhere(in_view):
        c, n = place
        R, e = R_wc[c], points[n] - r[c]
        z = R[0, 2] * e[0] + R[1, 2] * e[1] + R[2, 2] * e[2]
        x_z = (R[0, 0] * e[0] + R[1, 0] * e[1] + R[2, 0] * e[2]) / z
        y_z = (R[0, 1] * e[0] + R[1, 1] * e[1] + R[2, 1] * e[2]) / z
        for a in range(3):  # J R_cw, by Eq. 10
            H[0, a], H[1, a] = fx / z * (R[a, 0] - x_z * R[a, 2]), fy / z * (R[a, 1] - y_z * R[a, 2])
            H[2, a] = -fb / (z * z) * R[a, 2]
        for i in range(3):
            for j in range(3):
                weight = shares[c] * R_inverse[i, j]
                for a in range(3):
                    for b in range(3):
                        information[c, n, a, b] += weight * H[i, a] * H[j, b]


def planned_bodies(bodies: CameraPoses, routes: Sequence[Route], done: Sequence[int], steps: int) -> CameraPoses:
    """Poses of Q cameras, looking straight ahead, after each of the next steps of their cars' routes; (Q, K = `steps`).

    The cars are believed to be at `bodies` (Q,) now, after `done` steps. Speeds and yaw rates are the route's; after
    its end a car stands still.
    """
    frames = [np.minimum(now + np.arange(steps + 1), route.frames - 1) for route, now in zip(routes, done, strict=True)]
    positions = np.stack([route.positions[which] for route, which in zip(routes, frames, strict=True)])
    attitudes = np.stack([route.attitudes[which] for route, which in zip(routes, frames, strict=True)])
    R = bodies.R_wc[:, None] @ attitudes[:, :1].transpose(0, 1, 3, 2)  # from the nominal drive to the believed one
    moved = (R @ (positions[:, 1:] - positions[:, :1])[..., None])[..., 0]
    return CameraPoses(bodies.positions[:, None] + moved, R @ attitudes[:, 1:])


def turning_head(head: Head, angles: FloatArray, targets: FloatArray, steps: int) -> FloatArray:
    """Pan and tilt after each step of turning from `angles` (..., 2) to each target (B, 2), rad; (..., B, K, 2)."""
    command = targets[:, None, :] / np.maximum(head.max_angles, np.finfo(float).tiny)
    times: FloatArray = FRAME_PERIOD * np.arange(1.0, steps + 1.0)
    return head.turned(angles[..., None, None, :], command, times[:, None])


def seen_from(head: Head, bodies: CameraPoses, angles: FloatArray) -> CameraPoses:
    """Cameras with the head turned to `angles` (..., 2), rad, on bodies (...), see `Head.camera_pose`."""
    R_bc, shift = _turned(head, angles)
    return CameraPoses(bodies.positions + (bodies.R_wc @ shift)[..., 0], bodies.R_wc @ R_bc)


def straight_ahead(head: Head, cameras: CameraPoses, angles: FloatArray) -> CameraPoses:
    """Bodies (...) under cameras with the head turned to `angles` (..., 2), rad, see `Head.body_pose`."""
    R_bc, shift = _turned(head, angles)
    R_wb = cameras.R_wc @ np.swapaxes(R_bc, -1, -2)
    return CameraPoses(cameras.positions - (R_wb @ shift)[..., 0], R_wb)


def _turned(head: Head, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R_bc (..., 3, 3) and the position (..., 3, 1), m, of a camera in the frame that it has straight ahead."""
    R_bc, middle = rotations.matrix(head_turn(angles)), np.array([[0.5 * head.baseline], [0.0], [0.0]])
    return R_bc, middle - R_bc @ middle


def places_beside(route: Route, farthest: float) -> FloatArray:
    """Places beside the route, at the height of the camera, in W, m; (P, 3).

    They go on straight ahead after the end of the route, as far as can be seen: `farthest` m.
    """
    station = np.arange(0.0, route.length + farthest, _SPACING)
    frame = np.minimum(np.searchsorted(route.arc_length, station), route.frames - 1)
    heading = route.headings[frame]
    ahead = np.stack([np.sin(heading), np.zeros_like(heading), np.cos(heading)], axis=1)
    across = np.stack([np.cos(heading), np.zeros_like(heading), -np.sin(heading)], axis=1)
    middle = route.positions[frame] + np.maximum(station - route.length, 0.0)[:, None] * ahead
    places: FloatArray = (middle[:, None] + farthest * _OFFSETS[:, None] * across[:, None]).reshape(-1, 3)
    return places


def discovered(places: FloatArray, sensor: SensorModel, cameras: CameraPoses) -> IntArray:
    """Number of the places (P, 3) in view of each of B sequences of K looks, (B, K) cameras; (B,)."""
    low, high = (end(cameras.positions.reshape(-1, 3), axis=0) for end in (np.min, np.max))
    near = places[((places >= low - sensor.reach) & (places <= high + sensor.reach)).all(axis=1)]
    count: IntArray = sensor.in_view(near, cameras).any(axis=-2).sum(axis=-1)
    return count


Gain = Literal["pose", "map"]
"""Covariance whose determinant counts: of the pose, or of the pose and the map together."""


def expected_gain(knowledge: Knowledge, looks: FloatArray, Q: FloatArray, gain: Gain) -> FloatArray:
    """0.5 log of prior over posterior determinant of the covariance after sequences of looks, (B,) nats.

    Prior is the covariance after the same motion without a look. Of pose and map together, one look gains the mutual
    information 0.5 logdet S - 0.5 logdet R of its measurements.

    `looks` (B, K, N, 3, 3) are H^T R^-1 H of each landmark in each of K looks of B sequences, see
    `SensorModel.information`; `Q` (K, 6, 6) is the noise that the motion before each look adds to the pose, see
    `motion_noise`. An `ArithmeticError` where the covariance is not positive definite.
    """
    gains = np.zeros(len(looks))
    try:
        _put_gains(knowledge.covariance, knowledge.by_pose, looks, Q, gain == "pose", gains)
    except np.linalg.LinAlgError:
        raise ArithmeticError(
            "joint_covariance() of the filter must be positive definite, and is not: no gain can be expected"
        ) from None
    return gains


def motion_noise(middles: FloatArray, sigma_position: float, sigma_rotation: float) -> FloatArray:
    """Noise that a step of dead reckoning adds to the pose, in errors that a known motion does not change; (..., 6, 6).

    These are delta r + [r]x phi and phi, with r the position: an error of the turn turns the camera about the middle of
    the step, as in `filters.VelocityDriven`, and so acts on the first by the lever that this is from the origin.
    `middles` (..., 3) are r half-way through the step, from the camera as it is now, m; the standard deviations are of
    each axis, m and rad.
    """
    G = np.zeros((*middles.shape[:-1], POSE_SIZE, POSE_SIZE))
    G[..., POSITION, POSITION] = sigma_position * np.eye(3)
    G[..., POSITION, ROTATION] = sigma_rotation * rotations.skew(middles)
    G[..., ROTATION, ROTATION] = sigma_rotation * np.eye(3)
    Q: FloatArray = G @ np.swapaxes(G, -1, -2)
    return Q


@entry
def _put_gains(
    covariance: FloatArray, by_pose: FloatArray, looks: FloatArray, Q: FloatArray, of_pose: bool, gains: FloatArray
) -> None:
    sequences, steps, count = looks.shape[:3]
    for s in range(sequences):
        is_seen = np.empty((steps, count), dtype=np.bool_)
        needed = np.full(count, not of_pose and steps > 1)
        for k in range(steps):
            for i in range(count):
                is_seen[k, i] = looks[s, k, i, 0, 0] + looks[s, k, i, 1, 1] + looks[s, k, i, 2, 2] > 0.0
                needed[i] |= is_seen[k, i]
        index, place = np.flatnonzero(needed), 3 * (np.cumsum(needed) - 1)
        rows = 3 * len(index)
        if rows == 0:
            continue
        C, noise = _part(covariance, index), np.zeros((POSE_SIZE, POSE_SIZE))
        L = np.linalg.inv(C)
        L_xm, L_x = L[:POSE_SIZE, POSE_SIZE:].copy(), L[:POSE_SIZE, :POSE_SIZE].copy()
        before, lost, used = np.empty((steps * POSE_SIZE, rows)), np.empty((steps * POSE_SIZE, rows)), 0
        for k in range(steps):
            noise += Q[k]
            C[:POSE_SIZE, :POSE_SIZE] += Q[k]
            if k < steps - 1 and not is_seen[k].any():
                continue
            A = np.linalg.inv(np.eye(POSE_SIZE) + np.dot(noise, L_x))
            before[used : used + POSE_SIZE] = L_xm
            lost[used : used + POSE_SIZE] = np.dot(np.dot(noise, A.T), L_xm)
            L_xm, L_x, used = np.dot(A.T, L_xm), np.dot(L_x, A), used + POSE_SIZE
            noise[:] = 0.0
            for n in np.flatnonzero(is_seen[k]):
                WB = np.dot(looks[s, k, n], by_pose[n])
                for a in range(3):
                    for b in range(3):
                        L[POSE_SIZE + place[n] + a, POSE_SIZE + place[n] + b] += looks[s, k, n, a, b]
                    for j in range(POSE_SIZE):
                        L_xm[j, place[n] + a] += WB[a, j]
                L_x += np.dot(by_pose[n].T, WB)
        information = np.empty((rows + POSE_SIZE, rows + POSE_SIZE))
        information[:rows, :rows] = L[POSE_SIZE:, POSE_SIZE:] - np.dot(before[:used].T, lost[:used])
        information[:rows, rows:], information[rows:, :rows], information[rows:, rows:] = L_xm.T, L_xm, L_x
        first = rows if of_pose else 0
        prior = C[:POSE_SIZE, :POSE_SIZE].copy() if of_pose else C
        gains[s] = (
            np.log(np.diag(np.linalg.cholesky(information))[first:]).sum()
            + np.log(np.diag(np.linalg.cholesky(prior))).sum()
        )


@entry
def _part(covariance: FloatArray, index: IntArray) -> FloatArray:
    """Covariance of the pose and of the landmarks at `index` (M,); (6 + 3 M, 6 + 3 M)."""
    rows = np.arange(POSE_SIZE + 3 * len(index))
    for m, i in enumerate(index):
        for a in range(3):
            rows[POSE_SIZE + 3 * m + a] = POSE_SIZE + 3 * i + a
    part = np.empty((len(rows), len(rows)))
    for i, row in enumerate(rows):
        for j, column in enumerate(rows):
            part[i, j] = covariance[row, column]
    return part
