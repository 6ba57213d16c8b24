"""Multi-state constraint filter of stereo tracks (Mourikis and Roumeliotis 2007), with some landmarks in the map.

A track is used once, when it ends or when it fills the window: its landmark is found by Gauss-Newton at the clones, and
what the track says of the clones alone, in the null space of the landmark's Jacobian, corrects them. Where there is
room, landmarks are in the map instead (Li and Mourikis 2013). Derivation: docs/derivations/window.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr_multiply
from scipy.special import chdtri

from filters import (
    BodyVelocity,
    ColouredNoise,
    InertialSamples,
    LandmarkDrift,
    LeftOnly,
    RangeBearing,
    Start,
    StereoCamera,
    StereoEKF,
    StereoNoise,
    StereoObservation,
    UpdateReport,
    kernel,
)

Array = NDArray[np.float64]
_LEAST = 3
"""Frames of a track that is used: with two, little is left beside the landmark."""
_STEPS, _SETTLED = 10, 1e-14
"""Gauss-Newton steps at most, and the fall of the squared distance that is too small for another one."""
_NEAREST, _BLIND = 0.05, 1e-12
"""Depth of a point over that at its first sight, and information on the inverse depth over that on the ray."""
_PARALLAX = 5.0
"""Inverse depth of a track without disparities over its standard deviation: below, it is taken for infinitely far."""
_MOVED = 3.0
"""Median of half the squared distance of the pixels from those at the last clone, in variances: 1.4 at rest."""
_STILL, _AT_REST = 0.5, np.repeat([0.02, 0.003], 3)
"""Time without motion after which the velocities are zero, s, and how well, m/s and rad/s per root of a hertz."""


@kernel
def _constrain(
    size: int,
    rig: tuple[float, float, float],
    clones: Array,
    P: Array,
    counts: NDArray[np.int64],
    tracks: Array,
    limits: Array,
    apart: Array,
    H: Array,
    nu: Array,
) -> Array:
    """Write what tracks say of the clones, whitened, into H and nu; returns the squared distance of each track.

    `clones` (N, 7) have the covariance P; `rig` is fx, fy and f b. `tracks` (sum of counts, 4, 3) has what whitens a
    measurement, then (u, v, d) less the centre: of the last `counts` clones, track by track. `size` numbers are used.
    `apart` (3, N, N) makes errors of u, v, d that walk in the course of a track independent; (3, 0, 0): they are.
    The distance is negative where it is above the limit, and NaN where no believable landmark was found.
    """
    (fx, fy, fb), top, end, distances = rig, 0, 0, np.full(len(counts), np.nan)
    ps, Rs = clones[:, :3], np.zeros((len(clones), 3, 3))
    for k in range(len(clones)):
        q0, q1, q2, q3 = clones[k, 3:]
        C = np.array([[0.0, -q2, q1], [q2, 0.0, -q0], [-q1, q0, 0.0]])
        Rs[k] = np.eye(3) + 2.0 * (q3 * C + C @ C)
    for t in range(len(counts)):
        K, a, begin, end, fell, settled = counts[t], len(ps) - counts[t], end, end + counts[t], np.inf, False
        A, B, E, M = np.zeros((size * K, 6 * K + 4)), np.zeros((3, 4)), np.zeros((4, 6)), np.zeros((K, 4, 4))
        for k in range(K):  # at clone k the direction and inverse depth are M[k] (x, y, inverse depth, 1)
            R = Rs[a + k].T
            M[k, :3, :3], M[k, 3, 2] = R @ Rs[a], 1.0
            M[k, :3, 3], M[k, :3, 2] = M[k, :3, 2], R @ (ps[a] - ps[a + k])
        z, free = tracks[begin, 3], 3
        x = np.array([z[0] / fx, z[1] / fy, z[2] / fb if size == 3 else 0.0, 1.0])
        for step in range(_STEPS):
            settled = not fell > _SETTLED or step == _STEPS - 1
            for k in range(K):
                h, W, row = M[k] @ x, tracks[begin + k], size * k
                if not h[2] > _NEAREST:
                    fell = np.nan
                    break
                u, v, d = fx * h[0] / h[2], fy * h[1] / h[2], fb * h[3] / h[2]
                B[0, 0], B[1, 1], B[2, 3] = fx / h[2], fy / h[2], fb / h[2]
                B[0, 2], B[1, 2], B[2, 2] = -u / h[2], -v / h[2], -d / h[2]
                J = W[:size] @ B
                A[row : row + size, :4] = J @ M[k]
                A[row : row + size, 3] = W[:size] @ (W[3] - np.array([u, v, d]))
                if settled:
                    E[:3, :3] = -h[3] * Rs[a + k].T
                    E[1, 3], E[0, 4], E[2, 3], E[0, 5], E[2, 4], E[1, 5] = h[2], -h[2], -h[1], h[1], h[0], -h[0]
                    A[row : row + size, 4 + 6 * k : 10 + 6 * k] = J @ E
            if apart.shape[1] > 0:
                for c in range(size):
                    A[c::size] = apart[c, :K, :K].copy() @ A[c::size].copy()
            if settled or np.isnan(fell):
                break
            C = A[:, :4].copy()
            V = C.T @ C
            if not V[2, 2] > _BLIND * V[0, 0]:
                fell = np.nan  # no depth can be seen
                break
            move = np.linalg.solve(V[:free, :free].copy(), V[:free, 3].copy())
            if size == 2 and step == 0:
                variance = np.linalg.det(V[:2, :2].copy()) / np.linalg.det(V[:3, :3].copy())
                least = _PARALLAX * np.sqrt(max(variance, 0.0))
                if not move[2] > -least:
                    fell = np.nan  # beyond infinity: the clones are wrong
                    break
                if not move[2] > least:
                    free, move = 2, np.linalg.solve(V[:2, :2].copy(), V[:2, 3].copy())
            x[:free] += move
            fell = move @ V[:free, 3].copy()
        if np.isnan(fell):
            continue
        if free == 2:  # so much may hide in its noise
            A /= _PARALLAX
        for c in range(3):  # Householder: afterwards the landmark is in the first three rows alone
            n = A[c:, c].copy()
            n[0] += np.copysign(np.sqrt(n @ n), n[0])
            n *= np.sqrt(2.0 / (n @ n))
            A[c:] -= np.outer(n, n @ A[c:])
        H_o, r_o = A[3:, 4:].copy(), A[3:, 3].copy()
        S = H_o @ P[6 * a :, 6 * a :].copy() @ H_o.T + np.eye(len(r_o))
        distances[t] = r_o @ np.linalg.solve(S, r_o)
        if distances[t] > limits[K]:
            distances[t] *= -1.0
            continue
        H[top : top + len(r_o), 6 * a :], nu[top : top + len(r_o)] = H_o, r_o
        top += len(r_o)
    return distances


def _compressed(H: Array, nu: Array) -> tuple[Array, Array]:
    """Compress a measurement to as many rows as H has rank; rotated rows of white noise are white noise.

    Tracks say nothing of where all clones are together: H has a null space, and what rounding leaves of its rows would
    take some of the noise for an innovation.
    """
    rotated, R, order = qr_multiply(H, nu, mode="right", pivoting=True)
    size = np.abs(np.diagonal(R))
    rank = int((size > size[0] * len(H) * np.finfo(float).eps).sum())
    return R[:rank, np.argsort(order)], rotated[:rank]


def _walking_apart(drift: LandmarkDrift | None, noise: StereoNoise, window: int) -> Array:
    """Matrices (3, N, N) that make whitened u, v, d of a track independent whose point walks since its first frame."""
    if drift is None:
        return np.zeros((3, 0, 0))
    steps = drift.share**2 + np.square(drift.pixels) / np.diag(noise.R)
    frames = np.arange(window)
    walked = np.minimum.outer(frames, frames).astype(np.float64)
    return np.linalg.inv(np.linalg.cholesky(np.eye(window) + steps[:, None, None] * walked))


class MultiStateConstraintEKF(StereoEKF):
    """Stereo MSCKF: clones of the last poses are corrected by whole tracks, the pose by some landmarks in a map.

    Parameters
    ----------
    camera, noise : StereoCamera, StereoNoise
        The rig. Of a `ColouredNoise` the drift of landmarks and the gauge walk are used.
    window : int
        Clones of the pose that are kept.
    map_landmarks : int
        Landmarks that may be in the map, those first that outlive a window; 0: the plain multi-state constraint filter.
    **options
        Any of `StereoEKF`. `motion="strapdown"` makes it visual-inertial. `measurement` is "joint", or "left":
        monocular, without any use of disparities, and without a map; clones are kept by motion.

    Raises
    ------
    ValueError
        An option has an unknown or impossible value.
    """

    open_options = StereoEKF.open_options - {"landmark", "error", "drop_unseen", "bodies"}

    def __init__(
        self, camera: StereoCamera, noise: StereoNoise, *, window: int = 11, map_landmarks: int = 30, **options: Any
    ) -> None:
        stated: dict[str, Any] = {}
        if isinstance(noise, ColouredNoise):
            stated = {"drift": noise.drift, "gauge_walk": noise.gauge_walk}
            noise = noise.white_part
        for name, value, least in (("window", window, _LEAST), ("map_landmarks", map_landmarks, 0)):
            if type(value) is not int or value < least:
                raise ValueError(f"{name} must be an integer >= {least}, got {value!r}")
        self.window, self.map_landmarks = window, map_landmarks
        stated |= {"landmark": "shared-anchor", "error": "right-invariant"}
        super().__init__(camera, noise, **{**stated, **options})
        sensor, error, gate = self.options.measurement, self.options.error, self.options.gate
        if type(sensor) not in (RangeBearing, LeftOnly):
            raise ValueError(f"measurement must be 'joint' or 'left' with a window, got {type(sensor).__name__}")
        if self.options.bodies is not None:
            raise ValueError("bodies must be None with a window: its landmarks are not in the state")
        if error.first_estimates:
            raise ValueError(f"error must linearise at the state with a window, got {type(error).__name__}")
        if type(sensor) is LeftOnly and map_landmarks:
            raise ValueError(f"map_landmarks must be 0 with measurement='left', got {map_landmarks}: see its page")
        self._size = 2 if type(sensor) is LeftOnly else 3
        dof = np.maximum(self._size * np.arange(window + 1) - 3, 1)
        self._limits = chdtri(dof, 0.0 if gate is None else 1.0 - gate)

    def reset(self, start: Start = Start()) -> None:  # noqa: B008  frozen
        """Start again, without clones, tracks and landmarks."""
        super().reset(start)
        self._frame, self._since = 0, 0.0
        self._tracks: dict[int, list[Array]] = {}

    def predict(self, dt: float, odometry: BodyVelocity | None = None, inertial: InertialSamples | None = None) -> None:
        """Move the belief forward; see `StereoEKF.predict`."""
        super().predict(dt, odometry, inertial)
        self._dt, self._since = dt, self._since + dt

    def update(self, observation: StereoObservation) -> UpdateReport:
        """Complete tracks correct the window, then landmarks of the map the pose, which becomes a clone."""
        if not isinstance(observation, StereoObservation):
            raise ValueError(f"observation must be a StereoObservation, got {type(observation).__name__}")
        observation = self.options.measurement.completed(observation.ordered(), self.camera)
        ids, in_map = observation.ids.tolist(), set(self.ids.tolist())
        numbers, r = np.zeros((len(ids), 4, 3)), self._size
        R = self.noise.R[None] if observation.R is None else observation.R
        numbers[:, :r, :r] = np.linalg.inv(np.linalg.cholesky(R[:, :r, :r]))  # whitens
        numbers[:, 3] = observation.uvd - [self.camera.cx, self.camera.cy, 0.0]
        rows_by_id = dict(zip(ids, numbers, strict=True))
        ended = [i for i in self._tracks if i not in rows_by_id]
        moved = r == 3 or not self._stands(rows_by_id)
        full = sorted(i for i, track in self._tracks.items() if len(track) == self.window and i in rows_by_id and moved)
        report = self._correct_by({i: self._tracks.pop(i) for i in (*ended, *full)})
        new = [i for i in ids if i not in in_map and i not in self._tracks and i not in full]
        in_map.update((full + new)[: max(self.map_landmarks - len(in_map & rows_by_id.keys()), 0)])
        mine = super().update(observation.select(np.array([i in in_map for i in ids], dtype=np.bool_)))
        if moved:
            if self._frame >= self.window:
                self.forget_clone(self._names[0])
            self.clone_pose(f"window {self._frame}")
            self._frame, self._since = self._frame + 1, 0.0
            for i in rows_by_id.keys() - set(self.ids.tolist()):
                self._tracks.setdefault(i, []).append(rows_by_id[i])
        both = {
            n: np.concatenate([getattr(report, n), getattr(mine, n)]) for n in ("updated", "gated", "behind_camera")
        }
        return replace(mine, **both, nis=report.nis + mine.nis, nis_dof=report.nis_dof + mine.nis_dof)

    def forget(self, ids: Sequence[int] | NDArray[np.int64]) -> None:
        """Forget landmarks and tracks."""
        super().forget(ids)
        for i in np.asarray(ids).tolist():
            self._tracks.pop(i, None)

    def _stands(self, seen: dict[int, Array]) -> bool:
        """Whether tracks have not moved since the last clone; where they have not for long, the velocity is zero."""
        pairs = [(track[-1], seen[i]) for i, track in self._tracks.items() if i in seen]
        if len(pairs) < _LEAST:
            return False
        before, now = np.array(pairs).transpose(1, 0, 2, 3)
        distances = np.einsum("nij,nj->ni", now[:, :2, :2], now[:, 3, :2] - before[:, 3, :2])
        if np.median(np.sum(distances**2, axis=1)) > 2.0 * _MOVED:
            return False
        if self._since < _STILL:
            return True
        velocity, R = self.velocity, np.diag(_AT_REST**2) / self._dt
        at_rest = -np.concatenate([velocity.linear, velocity.angular])
        return self.correct(at_rest, {"velocity": np.eye(6)}, R, self.options.gate).used

    @property
    def _names(self) -> tuple[str, ...]:
        """Clones of the window, the oldest first."""
        return tuple(f"window {k}" for k in range(max(self._frame - self.window, 0), self._frame))

    def _correct_by(self, complete: dict[int, list[Array]]) -> UpdateReport:
        """Correct the window with what complete tracks say of it."""
        tracks = {i: track for i, track in complete.items() if len(track) >= _LEAST}
        if not tracks:
            return UpdateReport()
        names, camera, ids = self._names, self.camera, np.array(list(tracks))
        belief, counts = self.belief(*names), np.array([len(track) for track in tracks.values()])
        rows = self._size * counts - 3
        H, nu = np.zeros((rows.sum(), 6 * len(names))), np.zeros(rows.sum())
        measured = np.array([numbers for track in tracks.values() for numbers in track])
        apart = _walking_apart(self.options.drift, self.noise, self.window)  # of now: `assume` may change both
        arguments = belief.value.reshape(-1, 7), belief.covariance, counts, measured, self._limits, apart
        rig = camera.fx, camera.fy, camera.disparity_constant
        distances, nis, dof = _constrain(self._size, rig, *arguments, H, nu), 0.0, 0
        if top := rows[distances >= 0.0].sum():
            H, nu = H[:top], nu[:top]
            if top > 2 * H.shape[1]:
                H, nu = _compressed(H, nu)
            nis, dof = self.correct(nu, {names: H}, np.eye(len(nu))).nis, len(nu)
        fates = {"updated": distances >= 0.0, "gated": distances < 0.0, "behind_camera": np.isnan(distances)}
        return UpdateReport(**{fate: ids[which] for fate, which in fates.items()}, nis=nis, nis_dof=dof)
