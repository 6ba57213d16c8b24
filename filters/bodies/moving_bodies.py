"""Birth, step and death of the bodies of one filter, and the choice of which landmarks are on them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from filters.bodies.association import YOUNG, Association, Body
from filters.bodies.landmark_tracks import FREE, KEPT, STATIC, Tracks, inverse
from filters.bodies.rigid_bodies import BODY_SIZE, BodiesBelief, BodyStep, RigidBodies
from filters.contract.inputs import StereoObservation
from filters.contract.noise import StereoNoise
from filters.contract.outputs import MovedLandmarks, UpdateReport, Variable, VariableSteps
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera

if TYPE_CHECKING:
    from filters.engine.row import Row

_WALKS = 3.0
"""Speed, m/s, above which a body is no walker, however narrow it looks from behind."""
_CELL, _MOST = 3.0, 2
"""Side of a cell of space, m, and how many landmarks of the scene are used in one."""
_VAGUE, _FAR = 3.0, 10.0
"""Standard deviation of the first velocity, m/s, above which, and disparity in standard deviations of its noise below
which no body is born: neither depth nor velocity is nearly Gaussian yet."""
_FATES = ("updated", "initialised", "gated", "rejected", "behind_camera", "failed")


def _no_poses() -> tuple[FloatArray, FloatArray]:
    return np.full((KEPT, 3), np.nan), np.full((KEPT, 3, 3), np.nan)


def _put_first(history: FloatArray, newest: FloatArray) -> None:
    """Put a value in front; the oldest goes."""
    history[1:] = history[:-1].copy()
    history[0] = newest


class MovingBodies:
    """Bodies of one filter.

    Parameters
    ----------
    settings : RigidBodies
        How they move, and when one is born.
    camera : StereoCamera
        The rig.
    """

    def __init__(self, settings: RigidBodies, camera: StereoCamera) -> None:
        self.settings = settings
        self.camera = camera
        self.bodies: list[Body] = []
        self.tracks = Tracks.none()
        self._positions, self._axes = _no_poses()
        self._frame, self._next, self._dt = -1, 0, 0.1
        self._ids_before = np.zeros(0, dtype=np.int64)

    # --- the state ---

    def step(self, row: Row, dt: float) -> None:
        """Move the bodies, and the landmarks on them, by `dt` seconds."""
        self._dt = dt
        if not self.bodies:
            return
        ids = row.ids
        carriers = self._carriers_of(ids)
        mine, k = ids[carriers >= 0], carriers[carriers >= 0]
        points = row.landmark_positions(mine)
        lost = ~np.isfinite(points).all(axis=1)
        if lost.any():
            self._release(row, mine[lost])
            mine, k, points = mine[~lost], k[~lost], points[~lost]
        moves = BodyStep.of(self._values(row), dt)
        moved, by_body = moves.carry(k, points)
        names = tuple(body.names for body in self.bodies)
        noise = np.array([self.settings.noise(dt, body.turning) for body in self.bodies])
        landmarks = MovedLandmarks(mine, moved, moves.D[k], by_body)
        row.move(VariableSteps(names, moves.moved, moves.F, noise, landmarks, k))

    def _values(self, row: Row) -> FloatArray:
        """Values of the bodies, (K, 13)."""
        values = row.held_values()
        rows = [np.concatenate([values[name] for name in body.names]) for body in self.bodies]
        return np.array(rows).reshape(-1, 13)

    def belief(self, row: Row) -> BodiesBelief:
        """Values and covariances of the bodies."""
        values, ids = self._values(row), row.ids
        covariances = [row.joint(*body.names) for body in self.bodies]
        carriers = self._carriers_of(ids)
        return BodiesBelief(
            np.array([body.number for body in self.bodies], dtype=np.int64),
            values[:, :3],
            values[:, 3:7],
            values[:, 7:10],
            values[:, 10:],
            np.array(covariances).reshape(-1, BODY_SIZE, BODY_SIZE),
            np.array([body.turning for body in self.bodies], dtype=bool),
            tuple(ids[carriers == k] for k in range(len(self.bodies))),
            self.settings,
            self._dt,
        )

    def _carriers_of(self, ids: IntArray) -> IntArray:
        """Index among the bodies that each landmark (N,) is on; -1: none."""
        tracks = self.tracks
        if len(tracks.ids) == 0 or not self.bodies:
            return np.full(len(ids), -1)
        numbers = np.array([body.number for body in self.bodies])
        at = np.minimum(np.searchsorted(tracks.ids, ids), len(tracks.ids) - 1)
        status = np.where(tracks.ids[at] == ids, tracks.status[at], STATIC)
        k = np.minimum(np.searchsorted(numbers, status), len(numbers) - 1)
        return np.where(numbers[k] == status, k, -1)

    def _release(self, row: Row, ids: IntArray) -> None:
        """Take landmarks out of the map; what they are on is not known any longer."""
        self.tracks.status[np.isin(self.tracks.ids, ids)] = FREE
        row.forget(ids)

    def _bear(self, row: Row, index: IntArray, label: int | None = None) -> None:
        """A new body of the tracks at `index`, by the mean of their velocities; they begin anew in the next frame."""
        tracks, position, R_wc = self.tracks, self._positions[0], self._axes[0]
        velocities = self._association().velocities(index)
        covariance = inverse(velocities.weights.sum(axis=0))
        if np.trace(covariance) > _VAGUE**2 or np.median(tracks.uvd[index, 0, 2]) < _FAR * tracks.sigma_d:
            return
        velocity = covariance @ np.einsum("nij,nj->i", velocities.weights, velocities.alone)
        uvd = tracks.uvd[index, 0]
        middle_c = self.camera.backproject([*uvd[:, :2].mean(axis=0), max(float(np.median(uvd[:, 2])), 0.5)])
        turning = self._turns(index, velocity, covariance)
        body = Body(self._next, turning, self._frame, label, *_no_poses())
        self._next += 1
        prior, name = self.settings.prior(body.turning), body.names
        prior[:3, :3] += 2.0 * covariance
        row.clone_pose(name[0])
        self._shift(row, name[0], middle_c, R_wc)
        for number, (start, at) in enumerate(((velocity, slice(0, 3)), (np.zeros(3), slice(3, 6)))):
            row.add(Variable(name[1 + number], start, prior[at, at], in_world=True), {})
        self._release(row, tracks.ids[index])
        tracks.status[index], tracks.strikes[index] = body.number, 0
        body.points[0], body.axes[0] = position + R_wc @ middle_c, R_wc
        self.bodies.append(body)

    def _shift(self, row: Row, name: str, offset_c: FloatArray, R_wc: FloatArray) -> None:
        """Shift a clone of the pose by a vector in its own axes."""
        value, F = row.held_values()[name], np.eye(6)
        F[:3, 3:] = -R_wc @ rotations.skew(offset_c)
        value[:3] += R_wc @ offset_c
        none = np.zeros(0, dtype=np.int64)
        row.move(VariableSteps(((name,),), value[None], F[None], np.zeros((1, 6, 6)), MovedLandmarks.none(6), none))

    def _bury(self, row: Row, body: Body) -> None:
        """Take a body and its landmarks out of the state."""
        self._release(row, self.tracks.ids[self.tracks.status == body.number])
        for name in body.names:
            row.remove(name)
        self.bodies.remove(body)

    # --- a frame ---

    def admit(self, row: Row, observation: StereoObservation, noise: StereoNoise) -> StereoObservation:
        """The measurements that the filter may use: of landmarks on the scene or on a body; ids ascending."""
        self._frame += 1
        self._ids_before = row.ids
        tracks = self.tracks = self.tracks.extended(observation, noise, self.settings.patience)
        index = np.searchsorted(tracks.ids, observation.ids)
        if observation.bodies is not None:
            self._label(index, observation.bodies)
        elif self._frame == 0:
            tracks.status[:] = STATIC
        usable = tracks.status[index] != FREE
        if observation.bodies is None:
            static = np.flatnonzero(tracks.status[index] == STATIC)
            usable[static] = self._thinned(row, observation.uvd[static], np.isin(observation.ids[static], row.ids))
        unusable = np.intersect1d(row.ids, observation.ids[~usable])
        if len(unusable):
            row.forget(unusable)
        return observation if usable.all() else observation.select(usable)

    def _thinned(self, row: Row, uvd: FloatArray, in_map: BoolArray) -> BoolArray:
        """Mask of measurements (M, 3) of the scene that remain if each cell of space has few, those in the map first.

        The scene is what takes up most room, not what has most landmarks: these may be on one bus.
        """
        uvd, camera = uvd.copy(), row.camera
        uvd[:, 2] = np.maximum(uvd[:, 2], 1.0)
        points = rotations.turned(camera.R_wc, self.camera.backproject(uvd)) + camera.position
        order = np.argsort(~in_map, kind="stable")
        _, cells = np.unique(np.floor(points / _CELL).astype(np.int64)[order], axis=0, return_inverse=True)
        cells = cells.ravel()
        by_cell = np.argsort(cells, kind="stable")
        first = np.searchsorted(cells[by_cell], cells[by_cell])
        usable = np.zeros(len(uvd), dtype=bool)
        usable[order[by_cell]] = np.arange(len(uvd)) - first < _MOST
        return usable

    def after(self, row: Row, observation: StereoObservation, report: UpdateReport) -> UpdateReport:
        """Births, deaths, and landmarks that join or leave, after the update with what was admitted."""
        tracks, before = self.tracks, self.tracks.status.copy()
        camera, present = row.camera, {body.number for body in self.bodies}
        _put_first(self._positions, camera.position)
        _put_first(self._axes, camera.R_wc)
        measured = np.unique(tracks.status[tracks.missed == 0])
        for body, value in zip(self.bodies, self._values(row), strict=True):
            _put_first(body.points, value[:3])
            _put_first(body.axes, rotations.matrix(value[3:7]))
            if body.number in measured:
                body.last_measured = self._frame
        for body in [body for body in self.bodies if self._frame - body.last_measured > self.settings.patience]:
            self._bury(row, body)
        if observation.bodies is not None:
            self._bear_labelled(row, observation.ids, observation.bodies)
        self._widen(row)
        gated = np.isin(tracks.ids, report.gated)
        unknown = np.ones(len(tracks.ids), dtype=bool)
        if observation.bodies is not None:
            unknown[np.searchsorted(tracks.ids, observation.ids)] = observation.bodies == FREE
        if unknown.any():
            decision = self._association().decide(gated, unknown)
            if len(decision.released):
                self._release(row, decision.released)
            for group in decision.born:
                self._bear(row, group)
        now, ids = {body.number for body in self.bodies}, row.ids
        started = np.isin(report.initialised, ids)
        waiting = np.setdiff1d(observation.ids, np.concatenate([getattr(report, fate) for fate in _FATES]))
        waiting_known = np.isin(waiting, self._ids_before)
        return replace(
            report,
            initialised=report.initialised[started],
            gated=np.union1d(report.gated, waiting[waiting_known]),
            rejected=np.concatenate([report.rejected, report.initialised[~started], waiting[~waiting_known]]),
            dropped=np.setdiff1d(self._ids_before, ids),
            born=np.array(sorted(now - present), dtype=np.int64),
            died=np.array(sorted(present - now), dtype=np.int64),
            joined=tracks.ids[(tracks.status >= 0) & (tracks.status != before)],
            left=tracks.ids[(before >= 0) & (tracks.status != before)],
        )

    def _width(self, index: IntArray) -> float:
        """Width of what tracks are on, m: by their bearings, at their median disparity."""
        u, d = self.tracks.uvd[index, 0, 0], max(float(np.median(self.tracks.uvd[index, 0, 2])), 0.5)
        return float(np.ptp(u)) * self.camera.disparity_constant / d / self.camera.fx

    def _widen(self, row: Row) -> None:
        """Estimate the turn of bodies that show by now that they are wide, or too fast to be narrow."""
        tracks, settings = self.tracks, self.settings
        for body, value in zip(self.bodies, self._values(row), strict=True):
            mine = np.flatnonzero((tracks.status == body.number) & (tracks.missed == 0))
            if body.turning or len(mine) == 0:
                continue
            body.turning = self._turns(mine, value[7:10], row.joint(body.names[1]))
            if body.turning:  # it may have turned at such a rate since its birth
                sigmas = np.array(settings.sigma_angular_velocity)
                since = np.diag(np.concatenate([sigmas * self._dt * np.isfinite(body.points[:, 0]).sum(), sigmas])) ** 2
                rows = row.rows_of(body.names[::2])
                row.engine.add_noise(row.number, np.concatenate([rows[0][3:], rows[1]]), since)

    def _turns(self, index: IntArray, velocity: FloatArray, covariance: FloatArray) -> bool:
        """Whether the turn of a body with tracks at `index` is estimated: of a wide one, or one surely fast."""
        speed = float(np.linalg.norm(velocity)) - 2.0 * float(np.sqrt(np.trace(covariance)))
        return self._width(index) >= self.settings.smallest_turning or speed > _WALKS

    # --- which body: told ---

    def _association(self) -> Association:
        poses, tracks = (self._positions, self._axes), self.tracks
        return Association(self.camera, self.settings, tracks, tuple(self.bodies), *poses, self._dt)

    def _label(self, index: IntArray, labels: IntArray) -> None:
        """Status of tracks that are told: on the scene, or on a body that is there."""
        status, number_of = self.tracks.status, {body.label: body.number for body in self.bodies}
        status[index[labels == STATIC]] = STATIC
        for label in np.unique(labels[labels >= 0]).tolist():
            status[index[labels == label]] = number_of.get(label, FREE)

    def _bear_labelled(self, row: Row, ids: IntArray, labels: IntArray) -> None:
        """Bodies that are told, have enough old tracks, and are not there."""
        tracks, index = self.tracks, np.searchsorted(self.tracks.ids, ids)
        present = {body.label for body in self.bodies}
        for label in np.unique(labels[labels >= 0]).tolist():
            if label not in present:
                mine = index[labels == label]
                mine = mine[tracks.ages[mine] >= YOUNG]
                if len(mine) >= self.settings.least_points:
                    self._bear(row, mine, label)
