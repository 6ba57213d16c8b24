"""A multi-state constraint filter (Mourikis and Roumeliotis 2007) of stereo tracks, from public calls alone."""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.spatial.transform import Rotation

from filters import Start, StereoCamera, StereoEKF, StereoNoise, StereoObservation


class WindowFilter:
    """Clones of the last poses; a track is used once, when it ends or when the oldest clone leaves.

    Parameters
    ----------
    camera, noise : StereoCamera, StereoNoise
        The rig.
    window : int
        Clones at most.
    """

    def __init__(self, camera: StereoCamera, noise: StereoNoise, window: int = 11, **options: object) -> None:
        self._slam = StereoEKF(camera, noise, **options)  # type: ignore[arg-type]
        self.camera, self.noise, self._window = camera, noise, window
        self._whiten = np.linalg.inv(np.linalg.cholesky(noise.R))
        self.reset()

    def reset(self, start: Start | None = None) -> None:
        """Start again."""
        self._slam.reset(*([start] if start else []))
        for name in self._slam.clones:
            self._slam.forget_clone(name)
        self._names: deque[str] = deque()
        self._tracks: dict[int, dict[str, np.ndarray]] = {}
        self._frame = 0

    def predict(self, dt: float) -> None:
        """Move on."""
        self._slam.predict(dt)

    @property
    def pose(self):
        """Of the left camera."""
        return self._slam.pose

    def update(self, observation: StereoObservation) -> int:
        """Clone the pose, note the measurements, and use the tracks that are complete; how many."""
        name, self._frame = str(self._frame), self._frame + 1
        self._slam.clone_pose(name)
        self._names.append(name)
        seen = dict(zip(observation.ids.tolist(), observation.uvd, strict=True))
        for i, uvd in seen.items():
            self._tracks.setdefault(i, {})[name] = uvd
        oldest = self._names[0] if len(self._names) > self._window else None
        done = [i for i, track in self._tracks.items() if i not in seen or (oldest is not None and oldest in track)]
        tracks = [self._tracks.pop(i) for i in done]
        rows = [found for track in tracks if len(track) > 2 and (found := self._constraint(track)) is not None]
        if rows:
            H, r = np.vstack([H for H, _ in rows]), np.concatenate([r for _, r in rows])
            if len(H) > H.shape[1]:  # compress
                q, H = np.linalg.qr(H)
                r = q.T @ r
            by_clone = {n: H[:, 6 * k : 6 * k + 6] for k, n in enumerate(self._names)}
            self._slam.correct(r, by_clone, np.eye(len(r)))
        if oldest is not None:
            self._slam.forget_clone(self._names.popleft())
        return len(rows)

    def _constraint(self, track: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
        """What a track says of the clones alone, whitened: H (3 K - 3, 6 clones) and r; None: no believable point."""
        names = list(track)
        poses = [self._slam.belief(n).value for n in names]
        Rs, ps = [Rotation.from_quat(x[3:]).as_matrix() for x in poses], [x[:3] for x in poses]
        uvd = np.array(list(track.values()))
        scale = uvd[0, 2] / self.camera.disparity_constant
        point = np.array([*(Rs[0] @ self.camera.ray(uvd[:1])[0] + scale * ps[0]), scale])
        for _ in range(4):
            point /= np.linalg.norm(point)
            c = np.array([[*(R.T @ (point[:3] - point[3] * p)), point[3]] for R, p in zip(Rs, ps, strict=True)])
            if (c[:, 2] <= 0).any():
                return None
            r = ((uvd - self.camera.project_scaled(c[:, :3], c[:, 3])) @ self._whiten.T).ravel()
            J = self._whiten @ self.camera.project_scaled_jacobian(c[:, :3], c[:, 3])
            by_point = np.stack([J_k @ _to_camera(R, p) for J_k, R, p in zip(J, Rs, ps, strict=True)]).reshape(-1, 4)
            tangent = np.linalg.svd(point[None])[2][1:].T
            H_f = by_point @ tangent
            point = point + tangent @ np.linalg.lstsq(H_f, r, rcond=None)[0]
        H = np.zeros((len(r), 6 * len(self._names)))
        for k, (n, R) in enumerate(zip(names, Rs, strict=True)):
            place, rows = 6 * list(self._names).index(n), slice(3 * k, 3 * k + 3)
            H[rows, place : place + 3] = -point[3] * J[k, :, :3] @ R.T
            H[rows, place + 3 : place + 6] = J[k, :, :3] @ _skew(c[k, :3])
        null = np.linalg.qr(H_f, mode="complete")[0][:, 3:]
        return null.T @ H, null.T @ r


def _to_camera(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(x, w) in W -> (R^T (x - w p), w)."""
    return np.vstack([np.column_stack([R.T, -R.T @ p]), [0.0, 0.0, 0.0, 1.0]])


def _skew(v: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
