"""Full smoothing with GTSAM as a filter: what the data allow, for those who compare with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from filters import rotations
from filters.camera import StereoCamera
from filters.interface import BodyVelocity, Forecast, LandmarkBelief, StereoObservation, UpdateReport
from filters.motion import CAMERA_SIZE, POSE_SIZE, CameraState, MotionModel, VelocityDriven
from filters.noise import StereoNoise
from filters.validation import BoolArray, FloatArray, IntArray, unique_ids
from stereo_slam_env.baselines.camera_filter import CameraBelief, CameraFilter
from stereo_slam_env.baselines.smoothing_graph import Move, Smoothed, SmoothingGraph, load_gtsam

# A landmark enters the graph with its first disparity of so many standard deviations, and then with all its
# measurements: a point that may lie at infinity has no XYZ to linearise at.
SIGMAS_TO_ENTER = 3.0


@dataclass(frozen=True, eq=False)
class _Waiting:
    """One measurement of a landmark that is not yet in the graph, as arrays of length 1."""

    pose: IntArray
    id: IntArray
    uvd: FloatArray
    R: FloatArray


class BatchSmoother(CameraFilter):
    """Full smoothing of all poses and landmarks by GTSAM (iSAM2), with stereo and motion factors.

    Nothing is ever marginalised: `pose` is the last pose given everything so far, and `smooth()` gives all of them. A
    landmark enters once its depth is known to a third; until then its measurements wait, reported as rejected. The map
    that it shows (`landmarks`, `forecast`) is that of the last frame. Needs the extra `gtsam`.

    Parameters
    ----------
    camera, noise, motion
        See `CameraFilter`; odometry, where given, is a further factor beside `motion`.
    gate : float or None
        Probability with which a consistent measurement of a known landmark is used; None: all are. The track of a gated
        one starts a new landmark when it is next seen.
    right_row : bool
        Whether a row measured in the right image (`v_right`) is used, as a second measurement of v.

    Raises
    ------
    ValueError
        gtsam is not installed, or an option has an impossible value.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        motion: MotionModel | None = None,
        gate: float | None = 0.99,
        right_row: bool = True,
    ) -> None:
        if gate is not None and not (isinstance(gate, float | int) and 0.0 < gate < 1.0):
            raise ValueError(f"gate must be a probability between 0 and 1, or None for no gate, got {gate!r}")
        if not isinstance(right_row, bool):
            raise ValueError(f"right_row must be True or False, got {right_row!r}")
        load_gtsam()
        self._gate = gate
        self._right_row = right_row
        super().__init__(camera, noise, motion=motion)

    def _restart(self) -> None:
        self._graph = SmoothingGraph(self.camera, self._belief.state, self._belief.P)
        self._keys: dict[int, int] = {}
        self._waiting: dict[int, list[_Waiting]] = {}
        self._shown = np.zeros(0, dtype=np.int64)
        self._moves: list[Move] = []
        self._solved = self._belief
        self._joint: FloatArray | None = None

    def smooth(self) -> Smoothed:
        """All poses given all measurements so far; changes nothing in the filter."""
        return self._graph.smooth()

    def predict(self, dt: float, odometry: BodyVelocity | None = None) -> None:
        """Move the belief forward; the step enters the graph with the next frame."""
        before = self._belief.state
        super().predict(dt, odometry)
        models = [self._motion] if odometry is None else [self._motion, VelocityDriven()]
        self._moves.append(Move(before, float(dt), tuple(m.predict(before, dt, odometry) for m in models)))

    def _use(self, observation: StereoObservation) -> UpdateReport:
        """Add the frame to the graph and solve."""
        if len(observation) == 0:
            dropped, self._shown = self._shown, observation.ids
            return UpdateReport(dropped=dropped)
        uvd, R = self._measurements(observation)
        ids = observation.ids
        known = np.array([i in self._keys for i in ids.tolist()], dtype=bool)
        in_front, passed = self._judged(self._keys_of(ids[known]), uvd[known], R[known])
        behind, gated = ids[known][~in_front], ids[known][in_front & ~passed]
        updated = np.isin(ids, ids[known][in_front & passed])
        new = ~known & (uvd[:, 2] >= SIGMAS_TO_ENTER * np.sqrt(R[:, 2, 2]))
        waits = ~known & ~new
        for move in self._moves:
            self._graph.add_move(move)
        keys = self._graph.add_landmarks(*self._first_guess(uvd[new], R[new]))
        for lost in (*behind.tolist(), *gated.tolist()):
            del self._keys[lost]
        self._keys.update(zip(ids[new].tolist(), keys.tolist(), strict=True))
        used = updated | new
        now = np.full(len(ids), self._graph.last)
        self._graph.add_sightings(now[used], self._keys_of(ids[used]), uvd[used], R[used])
        for i in ids[new].tolist():
            for earlier in self._waiting.pop(i, ()):
                self._graph.add_sightings(earlier.pose, self._keys_of(earlier.id), earlier.uvd, earlier.R)
        for row in np.flatnonzero(waits):
            own = slice(row, row + 1)
            self._waiting.setdefault(int(ids[row]), []).append(_Waiting(now[own], ids[own], uvd[own], R[own]))
        self._graph.solve()
        dropped = np.setdiff1d(self._shown, ids[used])
        self._shown = ids[used]
        self._settle()
        return UpdateReport(
            updated=ids[updated],
            initialised=ids[new],
            dropped=dropped,
            gated=gated,
            rejected=ids[waits],
            behind_camera=behind,
        )

    def _settle(self) -> None:
        """Take the belief from the graph."""
        moved = self._graph.last > 0
        state, P = self._graph.state(), self._graph.covariance(np.zeros(0, dtype=np.int64))
        if not moved:
            start = self._belief
            state = CameraState(
                state.position, state.orientation, start.state.linear_velocity, start.state.angular_velocity
            )
            whole = np.zeros((CAMERA_SIZE, CAMERA_SIZE))
            whole[:POSE_SIZE, :POSE_SIZE] = P
            whole[POSE_SIZE:, POSE_SIZE:] = start.P[POSE_SIZE:, POSE_SIZE:]
            P = whole
        self._belief = self._solved = CameraBelief(state, P)
        self._moves = []
        self._joint = None

    def _measurements(self, observation: StereoObservation) -> tuple[FloatArray, FloatArray]:
        """(u, v, d) and R, with v the mean of both eyes' rows where the right one was measured too."""
        uvd, R = observation.uvd, observation.covariances(self.noise)
        if observation.v_right is None or not self._right_row:
            return uvd, R
        averaged = uvd.copy()
        averaged[:, 1] = 0.5 * (uvd[:, 1] + observation.v_right)
        half = np.diag([1.0, 0.5, 1.0])
        R_averaged = half @ R @ half
        R_averaged[:, 1, 1] += 0.25 * R[:, 1, 1]
        return averaged, R_averaged

    def _first_guess(self, uvd: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (M, 3) m in W to start from and their distances, on the near side of what was measured.

        A start beyond twice the true depth is thrown behind the camera by the first Gauss-Newton step; from the near
        side it comes out safely.
        """
        near = uvd.copy()
        near[:, 2] = np.maximum(uvd[:, 2], 0.0) + np.sqrt(R[:, 2, 2])
        state = self._belief.state
        p_c = self.camera.backproject(near)
        return state.position + p_c @ state.R_wc.T, np.linalg.norm(p_c, axis=1)

    def _judged(self, keys: IntArray, uvd: FloatArray, R: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Which known landmarks are in front of the predicted camera, and which measurements pass the gate.

        The gate's S counts the step since the last frame, this measurement, and as much again for the landmark, which
        has been measured from there at least once.
        """
        state = self._belief.state
        p_c = (self._graph.points(keys) - state.position) @ state.R_wc
        in_front = p_c[:, 2] > 0.0
        if self._gate is None or len(keys) == 0:
            return in_front, np.ones(len(keys), dtype=bool)
        P = self._solved.P.copy()
        P[:POSE_SIZE], P[:, :POSE_SIZE] = 0.0, 0.0
        for move in self._moves:
            step = move.predictions[-1]
            P = step.F @ P @ step.F.T + step.G @ step.Q @ step.G.T
        H = self._by_pose(p_c)
        S = H @ P[:POSE_SIZE, :POSE_SIZE] @ H.transpose(0, 2, 1) + 2.0 * R
        with np.errstate(invalid="ignore"):
            nu = uvd - self.camera.project(p_c)
        distances = np.einsum("mi,mi->m", nu, np.linalg.solve(S, nu[:, :, None])[:, :, 0])
        return in_front, distances <= chi2.ppf(self._gate, 3)

    def _by_pose(self, p_c: FloatArray) -> FloatArray:
        """d(u, v, d) / d(pose error), (M, 3, 6), of points (M, 3) m in the camera."""
        J = self.camera.project_jacobian(p_c)
        return np.concatenate([-J @ self._belief.state.R_wc.T, J @ rotations.skew(p_c)], axis=2)

    def _keys_of(self, ids: IntArray) -> IntArray:
        return np.array([self._keys[i] for i in ids.tolist()], dtype=np.int64)

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Start these landmarks anew when they are next seen; what they have told stays."""
        gone = unique_ids("ids", np.asarray(ids))
        for lost in gone.tolist():
            self._keys.pop(lost, None)
            self._waiting.pop(lost, None)
        self._shown = np.setdiff1d(self._shown, gone)
        self._joint = None

    def forecast(self, ids: Sequence[int] | IntArray | None = None) -> Forecast:
        """Predicted (u, v, d) and S of landmarks of the last frame."""
        wanted = self._shown if ids is None else unique_ids("ids", np.asarray(ids))
        if not np.isin(wanted, self._shown).all():
            unknown = np.setdiff1d(wanted, self._shown)[:5].tolist()
            raise ValueError(f"ids must be in the map, not there: {unknown}: see landmarks.ids")
        place = np.searchsorted(self._shown, wanted)
        points, P = self._map()
        state = self._belief.state
        p_c = (points[place] - state.position) @ state.R_wc
        H = np.concatenate([self._by_pose(p_c), self.camera.project_jacobian(p_c) @ state.R_wc.T], axis=2)
        S = H @ _blocks(P, place) @ H.transpose(0, 2, 1) + self.noise.R
        uvd = self.camera.project(p_c)
        in_view: BoolArray = (p_c[:, 2] > 0.0) & self.camera.in_view(uvd)
        return Forecast(wanted, uvd, 0.5 * (S + S.transpose(0, 2, 1)), in_view)

    @property
    def landmarks(self) -> LandmarkBelief:
        """The landmarks of the last frame."""
        points, P = self._map()
        blocks = _blocks(P, np.arange(len(points)))
        rays = points - self._belief.state.position
        inverse = 1.0 / np.linalg.norm(rays, axis=1)
        by_point = -rays * inverse[:, None] ** 3
        J = np.concatenate([-by_point, np.zeros_like(rays), by_point], axis=1)
        variance = np.einsum("mi,mij,mj->m", J, blocks, J)
        covariances = blocks[:, POSE_SIZE:, POSE_SIZE:].copy()
        return LandmarkBelief(self._shown.copy(), points, covariances, inverse, np.maximum(variance, 0.0))

    def _map(self) -> tuple[FloatArray, FloatArray]:
        """Points (N, 3) m in W of the last frame, and the joint covariance of camera (12) and points (3 N) by now."""
        keys = self._keys_of(self._shown)
        if len(keys) == 0:
            return np.zeros((0, 3)), self._belief.P
        if self._joint is None:
            joint = self._graph.covariance(keys)
            if self._graph.last == 0:
                whole = np.zeros((len(joint) + POSE_SIZE,) * 2)
                rows = np.r_[:POSE_SIZE, CAMERA_SIZE : len(whole)]
                whole[np.ix_(rows, rows)] = joint
                joint = whole
            self._joint = joint
        P = self._joint.copy()
        for move in self._moves:
            P[:CAMERA_SIZE] = move.predictions[-1].F @ P[:CAMERA_SIZE]
        P[CAMERA_SIZE:, :CAMERA_SIZE] = P[:CAMERA_SIZE, CAMERA_SIZE:].T
        P[:CAMERA_SIZE, :CAMERA_SIZE] = self._belief.P
        return self._graph.points(keys), P


def _blocks(P: FloatArray, place: IntArray) -> FloatArray:
    """Covariance (M, 9, 9) of the pose and each of the landmarks at `place`."""
    own = CAMERA_SIZE + 3 * place[:, None] + np.arange(3)
    rows = np.concatenate([np.broadcast_to(np.arange(POSE_SIZE), (len(place), POSE_SIZE)), own], axis=1)
    blocks: FloatArray = P[rows[:, :, None], rows[:, None, :]]
    return blocks
