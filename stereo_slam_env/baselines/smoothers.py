"""Smoothing with GTSAM as filters: a window of poses and its landmarks solved every frame, or all of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from filters import BodyVelocity, CameraState, InertialSamples, StereoCamera, StereoNoise
from filters.contract.validation import positive, whole_number
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.motions.motion_model import CAMERA_SIZE, POSE_SIZE
from stereo_slam_env.baselines.camera_alone import CameraBelief, symmetrised
from stereo_slam_env.baselines.guided_smoother import GuidedSmoother
from stereo_slam_env.baselines.smoothing_graph import Sightings, Smoothed, SmoothingGraph


class FixedLagSmoother(GuidedSmoother):
    """Fixed-lag smoothing by GTSAM: the last `lag` poses and what they see, solved again every frame.

    Poses older than that, and landmarks not seen since, are marginalised at the values they have then. Pose, velocity
    and their covariance are those of the window, not of the guide. Needs the extra `gtsam`.

    Parameters
    ----------
    camera, noise, **options
        See `GuidedSmoother`.
    lag : int
        Poses before the present one that stay in the window, 2 or more: the motion factors tie three.

    Raises
    ------
    ValueError
        gtsam is not installed, or an option has an impossible value.

    References
    ----------
    GTSAM, https://gtsam.org.
    """

    _graph: FixedLagGraph

    def __init__(self, camera: StereoCamera, noise: StereoNoise, *, lag: int = 10, **options: Any) -> None:
        self._lag = whole_number("lag", lag, 2)
        super().__init__(camera, noise, **options)

    def _new_graph(self, start: CameraState, P: FloatArray) -> FixedLagGraph:
        return FixedLagGraph(self.camera, start, P, self._tail_dof, self._lag)

    def _finish(self, believed: bool) -> None:
        self._located = {
            i: located for i, located in self._located.items() if located[0] >= self._graph.last - self._lag
        }
        if believed and self._graph.last:
            self._solve()
            self._belief = CameraBelief(self._graph.state(), self._graph.covariance())


class FixedLagGraph(SmoothingGraph):
    """Factors and values of a window of poses and the landmarks that they see.

    What leaves the window stays as a linear factor on the rest. GTSAM's own `BatchFixedLagSmoother` would hold every
    variable of that factor where it was then: a landmark that is 30 % off in depth from far away, and in view for a
    hundred frames more, is linearised there for ever, until the system is singular.
    """

    def __init__(
        self, camera: StereoCamera, start: CameraState, P: FloatArray, tail_dof: float | None, lag: int
    ) -> None:
        self._lag = lag
        self._last_seen: dict[int, int] = {}  # by key of a landmark, number of the pose
        self._first = 0  # pose of the window
        super().__init__(camera, start, P, tail_dof)

    def __deepcopy__(self, memo: dict[int, Any]) -> FixedLagGraph:
        twin = super().__deepcopy__(memo)
        twin._last_seen = dict(self._last_seen)
        return twin

    def add_sightings(self, seen: Sightings, located: Mapping[int, tuple[int, FloatArray]]) -> Sightings:
        """Add what the full graph adds; what has waited until its pose left the window is dropped."""
        return super().add_sightings(seen.select(seen.pose >= self.last - self._lag), located)

    def solve(self) -> None:
        """Solve the window, then marginalise what leaves it."""
        super().solve()
        first = self.last - self._lag
        expired = {key for key, pose in self._last_seen.items() if pose < first}
        self._last_seen = {key: pose for key, pose in self._last_seen.items() if key not in expired}
        self._keys = {track: key for track, key in self._keys.items() if key not in expired}
        expired |= {key for key in map(self._pose_key, range(self._first, first)) if self._values.exists(key)}
        self._first = max(first, self._first)
        if expired:
            self._marginalise(expired)

    def covariance(self) -> FloatArray:
        """Covariance (12, 12) of the present state, whose velocity is that of the last move."""
        keys = [self._pose_key(self.last - 1), self._pose_key(self.last)]
        J = self.last_move_jacobian()
        try:
            P = self._gtsam.Marginals(self._factors, self._values).jointMarginalCovariance(keys).fullMatrix()
        except RuntimeError:  # too badly conditioned for its Cholesky, as by a step of 10 s beside one of 1 ms
            P = self._covariance_by_qr(keys)
        return symmetrised(J @ P @ J.T)

    def _covariance_by_qr(self, keys: Sequence[int]) -> FloatArray:
        """Joint covariance (12, 12) of two poses, without the squares of the Jacobian; ten times as slow."""
        gtsam, ordering = self._gtsam, self._gtsam.Ordering()
        for key in set(map(int, self._values.keys())).difference(keys):
            ordering.push_back(key)
        joint_factor = gtsam.JacobianFactor(self._factors.linearize(self._values))
        _, remainder = joint_factor.eliminate(ordering)
        order = gtsam.Ordering()
        for key in keys:
            order.push_back(key)
        A = gtsam.GaussianFactorGraph()
        A.push_back(remainder)
        R = np.linalg.qr(A.jacobian(order)[0], mode="r")
        inverse = np.linalg.pinv(R)
        return np.asarray(inverse @ inverse.T, dtype=np.float64)

    def _marginalise(self, gone: set[int]) -> None:
        """Replace the factors on variables by what they say of the others, linear at the present values (by QR)."""
        gtsam, stay, leave = self._gtsam, self._gtsam.NonlinearFactorGraph(), self._gtsam.NonlinearFactorGraph()
        for i in range(self._factors.size()):
            factor = self._factors.at(i)
            (stay if gone.isdisjoint(factor.keys()) else leave).push_back(factor)
        ordering, at = gtsam.Ordering(), gtsam.Values()
        for key in sorted(gone):
            ordering.push_back(key)
        _, marginal = gtsam.JacobianFactor(leave.linearize(self._values)).eliminate(ordering)
        rest = marginal.keys()
        for key in rest:
            at.insert(key, self._values.atPoint3(key) if key in self._last_seen else self._values.atPose3(key))
        stay.push_back(gtsam.LinearContainerFactor(marginal, at))
        self._factors = stay
        for key in gone:
            self._values.erase(key)

    def _add_sighting(self, key: int, pose: int, uvd: FloatArray, R: FloatArray) -> None:
        super()._add_sighting(key, pose, uvd, R)
        self._last_seen[key] = max(pose, self._last_seen.get(key, 0))


class BatchSmoother(GuidedSmoother):
    """Full smoothing of all poses and landmarks by GTSAM, with stereo and motion factors.

    Nothing is ever marginalised. Everything is solved again whenever the drive has grown by a tenth (`growth`); in
    between the guide carries on from there. Uncertainties are those of the guide. `smooth()` solves now and gives all
    poses. Needs the extra `gtsam`.

    Parameters
    ----------
    camera, noise, **options
        See `GuidedSmoother`.
    growth : float
        Share by which the drive grows from one solution to the next; infinity leaves it to `smooth()`, which on a long
        drive may then end in a false minimum (see `Smoothed.degrees_of_freedom`).

    Raises
    ------
    ValueError
        gtsam is not installed, or an option has an impossible value.
    """

    def __init__(self, camera: StereoCamera, noise: StereoNoise, *, growth: float = 0.1, **options: Any) -> None:
        self._growth = math.inf if growth == math.inf else positive("growth", growth)
        super().__init__(camera, noise, **options)

    def _new_graph(self, start: CameraState, P: FloatArray) -> SmoothingGraph:
        self._next_solution = 1.0
        return SmoothingGraph(self.camera, start, P, self._tail_dof)

    def smooth(self) -> Smoothed:
        """Solve now; all poses given all measurements so far."""
        self._solve()
        return self._graph.smoothed()

    def predict(self, dt: float, odometry: BodyVelocity | None = None, inertial: InertialSamples | None = None) -> None:
        """Move the guide forward; the step enters the graph with the next frame."""
        super().predict(dt, odometry, inertial)
        self._follow_guide()

    def _finish(self, believed: bool) -> None:
        if believed and self._graph.last >= self._next_solution:
            self._solve()
            self._next_solution = self._graph.last * (1.0 + self._growth)
        self._follow_guide()

    def _follow_guide(self) -> None:
        """The guide's belief, in the world of the graph."""
        pose, velocity = self._guide.pose, self._guide.velocity
        state = CameraState(
            self._turn @ pose.position + self._shift,
            rotations.multiply(rotations.exp_quaternion(rotations.log(self._turn)), pose.orientation),
            self._turn @ velocity.linear,
            velocity.angular,
        )
        P = np.zeros((CAMERA_SIZE, CAMERA_SIZE))
        for first, covariance in ((0, pose.covariance), (POSE_SIZE, velocity.covariance)):
            turned = covariance.copy()
            turned[:3] = self._turn @ turned[:3]
            turned[:, :3] = turned[:, :3] @ self._turn.T
            P[first : first + 6, first : first + 6] = 0.5 * (turned + turned.T)
        self._belief = CameraBelief(state, P)
