"""Birth, step and death of the bodies of one filter, and the choice of which landmarks are on them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from filters.bodies.rigid_bodies import BODY_SIZE, BodiesBelief, BodyStep, RigidBodies
from filters.bodies.tracks import FREE, KEPT, STATIC, Tracks, Velocities, beside, carried_distances, inverse, squared
from filters.contract.inputs import StereoObservation
from filters.contract.noise import StereoNoise
from filters.contract.outputs import MovedLandmarks, UpdateReport, Variable, VariableSteps
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera

if TYPE_CHECKING:
    from filters.engine.row import Row

_LAGS = (2, 4, 8, 15)
"""Frames over which a track is compared with the scene and with a body."""
_FITS = 16.3
"""Squared distance up to which a track fits: chi-square of 3, 99.9 %."""
_MOVES, _MOVE_TOGETHER = 20.0, 35.0
"""Squared distance from the scene above which a track moves, alone, or by the mean velocity of its neighbours."""
_STANDS = 12.0
"""Squared distance from the scene below which a track may stand."""
_BETTER_ON_BODY, _BETTER_ON_SCENE = 8.0, 3.0
"""Differences of squared distances that decide for a body, or for the scene beside one."""
_GAIN = 2.0
"""Squared distance by which the velocity of its neighbours must suit a track better than none, to begin a body."""
_COMPANY = 2
"""Neighbours on the scene that a new track agrees with, to be taken for one of them."""
_CELL, _MOST = 3.0, 2
"""Side of a cell of space, m, and how many landmarks of the scene are used in one."""
_FEW = 20
"""Landmarks of the scene below which new ones are taken without a proof, far from bodies."""
_VAGUE, _FAR = 3.0, 10.0
"""Standard deviation of the first velocity, m/s, above which, and disparity in standard deviations of its noise below
which no body is born: neither depth nor velocity is nearly Gaussian yet."""
_GAP = 3.0
"""Gap, m, that parts two bodies."""
_NARROW_REACH = 1.0
"""Distance from the landmarks of a body whose turn is not estimated, m, within which others may join it."""
_YOUNG, _PROVEN, _OLD = 3, 6, 9
"""Measurements before a track is judged, before it can begin a body, and before a far one stands."""
_NEAR = 23.0
"""Disparity, in standard deviations of its noise, above which a track stands after `_PROVEN` - 2 measurements."""


_FATES = ("updated", "initialised", "gated", "rejected", "behind_camera", "failed")


@dataclass(eq=False)
class Body:
    """A body in the state."""

    number: int
    turning: bool
    last_measured: int
    """Last frame in which one of its landmarks was measured."""
    label: int | None
    """The body's number in observations that name it."""
    points: FloatArray
    """(16, 3): its point in the last frames, W, the newest first; NaN before its birth."""
    axes: FloatArray
    """(16, 3, 3): its axes."""

    @property
    def names(self) -> tuple[str, str, str]:
        """Variables of its pose, its velocity and its angular velocity."""
        name = f"body-{self.number}"
        return name, f"{name}-velocity", f"{name}-turn"


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
        velocities = self._velocities(index)
        covariance = inverse(velocities.weights.sum(axis=0))
        if np.trace(covariance) > _VAGUE**2 or np.median(tracks.uvd[index, 0, 2]) < _FAR * tracks.sigma_d:
            return
        velocity = covariance @ np.einsum("nij,nj->i", velocities.weights, velocities.alone)
        uvd = tracks.uvd[index, 0]
        middle = np.array([*uvd[:, :2].mean(axis=0), max(float(np.median(uvd[:, 2])), 0.5)])
        body = Body(self._next, self._width(index) >= self.settings.smallest_turning, self._frame, label, *_no_poses())
        self._next += 1
        prior, name = self.settings.prior(body.turning), body.names
        prior[:3, :3] += 2.0 * covariance
        row.clone_pose(name[0])
        self._shift(row, name[0], self.camera.backproject(middle), R_wc)
        for number, (start, at) in enumerate(((velocity, slice(0, 3)), (np.zeros(3), slice(3, 6)))):
            row.add(Variable(name[1 + number], start, prior[at, at], in_world=True), {})
        self._release(row, tracks.ids[index])
        tracks.status[index], tracks.strikes[index] = body.number, 0
        body.points[0], body.axes[0] = position + R_wc @ self.camera.backproject(middle), R_wc
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
            self._associate(row, gated, unknown)
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
        """Estimate the turn of bodies that show enough width by now."""
        tracks, settings = self.tracks, self.settings
        for body in self.bodies:
            mine = np.flatnonzero((tracks.status == body.number) & (tracks.missed == 0))
            if not body.turning and len(mine) and self._width(mine) >= settings.smallest_turning:
                body.turning = True
                prior = np.diag(settings.sigma_angular_velocity) ** 2
                row.engine.add_noise(row.number, row.rows_of([body.names[2]])[0], prior)

    # --- which body: told ---

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
                mine = mine[tracks.ages[mine] >= _YOUNG]
                if len(mine) >= self.settings.least_points:
                    self._bear(row, mine, label)

    # --- which body: found out ---

    def _associate(self, row: Row, gated: BoolArray, unknown: BoolArray) -> None:
        tracks = self.tracks
        here = unknown & (tracks.missed == 0)
        on_body = here & (tracks.status >= 0)
        misfit, mine = gated.copy(), np.flatnonzero(on_body)
        if len(mine):
            carrier = 1 + np.searchsorted([body.number for body in self.bodies], tracks.status[mine])
            both = self._distances(np.concatenate([mine, mine]), np.concatenate([carrier, 0 * carrier]))
            by_body, by_scene = both.reshape(2, -1)
            misfit[mine] |= (by_body > _FITS) | ((by_body >= 0.0) & (by_body > by_scene + _BETTER_ON_BODY))
        tracks.strikes[on_body] = np.where(misfit[on_body], tracks.strikes[on_body] + 1, 0)
        leaving = on_body & ((tracks.strikes >= 2) | self._apart(on_body))
        if leaving.any():
            self._release(row, tracks.ids[leaving])
        ages = tracks.ages
        static_count = int((here & (tracks.status == STATIC)).sum())
        young = np.flatnonzero(here & (tracks.status == FREE) & (ages < _YOUNG) & ~leaving)
        if static_count < _FEW and len(young):
            tracks.status[young[self._far_from_bodies(young)]] = STATIC
        free = np.flatnonzero(here & (tracks.status < 0) & (ages >= _YOUNG) & ~leaving)
        if len(free):
            self._judge(row, free, ages[free], gated[free], static_count < _FEW)

    def _apart(self, on_body: BoolArray) -> BoolArray:
        """Mask of tracks with a gap to most others of their body: two that move alike are one until it shows."""
        tracks, apart = self.tracks, np.zeros(len(self.tracks.ids), dtype=bool)
        for body in self.bodies:
            mine = np.flatnonzero(on_body & (tracks.status == body.number))
            if len(mine) > self.settings.least_points:
                uvd = tracks.uvd[mine, 0]
                linked = beside(self.camera, uvd, uvd, _GAP, tracks.sigma_d)
                part, count = linked[linked.sum(axis=1).argmax()], 0
                while part.sum() > count:
                    count, part = part.sum(), linked[part].any(axis=0)
                apart[mine] = ~part
        return apart

    def _velocities(self, index: IntArray) -> Velocities:
        frames = min(self._frame + 1, KEPT)
        return Velocities.of(self.camera, self.tracks, index, (self._positions[:frames], self._axes[:frames]), self._dt)

    def _far_from_bodies(self, index: IntArray) -> BoolArray:
        """Mask of tracks that are on no body for certain, wherever their depth may be."""
        far = np.ones(len(index), dtype=bool)
        for body in self.bodies:
            far &= ~self._beside(index, body)
        return far

    def _beside(self, index: IntArray, body: Body) -> BoolArray:
        """Mask of tracks that may be on a body, by where they are."""
        tracks = self.tracks
        members = np.flatnonzero((tracks.status == body.number) & (tracks.missed == 0))
        reach = self.settings.reach if body.turning else _NARROW_REACH
        return np.asarray(
            beside(self.camera, tracks.uvd[index, 0], tracks.uvd[members, 0], reach, tracks.sigma_d).any(axis=1)
        )

    def _carriages(self) -> tuple[FloatArray, FloatArray]:
        """Turns (1 + K, 4, 3, 3) and shifts (1 + K, 4, 3) of points over the lags, by the scene, then by each body.

        From the axes of the camera then to those now; NaN where they are not known.
        """
        lags, (p1, R1) = np.array(_LAGS), (self._positions[0], self._axes[0].T)
        p0, R0 = self._positions[lags], self._axes[lags]
        b = np.concatenate([np.zeros((1, KEPT, 3)), *(body.points[None] for body in self.bodies)])
        B = np.concatenate([np.tile(np.eye(3), (1, KEPT, 1, 1)), *(body.axes[None] for body in self.bodies)])
        M = B[:, :1] @ B[:, lags].transpose(0, 1, 3, 2)
        shifts = rotations.turned(M, p0 - b[:, lags]) + b[:, :1] - p1
        return R1 @ M @ R0, rotations.turned(np.broadcast_to(R1, M.shape), shifts)

    def _distances(self, index: IntArray, carrier: IntArray) -> FloatArray:
        """Largest squared distances (n,) over the lags of tracks from where a carrier has brought them; -1: none.

        Carrier 0 is the scene, 1 + k body k.
        """
        tracks, (turns, shifts) = self.tracks, self._carriages()
        before, turn, shift = tracks.uvd[index][:, _LAGS], turns[carrier], shifts[carrier]
        measured = np.isfinite(before[:, :, 0]) & np.isfinite(shift[:, :, 0])
        n, lag = np.nonzero(measured)
        now, R = tracks.uvd[index[n], 0], tracks.R[index[n]]
        every = np.full(measured.shape, -1.0)
        every[n, lag] = carried_distances(self.camera, before[n, lag], now, R, turn[n, lag], shift[n, lag])
        largest: FloatArray = every.max(axis=1)
        return largest

    def _judge(self, row: Row, index: IntArray, ages: IntArray, gated: BoolArray, few: bool) -> None:
        """Decide for the tracks at `index` whether they stand, are on a body, or move on their own."""
        tracks, settings = self.tracks, self.settings
        velocities = self._velocities(index)
        close = [np.flatnonzero(self._beside(index, body)) for body in self.bodies]
        everyone = np.arange(len(index))
        tried = np.concatenate([everyone, *close])
        carrier = np.repeat(np.arange(1 + len(close)), [len(index), *map(len, close)])
        distances = self._distances(index[tried], carrier)
        table = np.full((len(index), 1 + len(close)), np.inf)
        table[tried, carrier] = np.where((carrier > 0) & (distances < 0.0), np.inf, distances)
        by_scene, near = np.maximum(table[:, 0], 0.0), np.bincount(tried, minlength=len(index)) > 1
        table[:, 0] = np.inf
        best = np.argmin(table, axis=1)
        by_body = table[everyone, best]
        which = np.array([FREE, *(body.number for body in self.bodies)])[best]
        speeds = np.linalg.norm(velocities.together, axis=1)
        surprise = squared(velocities.together, inverse(velocities.covariances))
        many = velocities.linked.sum(axis=1) >= settings.least_points
        moves = (by_scene > _MOVES) | (many & (surprise > _MOVE_TOGETHER) & (speeds > settings.slowest))
        tracks.strikes[index] = np.where(moves | gated, tracks.strikes[index] + 1, 0)
        joins = (by_body < _FITS) & (by_scene > by_body + _BETTER_ON_BODY)
        static = tracks.status[index] == STATIC
        out = static & ((tracks.strikes[index] >= 2) | (joins & moves))
        if out.any():
            self._release(row, tracks.ids[index[out]])
        open_ = ~static | out
        joining = open_ & joins
        tracks.status[index[joining]] = which[joining]
        enough = np.where(few | (tracks.uvd[index, 0, 2] > _NEAR * tracks.sigma_d), _PROVEN - 2, _OLD)
        beside_static = velocities.linked[:, static & ~out].sum(axis=1) >= _COMPANY
        beats = np.where(near, by_body > by_scene + _BETTER_ON_SCENE, (ages >= enough) | beside_static)
        stands = open_ & ~joins & ~moves & (by_scene < _STANDS) & beats
        tracks.status[index[stands]] = STATIC
        v, W = velocities.alone, velocities.weights
        gain = squared(v, W) - squared(v - velocities.together, W)
        moving = open_ & ~joins & moves & (ages >= _PROVEN) & (gain > _GAIN)
        if moving.sum() >= settings.least_points:
            self._cluster(row, index, np.flatnonzero(moving), velocities, table[:, 1:])

    def _cluster(
        self, row: Row, index: IntArray, moving: IntArray, velocities: Velocities, by_body: FloatArray
    ) -> None:
        """Groups of tracks that move together are of the body that they fit (n, K), or are one from now on."""
        tracks, numbers = self.tracks, [body.number for body in self.bodies]
        settings = self.settings
        while len(moving) >= settings.least_points:
            linked = velocities.linked[np.ix_(moving, moving)]
            seed = int(np.argmax(linked.sum(axis=1)))
            group = moving[linked[seed]]
            if len(group) < settings.least_points:
                return
            speed, moving = float(np.linalg.norm(velocities.together[moving[seed]])), np.setdiff1d(moving, group)
            fits = np.median(by_body[group], axis=0) < _FITS
            if fits.any():
                tracks.status[index[group]] = numbers[int(np.argmax(fits))]
            elif speed > settings.slowest:
                self._bear(row, index[group])
