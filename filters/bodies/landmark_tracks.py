"""Tracks of landmarks over the last frames, and whether they move as the scene or as a body does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.contract.inputs import StereoObservation
from filters.contract.noise import StereoNoise
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera

KEPT = 16
"""Frames that are kept."""
FREE, STATIC = -2, -1
"""Where a track is on no body: not known yet, or on the scene."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """Measurements of T landmarks in the last frames, the newest first."""

    ids: IntArray
    """(T,): ascending."""
    uvd: FloatArray
    """(T, 16, 3): measurements, px; NaN where there is none."""
    R: FloatArray
    """(T, 3, 3): noise of the newest, px^2."""
    status: IntArray
    """(T,): number of the body that it is on, `STATIC` or `FREE`."""
    strikes: IntArray
    """(T,): frames in a row in which it did not fit."""
    missed: IntArray
    """(T,): frames in a row without a measurement."""

    @classmethod
    def none(cls) -> Tracks:
        """Empty tracks, as before the first frame."""
        number = np.zeros(0, dtype=np.int64)
        return cls(number, np.zeros((0, KEPT, 3)), np.zeros((0, 3, 3)), number, number, number)

    def extended(self, observation: StereoObservation, noise: StereoNoise, patience: int) -> Tracks:
        """The tracks after another frame; those missed for more than `patience` frames end."""
        stay = self.missed + ~np.isin(self.ids, observation.ids) <= patience
        ids = np.union1d(self.ids[stay], observation.ids)
        old, new = np.searchsorted(ids, self.ids[stay]), np.searchsorted(ids, observation.ids)
        uvd, R = np.full((len(ids), KEPT, 3), np.nan), np.zeros((len(ids), 3, 3))
        uvd[old, 1:], R[old] = self.uvd[stay, :-1], self.R[stay]
        uvd[new, 0], R[new] = observation.uvd, noise.R if observation.R is None else observation.R
        status, strikes, missed = np.full(len(ids), FREE), np.zeros(len(ids), np.int64), np.zeros(len(ids), np.int64)
        status[old], strikes[old], missed[old] = self.status[stay], self.strikes[stay], self.missed[stay] + 1
        missed[new] = 0
        return Tracks(ids, uvd, R, status, strikes, missed)

    @property
    def sigma_d(self) -> float:
        """Mean standard deviation of the disparities, px."""
        return float(np.sqrt(self.R[:, 2, 2].mean()))

    @property
    def ages(self) -> IntArray:
        """(T,): measurements among the frames that are kept."""
        ages: IntArray = np.isfinite(self.uvd[:, :, 0]).sum(axis=1)
        return ages


def inverse(S: FloatArray) -> FloatArray:
    """Inverses of symmetric matrices (..., 3, 3), by their cofactors."""
    a, b, c, d, e, f = S[..., 0, 0], S[..., 0, 1], S[..., 0, 2], S[..., 1, 1], S[..., 1, 2], S[..., 2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    cofactors = np.stack([A, B, C, B, D, E, C, E, F], axis=-1)
    return (cofactors / (a * A + b * B + c * C)[..., None]).reshape(S.shape)


def squared(x: FloatArray, weight: FloatArray) -> FloatArray:
    """x^T W x of vectors (..., 3) and matrices (..., 3, 3)."""
    product: FloatArray = np.einsum("...i,...ij,...j->...", x, weight, x)
    return product


def carried_distances(
    camera: StereoCamera, before: FloatArray, now: FloatArray, R: FloatArray, turn: FloatArray, shift: FloatArray
) -> FloatArray:
    """Squared distances (n,) of measurements from where earlier ones are carried to by x' = turn x + shift.

    `before` and `now` (n, 3) are (u, v, d) with noise R (n, 3, 3), `turn` (n, 3, 3) or (3, 3), `shift` (n, 3) or (3,),
    from the axes of the earlier camera to those of this one. Not finite where it is carried behind the camera.
    """
    scale, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    direction = np.concatenate([(before[:, :2] - centre) / scale, np.ones((len(before), 1))], axis=1)
    shift = np.broadcast_to(shift, (len(before), 3)) / camera.disparity_constant
    x = np.einsum("...ij,...j->...i", turn, direction) + before[:, 2:] * shift
    by_before = np.concatenate(
        [np.broadcast_to(turn, (len(before), 3, 3))[:, :, :2] / scale, shift[:, :, None]], axis=2
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = 1.0 / x[:, 2]
        ahead = x[:, :2] * depth[:, None]
        predicted = np.concatenate([ahead * scale + centre, (before[:, 2] * depth)[:, None]], axis=1)
        J = np.empty((len(before), 3, 3))
        J[:, :2] = (scale * depth[:, None])[:, :, None] * (by_before[:, :2] - ahead[:, :, None] * by_before[:, 2:])
        J[:, 2] = -predicted[:, 2:] * depth[:, None] * by_before[:, 2]
        J[:, 2, 2] += depth
        distances = squared(now - predicted, inverse(J @ R @ J.transpose(0, 2, 1) + R))
    return np.where(x[:, 2] > 0.0, distances, np.inf)


def world_points(
    camera: StereoCamera, uvd: FloatArray, R: FloatArray, positions: FloatArray, R_wc: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points of W (n, 3) at measurements, and their covariances (n, 3, 3), by poses (n, 3), (n, 3, 3) of the camera."""
    d = np.maximum(uvd[:, 2], 0.5)
    z = camera.disparity_constant / d
    x, y = (uvd[:, 0] - camera.cx) / camera.fx * z, (uvd[:, 1] - camera.cy) / camera.fy * z
    J = np.zeros((len(uvd), 3, 3))
    J[:, 0, 0], J[:, 1, 1] = z / camera.fx, z / camera.fy
    J[:, :, 2] = -np.stack([x, y, z], axis=1) / d[:, None]
    J = R_wc @ J
    points = positions + np.einsum("nij,nj->ni", np.broadcast_to(R_wc, J.shape), np.stack([x, y, z], axis=1))
    return points, J @ R @ J.transpose(0, 2, 1)


@dataclass(frozen=True, eq=False)
class Velocities:
    """Velocities of n tracks over some frames, alone and with their neighbours."""

    points: FloatArray
    """(n, 3): where they are now, m, in W."""
    sizes: FloatArray
    """(n,): uncertainty of the points, m."""
    alone: FloatArray
    """(n, 3): m/s, in W."""
    weights: FloatArray
    """(n, 3, 3): inverse covariances of these."""
    linked: BoolArray
    """(n, n): neighbours whose velocities agree."""
    together: FloatArray
    """(n, 3): weighted means over those that are linked."""
    covariances: FloatArray
    """(n, 3, 3): of these."""

    @classmethod
    def of(
        cls, camera: StereoCamera, tracks: Tracks, index: IntArray, poses: tuple[FloatArray, FloatArray], dt: float
    ) -> Velocities:
        """Velocities of the tracks at `index` from their oldest measurement within twelve frames to the newest.

        `poses` are positions (L, 3) and rotations (L, 3, 3) of the camera, the newest first.
        """
        uvd, R = tracks.uvd[index], tracks.R[index]
        measured = np.isfinite(uvd[:, : min(_BACK + 1, len(poses[0])), 0])
        lag = measured.shape[1] - 1 - np.argmax(measured[:, ::-1], axis=1)
        points, now = world_points(camera, uvd[:, 0], R, poses[0][0], poses[1][0])
        before, then = world_points(camera, uvd[np.arange(len(index)), lag], R, poses[0][lag], poses[1][lag])
        seconds = np.maximum(lag, 1) * dt
        alone, C = (points - before) / seconds[:, None], (now + then) / seconds[:, None, None] ** 2
        sizes = 3.0 * dt * np.sqrt(np.trace(C, axis1=1, axis2=2))
        linked = np.eye(len(index), dtype=bool)
        first, second = np.nonzero(np.triu(beside(camera, uvd[:, 0], uvd[:, 0], _NEIGHBOURS, tracks.sigma_d), 1))
        agree = squared(alone[first] - alone[second], inverse(C[first] + C[second])) < _ALIKE
        linked[first[agree], second[agree]] = linked[second[agree], first[agree]] = True
        weights = inverse(C)
        weighted = np.einsum("nij,nj->ni", weights, alone)
        mask = linked.astype(float)
        covariances = inverse((mask @ weights.reshape(-1, 9)).reshape(-1, 3, 3))
        together = np.einsum("nij,nj->ni", covariances, mask @ weighted)
        return cls(points, sizes, alone, weights, linked, together, covariances)


def beside(camera: StereoCamera, first: FloatArray, second: FloatArray, reach: float, sigma_d: float) -> BoolArray:
    """Mask (n, m) of pairs of measurements whose points may be within `reach` metres of each other.

    Across the line of sight by their bearings, along it by their depths, which two `sigma_d` px make uncertain.
    """
    scale = np.array([camera.fx, camera.fy])
    d0, d1 = np.maximum(first[:, 2], 0.5)[:, None], np.maximum(second[:, 2], 0.5)
    across = np.linalg.norm((first[:, None, :2] - second[None, :, :2]) / scale, axis=2)
    depth = camera.disparity_constant / d0
    along = np.abs(depth - camera.disparity_constant / d1)
    near: BoolArray = (across * depth < reach) & (along < reach + 2.0 * sigma_d * depth / np.minimum(d0, d1))
    return near


_NEIGHBOURS = 2.0
"""Distance, m, within which tracks are neighbours."""
_BACK = 12
"""Frames over which velocities are measured."""
_ALIKE = 11.3
"""Squared distance within which two velocities agree: chi-square of 3, 99 %."""
