"""Association of landmarks with the scene and with bodies, and groups of them that are a body from now on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from filters.bodies.landmark_tracks import (
    FREE,
    KEPT,
    STATIC,
    Tracks,
    Velocities,
    beside,
    carried_distances,
    inverse,
    squared,
)
from filters.bodies.rigid_bodies import RigidBodies
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera

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
_FEW = 20
"""Landmarks of the scene below which new ones are taken without a proof, far from bodies."""
_GAP = 3.0
"""Gap, m, that parts two bodies."""
_NARROW_REACH = 1.0
"""Distance from the landmarks of a body whose turn is not estimated, m, within which others may join it."""
YOUNG, _PROVEN, _OLD = 3, 6, 9
"""Measurements before a track is judged, before it can begin a body, and before a far one stands."""
_NEAR = 23.0
"""Disparity, in standard deviations of its noise, above which a track stands after `_PROVEN` - 2 measurements."""


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


@dataclass(frozen=True, eq=False)
class Decision:
    """Changes that the state has to follow."""

    released: IntArray
    """(L,): ids of landmarks that are not on what they were taken for."""
    born: Sequence[IntArray]
    """Tracks, by their index, of each new body."""


@dataclass(frozen=True, eq=False)
class Association:
    """Tracks, the bodies that there are, and how camera and bodies have moved in the last frames."""

    camera: StereoCamera
    settings: RigidBodies
    tracks: Tracks
    bodies: Sequence[Body]
    positions: FloatArray
    """(16, 3): positions of the camera, the newest first; NaN before the start."""
    axes: FloatArray
    """(16, 3, 3): its rotations."""
    dt: float
    """Step, s."""

    def decide(self, gated: BoolArray, unknown: BoolArray) -> Decision:
        """Decide for the `unknown` tracks (T,), of which those in `gated` did not fit the map in this frame.

        What they are on from now on is written into the tracks.
        """
        tracks, released, born = self.tracks, np.zeros(len(self.tracks.ids), dtype=bool), list[IntArray]()
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
        tracks.status[leaving] = FREE
        released |= leaving
        ages = tracks.ages
        static_count = int((here & (tracks.status == STATIC)).sum())
        young = np.flatnonzero(here & (tracks.status == FREE) & (ages < YOUNG) & ~leaving)
        if static_count < _FEW and len(young):
            tracks.status[young[self._far_from_bodies(young)]] = STATIC
        free = np.flatnonzero(here & (tracks.status < 0) & (ages >= YOUNG) & ~leaving)
        if len(free):
            out, born = self._judge(free, ages[free], gated[free], static_count < _FEW)
            released[out] = True
        return Decision(tracks.ids[released], born)

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

    def velocities(self, index: IntArray) -> Velocities:
        """Velocities of the tracks at `index`."""
        frames = int(np.isfinite(self.positions[:, 0]).sum())
        return Velocities.of(self.camera, self.tracks, index, (self.positions[:frames], self.axes[:frames]), self.dt)

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

    @cached_property
    def _carriages(self) -> tuple[FloatArray, FloatArray]:
        """Turns (1 + K, 4, 3, 3) and shifts (1 + K, 4, 3) of points over the lags, by the scene, then by each body.

        From the axes of the camera then to those now; NaN where they are not known.
        """
        lags, (p1, R1) = np.array(_LAGS), (self.positions[0], self.axes[0].T)
        p0, R0 = self.positions[lags], self.axes[lags]
        b = np.concatenate([np.zeros((1, KEPT, 3)), *(body.points[None] for body in self.bodies)])
        B = np.concatenate([np.tile(np.eye(3), (1, KEPT, 1, 1)), *(body.axes[None] for body in self.bodies)])
        M = B[:, :1] @ B[:, lags].transpose(0, 1, 3, 2)
        shifts = rotations.turned(M, p0 - b[:, lags]) + b[:, :1] - p1
        return R1 @ M @ R0, rotations.turned(np.broadcast_to(R1, M.shape), shifts)

    def _distances(self, index: IntArray, carrier: IntArray) -> FloatArray:
        """Largest squared distances (n,) over the lags of tracks from where a carrier has brought them; -1: none.

        Carrier 0 is the scene, 1 + k body k.
        """
        tracks, (turns, shifts) = self.tracks, self._carriages
        before, turn, shift = tracks.uvd[index][:, _LAGS], turns[carrier], shifts[carrier]
        measured = np.isfinite(before[:, :, 0]) & np.isfinite(shift[:, :, 0])
        n, lag = np.nonzero(measured)
        now, R = tracks.uvd[index[n], 0], tracks.R[index[n]]
        every = np.full(measured.shape, -1.0)
        every[n, lag] = carried_distances(self.camera, before[n, lag], now, R, turn[n, lag], shift[n, lag])
        largest: FloatArray = every.max(axis=1)
        return largest

    def _judge(self, index: IntArray, ages: IntArray, gated: BoolArray, few: bool) -> tuple[IntArray, list[IntArray]]:
        """Decide for the tracks at `index` whether they stand, are on a body, or move on their own.

        Returns those that stand no longer, and groups that are a body from now on.
        """
        tracks, settings = self.tracks, self.settings
        velocities = self.velocities(index)
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
        tracks.status[index[out]] = FREE
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
        return index[out], self._cluster(index, np.flatnonzero(moving), velocities, table[:, 1:])

    def _cluster(
        self, index: IntArray, moving: IntArray, velocities: Velocities, by_body: FloatArray
    ) -> list[IntArray]:
        """Groups of tracks that move together are of the body that they fit (n, K), or are one from now on."""
        settings, numbers, born = self.settings, [body.number for body in self.bodies], list[IntArray]()
        while len(moving) >= settings.least_points:
            linked = velocities.linked[np.ix_(moving, moving)]
            seed = int(np.argmax(linked.sum(axis=1)))
            group = moving[linked[seed]]
            if len(group) < settings.least_points:
                break
            speed, moving = float(np.linalg.norm(velocities.together[moving[seed]])), np.setdiff1d(moving, group)
            fits = np.median(by_body[group], axis=0) < _FITS
            if fits.any():
                self.tracks.status[index[group]] = numbers[int(np.argmax(fits))]
            elif speed > settings.slowest:
                born.append(index[group])
        return born
