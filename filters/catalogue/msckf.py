"""Multi-state constraint filter of stereo tracks (Mourikis and Roumeliotis 2007), with some landmarks in the map.

A track is used once, when it ends or when it fills the window: its landmark is found by Gauss-Newton at the clones, and
what the track says of the clones alone, in the null space of the landmark's Jacobian, corrects them. Where there is
room, landmarks are in the map instead (Li and Mourikis 2013). Derivation: docs/derivations/window.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from itertools import chain
from typing import Any

import numpy as np
from scipy.linalg import qr

from filters.contract.noise import StereoNoise
from filters.contract.observation import StereoObservation
from filters.contract.start import Start
from filters.contract.stereo_filter import AT_ORIGIN
from filters.contract.update_report import Correction, UpdateReport
from filters.contract.validation import unique_ids
from filters.engine.gating import gate_limit
from filters.engine.stereo_ekf import StereoEKF
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.rotations import matrix_of
from filters.geometry.three_by_three import cross_matrix, multiply, put, times, transposed
from filters.measurements.rectified_pair import LeftOnly, RangeBearing

_LEAST = 3
"""Frames of a track that is used: with two, little is left beside the landmark."""
_STEPS, _SETTLED = 10, 1e-14
"""Gauss-Newton steps at most, and the fall of the squared distance that is too small for another one."""
_NEAREST, _BLIND = 0.05, 1e-12
"""Depth of a point over that at its first sight, and information on the inverse depth over that on the ray."""


def _constraints(
    camera: FloatArray,
    clones: FloatArray,
    P: FloatArray,
    first: IntArray,
    count: IntArray,
    uvd: FloatArray,
    whitening: FloatArray,
    limits: FloatArray,
    H: FloatArray,
    nu: FloatArray,
    distances: FloatArray,
) -> int:
    """Write what tracks say of the clones, whitened, into H and nu, and its squared distance into `used`; the rows.

    A track begins at clone `first` and goes on for `count`; `uvd` are its measurements, those of the tracks one after
    the other. `whitening` (N, r, 3) makes numbers of variance one of them. `used` is minus the distance where it is
    above the limit, NaN where no believable landmark was found.
    """
    fx, fy, cx, cy, fb = camera[0], camera[1], camera[2], camera[3], camera[0] * camera[4]
    size, top, end = whitening.shape[1], 0, 0
    b, g, V, by_pose = np.zeros(4), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 6))
    for t in range(len(first)):
        K, a, begin = count[t], first[t], end
        rows, width, end = size * K, 6 * K, begin + K
        A = np.zeros((rows, 4 + width))  # by the landmark, innovation, by the clones
        R_wa = matrix_of(clones[a, 3], clones[a, 4], clones[a, 5], clones[a, 6])
        x, y = (uvd[begin, 0] - cx) / fx, (uvd[begin, 1] - cy) / fy
        rho = uvd[begin, 2] / fb if size == 3 else 0.0  # of z, in the first camera
        settled, good = False, True
        for step in range(_STEPS):
            settled |= step == _STEPS - 1
            g[:], V[:] = 0.0, 0.0
            for k in range(K):
                clone = clones[a + k]
                R = transposed(matrix_of(clone[3], clone[4], clone[5], clone[6]))
                turn = multiply(R, R_wa)
                way = times(R, clones[a, 0] - clone[0], clones[a, 1] - clone[1], clones[a, 2] - clone[2])
                h0, h1, h2 = times(turn, x, y, 1.0)
                h0, h1, h2 = h0 + rho * way[0], h1 + rho * way[1], h2 + rho * way[2]
                if not h2 > _NEAREST:
                    good = False
                    break
                u, v, d = fx * h0 / h2, fy * h1 / h2, fb * rho / h2
                z = uvd[begin + k]
                for i in range(size):
                    row, w = A[size * k + i], whitening[begin + k, i]
                    b[0], b[1], b[3] = w[0] * fx / h2, w[1] * fy / h2, w[2] * fb / h2
                    b[2] = -(w[0] * u + w[1] * v + w[2] * d) / h2
                    row[0] = b[0] * turn[0] + b[1] * turn[3] + b[2] * turn[6]
                    row[1] = b[0] * turn[1] + b[1] * turn[4] + b[2] * turn[7]
                    row[2] = b[0] * way[0] + b[1] * way[1] + b[2] * way[2] + b[3]
                    row[3] = w[0] * (z[0] - cx - u) + w[1] * (z[1] - cy - v) + w[2] * (z[2] - d)
                    for c in range(3):
                        g[c] += row[c] * row[3]
                        for e in range(3):
                            V[c, e] += row[c] * row[e]
                    if settled:
                        put(by_pose, 0, 0, R, -rho)
                        put(by_pose, 0, 3, cross_matrix(h0, h1, h2), 1.0)
                        for c in range(6):
                            row[4 + 6 * k + c] = b[0] * by_pose[0, c] + b[1] * by_pose[1, c] + b[2] * by_pose[2, c]
            if settled or not good:
                break
            if V[2, 2] < _BLIND * V[0, 0]:  # nothing moved: the depth cannot be seen
                good = False
                break
            move = np.linalg.solve(V, g)
            x, y, rho = x + move[0], y + move[1], rho + move[2]
            settled = bool(g @ move < _SETTLED)
        distances[t] = np.nan
        if not good:
            continue
        for c in range(3):  # Householder: afterwards the landmark is in the first three rows alone
            normal = A[c:, c].copy()
            normal[0] += np.copysign(np.sqrt(normal @ normal), normal[0])
            normal *= np.sqrt(2.0 / (normal @ normal))
            A[c:] -= np.outer(normal, normal @ A[c:])
        H_o, r_o = A[3:, 4:].copy(), A[3:, 3].copy()
        S = H_o @ P[6 * a : 6 * a + width, 6 * a : 6 * a + width].copy() @ H_o.T + np.eye(rows - 3)
        distances[t] = r_o @ np.linalg.solve(S, r_o)
        if distances[t] > limits[K]:
            distances[t] *= -1.0
            continue
        H[top : top + rows - 3, 6 * a : 6 * a + width], nu[top : top + rows - 3] = H_o, r_o
        top += rows - 3
    return top


@cache
def _kernel() -> Any:
    from filters.engine.compiled.blas import entry  # Numba takes longer to import than all the rest

    return entry(_constraints)


@dataclass
class _Track:
    """Measurements of a landmark that is not in the map, one a frame."""

    first: int
    """Number of its first frame."""
    numbers: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    """(u, v, d), and what makes its errors of variance one."""


class MultiStateConstraintEKF(StereoEKF):
    """Stereo MSCKF: clones of the last poses are corrected by whole tracks, the pose by some landmarks in a map.

    Parameters
    ----------
    camera, noise : StereoCamera, StereoNoise
        The rig.
    window : int
        Clones of the pose that are kept.
    map_landmarks : int
        Landmarks that may be in the map, those first that outlive a window; 0: the plain multi-state constraint filter.
    **options
        Any of `StereoEKF`. `motion="strapdown"` makes it visual-inertial. `measurement` is "joint", or "left":
        monocular, without any use of disparities, and without a map.

    Raises
    ------
    ValueError
        An option has an unknown or impossible value.
    """

    open_options = StereoEKF.open_options - {"landmark", "error", "drop_unseen"}

    def __init__(
        self, camera: StereoCamera, noise: StereoNoise, *, window: int = 11, map_landmarks: int = 30, **options: Any
    ) -> None:
        for name, value, least in (("window", window, _LEAST), ("map_landmarks", map_landmarks, 0)):
            if type(value) is not int or value < least:
                raise ValueError(f"{name} must be an integer >= {least}, got {value!r}")
        self.window, self.map_landmarks = window, map_landmarks
        super().__init__(camera, noise, **{"landmark": "shared-anchor", "error": "right-invariant", **options})
        sensor, error, gate = self.options.measurement, self.options.error, self.options.gate
        if type(sensor) not in (RangeBearing, LeftOnly):
            raise ValueError(f"measurement must be 'joint' or 'left' with a window, got {type(sensor).__name__}")
        if not error.linearises_at_the_state:
            raise ValueError(f"error must linearise at the state with a window, got {type(error).__name__}")
        self._numbers = 2 if type(sensor) is LeftOnly else 3
        if self._numbers < 3 and map_landmarks:
            raise ValueError(f"map_landmarks must be 0 with measurement='left', got {map_landmarks}: see its page")
        self._own_whitening = _whitening(noise.R, self._numbers)
        self._limits = np.full(window + 1, np.inf)
        if gate is not None:
            self._limits[_LEAST:] = [gate_limit(gate, self._numbers * k - 3) for k in range(_LEAST, window + 1)]

    def reset(self, start: Start = AT_ORIGIN) -> None:
        """Start again, without clones, tracks and landmarks."""
        super().reset(start)
        self._frame = 0
        self._tracks: dict[int, _Track] = {}

    def update(self, observation: StereoObservation) -> UpdateReport:
        """Complete tracks correct the window, then landmarks of the map the pose, which becomes a clone."""
        if not isinstance(observation, StereoObservation):
            raise ValueError(f"observation must be a StereoObservation, got {type(observation).__name__}")
        ids, in_map = observation.ids.tolist(), set(self.ids.tolist())
        seen = dict(zip(ids, zip(observation.uvd, self._whitening(observation), strict=True), strict=True))
        full = [i for i in ids if i in self._tracks and len(self._tracks[i].numbers) == self.window]
        ended = [i for i in self._tracks if i not in seen]
        report = self._correct_by({i: self._tracks.pop(i) for i in (*ended, *full)})
        new = [i for i in ids if i not in in_map and i not in self._tracks and i not in full]
        in_map.update((full + new)[: max(self.map_landmarks - len(in_map & seen.keys()), 0)])
        mine = super().update(observation.select(np.array([i in in_map for i in ids], dtype=np.bool_)))
        if self._frame >= self.window:
            self.forget_clone(self._names[0])
        self.clone_pose(f"window {self._frame}")
        for i in seen.keys() - set(self.ids.tolist()):
            self._tracks.setdefault(i, _Track(self._frame)).numbers.append(seen[i])
        self._frame += 1
        return _merged(report, mine)

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Forget landmarks and tracks."""
        super().forget(ids)
        for i in unique_ids("ids", np.asarray(ids)).tolist():
            self._tracks.pop(i, None)

    @property
    def _names(self) -> list[str]:
        """Clones of the window, the oldest first."""
        return [f"window {k}" for k in range(max(self._frame - self.window, 0), self._frame)]

    def _whitening(self, observation: StereoObservation) -> FloatArray:
        """What makes the errors of measurements independent, of variance one, (M, size, 3)."""
        if observation.R is None:
            return np.broadcast_to(self._own_whitening, (len(observation), *self._own_whitening.shape))
        return _whitening(observation.R, self._numbers)

    def _correct_by(self, tracks: dict[int, _Track]) -> UpdateReport:
        """Correct the window with what complete tracks say of it."""
        tracks = {i: track for i, track in tracks.items() if len(track.numbers) >= _LEAST}
        if not tracks:
            return UpdateReport()
        names, camera = self._names, self.camera
        belief, begin = self.belief(*names), self._frame - len(names)
        first, counts = np.array([(track.first - begin, len(track.numbers)) for track in tracks.values()]).T.copy()
        uvd, whitening = map(np.array, zip(*chain.from_iterable(t.numbers for t in tracks.values()), strict=True))
        room = int((self._numbers * counts - 3).sum())
        H, nu, distances = np.zeros((room, 6 * len(names))), np.zeros(room), np.zeros(len(tracks))
        rig = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline])
        given = rig, belief.value.reshape(-1, 7), belief.covariance, first, counts, uvd, whitening, self._limits
        rows = _kernel()(*given, H, nu, distances)
        ids, told = np.array(list(tracks)), Correction(False, 0.0, 0)
        if rows:
            H, nu = H[:rows], nu[:rows]
            if rows > 2 * H.shape[1]:  # the triangle of its QR decomposition says the same
                triangle = qr(np.column_stack([H, nu]), mode="r", check_finite=False)[0][: H.shape[1]]
                H, nu = triangle[:, :-1], triangle[:, -1]
            told = self.correct(nu, dict(zip(names, np.hsplit(H, len(names)), strict=True)), np.eye(len(nu)))
        fates = {"updated": abs(distances) == distances, "gated": distances < 0.0, "behind_camera": np.isnan(distances)}
        told_of: dict[str, Any] = {fate: ids[which] for fate, which in fates.items()}
        return UpdateReport(**told_of, nis=told.nis, nis_dof=told.nis_dof)


def _whitening(R: FloatArray, size: int) -> FloatArray:
    """What makes independent numbers of variance one of the errors of the first `size` of (u, v, d), (..., size, 3)."""
    inverse: FloatArray = np.linalg.inv(np.linalg.cholesky(R[..., :size, :size]))
    return np.concatenate([inverse, np.zeros((*inverse.shape[:-1], 3 - size))], axis=-1)


def _merged(first: UpdateReport, second: UpdateReport) -> UpdateReport:
    """Both in one."""
    merged: dict[str, Any] = {}
    for name in (f.name for f in fields(UpdateReport)):
        both = getattr(first, name), getattr(second, name)
        merged[name] = sum(both) if name.startswith("nis") else np.concatenate(both)
    return UpdateReport(**merged)
