"""Filters in machine code: their storage, and the calls of the kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from filters.camera import StereoCamera
from filters.compiled.blas import ROUTINES
from filters.compiled.frame import (
    ANCHOR,
    BEHIND,
    FAILED,
    GATED,
    ID,
    LEAD,
    OWN,
    REJECTED,
    STARTED,
    USED,
    predict_range,
    update_range,
)
from filters.compiled.geometry import (
    ANGULAR,
    CALIBRATION,
    LINEAR,
    ORIENTATION,
    POSITION,
    PREDICTED,
    VALUES,
)
from filters.compiled.recipe import Recipe
from filters.engine.options import Options
from filters.interface import BodyVelocity, StereoObservation, UpdateReport
from filters.landmarks.model import LandmarkModel
from filters.motions.model import CameraState
from filters.noise import StereoNoise
from filters.state import symmetric
from filters.state.joint_state import JointState
from filters.state.layout import Layout
from filters.validation import BoolArray, FloatArray, IntArray

_NO_ODOMETRY = np.zeros((1, 6)), np.zeros((1, 6, 6)), np.zeros(1, dtype=np.bool_)
_ACTIVE = np.ones(1, dtype=np.bool_)
_NO_RIGHT_ROWS = np.zeros(0)
_ROOM = 24
"""Blocks that a filter has room for at the start."""


class Storage:
    """Values, maps and covariances of `count` filters: arrays with the filter as first dimension, with room to grow.

    The rows of P in use are those of the named variables, padded to a multiple of three, and of the blocks 0 to
    counts[b, 1] - 1. Landmarks are in ascending order of their ids.
    """

    def __init__(self, lead: int, count: int) -> None:
        self.lead = lead
        self.values = np.zeros((count, VALUES))
        self.counts = np.zeros((count, 2), dtype=np.int64)  # landmarks, blocks
        self.P = np.zeros((count, lead, lead))  # the transpose of each is column-major
        self.blocks, self.first_blocks = np.zeros((count, 0, 3)), np.zeros((count, 0, 3))
        self.users = np.zeros((count, 0), dtype=np.int64)
        self.landmarks = np.zeros((count, 0, 3), dtype=np.int64)
        self.held = np.zeros((count, 0), dtype=np.int64)
        self.make_room(_ROOM)

    def make_room(self, blocks: int) -> None:
        """Room for so many blocks a filter, and as many landmarks."""
        have = self.blocks.shape[1]
        if blocks <= have:
            return
        room = max(blocks, have + have // 2)
        size = self.lead + 3 * room
        P = np.zeros((len(self.P), size, size))
        P[:, : self.P.shape[1], : self.P.shape[1]] = self.P
        self.P = P
        for name in ("blocks", "first_blocks", "users", "landmarks"):
            old = getattr(self, name)
            new = np.zeros((len(old), room, *old.shape[2:]), dtype=old.dtype)
            new[:, :have] = old
            setattr(self, name, new)


@dataclass(frozen=True, eq=False)
class CompiledEngine:
    """Some filters of one recipe; many in one call, or one at a time by its number.

    Attributes
    ----------
    recipe : Recipe
        What they do.
    layout : Layout
        Their named variables.
    model : LandmarkModel
        Their parametrisation.
    present : (s,) int64
        Which numbers of the calibration are variables.
    storage : Storage
        What they know.
    """

    recipe: Recipe
    layout: Layout
    model: LandmarkModel
    present: IntArray
    storage: Storage

    def predict(
        self,
        first: int,
        last: int,
        dt: FloatArray,
        odometry: tuple[FloatArray, FloatArray, BoolArray] = _NO_ODOMETRY,
        active: BoolArray = _ACTIVE,
    ) -> None:
        """Predict the filters first to last - 1 that are active; arrays are those of these filters."""
        recipe, store = self.recipe, self.storage
        predict_range(
            ROUTINES,
            recipe.choices,
            recipe.numbers,
            recipe.columns,
            recipe.considered,
            recipe.walk_rates,
            store.P,
            store.values,
            store.blocks,
            store.landmarks,
            store.counts,
            first,
            last,
            dt,
            *odometry,
            active,
        )

    def update(
        self,
        first: int,
        last: int,
        offsets: IntArray,
        ids: IntArray,
        uvd: FloatArray,
        R: FloatArray,
        v_right: FloatArray = _NO_RIGHT_ROWS,
        active: BoolArray = _ACTIVE,
    ) -> Outcome:
        """Update the filters first to last - 1 that are active, the i-th with the measurements offsets[i] to offsets[i + 1] - 1.

        Parameters
        ----------
        first, last : int
            Filters.
        offsets : (last - first + 1,) int64
            Where the measurements of each begin, and where the last ones end.
        ids, uvd, v_right : (M,), (M, 3), (M,) or (0,)
            Measurements, ids ascending in each filter; NaN where v_right is not measured.
        R : (M, 3, 3) or (1, 3, 3)
            Covariance of each, or of all.
        """
        recipe, store, count = self.recipe, self.storage, last - first
        self.make_room(first, last, offsets)
        fates, results = np.empty(len(ids), dtype=np.uint8), np.empty((count, 2))
        dropped = np.empty((count, store.landmarks.shape[1]), dtype=np.int64)
        dropped_counts = np.empty(count, dtype=np.int64)
        update_range(
            ROUTINES,
            recipe.choices,
            recipe.numbers,
            recipe.columns,
            recipe.considered,
            recipe.stages,
            recipe.rows_of_stages,
            recipe.limits,
            recipe.copied,
            store.P,
            store.values,
            store.blocks,
            store.first_blocks,
            store.landmarks,
            store.users,
            store.counts,
            store.held,
            first,
            last,
            offsets,
            ids,
            uvd,
            R,
            v_right,
            fates,
            results,
            dropped,
            dropped_counts,
            active,
        )
        return Outcome(offsets, ids, fates, results, dropped, dropped_counts)

    def make_room(self, first: int, last: int, offsets: IntArray) -> None:
        """Room for what these measurements can start; not while another thread runs filters of this engine."""
        counts = self.storage.counts[first:last, 1] + 2 * np.diff(offsets)
        self.storage.make_room(int(counts.max(initial=0)))

    def load(self, number: int, state: JointState) -> None:
        """Take over a state."""
        store, layout, camera = self.storage, self.layout, state.camera
        used = np.delete(np.arange(len(state.blocks)), state.empty_blocks)
        place = np.full(len(state.blocks) + 1, -1)
        place[used] = np.arange(len(used))
        store.make_room(max(len(used), len(state)))
        for start, values in ((0, camera), (PREDICTED, state.predicted)):
            row = store.values[number, start:]
            row[POSITION : POSITION + 3], row[ORIENTATION : ORIENTATION + 4] = values.position, values.orientation
            row[LINEAR : LINEAR + 3], row[ANGULAR : ANGULAR + 3] = values.linear_velocity, values.angular_velocity
            for value in values.variables.values():
                row[CALIBRATION + self.present] = value
        blocks = len(used)
        rows = np.concatenate([layout.rows, store.lead + np.arange(3 * blocks)])
        P = store.P[number]
        P[: store.lead + 3 * blocks, : store.lead + 3 * blocks] = 0.0
        kept = np.concatenate([layout.rows, state.block_rows(used)])
        P[np.ix_(rows, rows)] = np.tril(state.P[np.ix_(kept, kept)]).T
        store.blocks[number, :blocks], store.first_blocks[number, :blocks] = (
            state.blocks[used],
            state.first_blocks[used],
        )
        order = np.argsort(state.ids)
        table = store.landmarks[number, : len(state)]
        table[:, ID], table[:, OWN] = state.ids[order], place[state.parameter_block[order]]
        table[:, ANCHOR] = place[state.anchor_block[order]]
        store.held = np.full((len(store.values), len(state.held)), -1)
        store.held[number] = place[state.held]
        users = np.concatenate([table[:, OWN], table[:, ANCHOR], store.held[number]])
        store.users[number] = 0
        store.users[number, :blocks] = np.bincount(users[users >= 0], minlength=blocks)
        store.counts[number] = len(state), blocks

    def state(self, number: int) -> JointState:
        """A copy of what filter `number` knows, as the NumPy engine has it."""
        store, layout = self.storage, self.layout
        count, blocks = store.counts[number]
        rows = np.concatenate([layout.rows, store.lead + np.arange(3 * blocks)])
        table = store.landmarks[number, :count]
        return JointState(
            layout,
            self._camera(store.values[number]),
            store.P[number][np.ix_(rows, rows)].T,
            self.model,
            self._camera(store.values[number, PREDICTED:]),
            store.blocks[number, :blocks].copy(),
            store.first_blocks[number, :blocks].copy(),
            table[:, ID].copy(),
            table[:, OWN].copy(),
            table[:, ANCHOR].copy(),
            held=store.held[number].copy(),
        )

    def camera(self, number: int) -> CameraState:
        """Values of the named variables of a filter."""
        return self._camera(self.storage.values[number])

    def _camera(self, values: FloatArray) -> CameraState:
        row = values.copy()
        variables = {x.name: row[CALIBRATION + self.present] for x in self.layout.variables}
        return CameraState(
            row[POSITION : POSITION + 3],
            row[ORIENTATION : ORIENTATION + 4],
            row[LINEAR : LINEAR + 3],
            row[ANGULAR : ANGULAR + 3],
            variables,
        )


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of the measurements of an update; see `frame.update_range`."""

    offsets: IntArray
    ids: IntArray
    fates: IntArray
    results: FloatArray
    dropped: IntArray
    dropped_counts: IntArray

    def report(self, i: int) -> UpdateReport:
        """Of the i-th filter of the call."""
        part = slice(self.offsets[i], self.offsets[i + 1])
        ids, fates = self.ids[part], self.fates[part]
        nis, dof = self.results[i].tolist()
        told: dict[str, Any] = {"dropped": self.dropped[i, : self.dropped_counts[i]]}
        if fates.any():
            names = {"updated": USED, "behind_camera": BEHIND, "gated": GATED, "failed": FAILED}
            names |= {"initialised": STARTED, "rejected": REJECTED}
            told |= {name: ids[fates == fate] for name, fate in names.items()}
        else:
            told["updated"] = ids
        return UpdateReport(**told, nis=nis, nis_dof=int(dof))


@dataclass(eq=False)
class CompiledFilter:
    """One filter of an engine: what `StereoEKF` asks of it.

    Attributes
    ----------
    engine : CompiledEngine
        Its engine, perhaps with others.
    number : int
        Which one it is.
    """

    engine: CompiledEngine
    number: int = 0

    @classmethod
    def of(cls, camera: StereoCamera, options: Options) -> CompiledFilter:
        """A filter with a storage of its own."""
        recipe = Recipe.of(camera, options)
        return cls(engine_of(recipe, options, 1))

    def predict(self, dt: float, odometry: BodyVelocity | None) -> None:
        """Move the belief forward by dt, then fuse what odometry adds."""
        self.engine.predict(self.number, self.number + 1, np.array([dt]), packed_odometry(odometry))

    def update(self, observation: StereoObservation, noise: StereoNoise) -> UpdateReport:
        """Use the frame; ids ascending."""
        ids, uvd, right = observation.ids.copy(), observation.uvd.copy(), observation.v_right
        R = noise.R[None].copy() if observation.R is None else observation.R.copy()
        v_right = _NO_RIGHT_ROWS if right is None else right.copy()
        if len(ids) == 0:
            R = noise.R[None].copy()
        return self.engine.update(self.number, self.number + 1, np.array([0, len(ids)]), ids, uvd, R, v_right).report(0)

    @property
    def state(self) -> JointState:
        """A copy of what it knows; to be assigned after a change."""
        return self.engine.state(self.number)

    @state.setter
    def state(self, state: JointState) -> None:
        self.engine.load(self.number, state)

    @property
    def ids(self) -> IntArray:
        """Landmarks in the map, ascending."""
        store = self.engine.storage
        return store.landmarks[self.number, : store.counts[self.number, 0], ID].copy()

    @property
    def camera(self) -> CameraState:
        """Values of the named variables."""
        return self.engine.camera(self.number)

    def covariance(self, place: slice) -> FloatArray:
        """Covariance of some of the named variables."""
        return symmetric.full(self.engine.storage.P[self.number, place, place].T)


def engine_of(recipe: Recipe, options: Options, count: int) -> CompiledEngine:
    """An engine for `count` filters of these options."""
    present = np.flatnonzero(recipe.columns >= 0)
    storage = Storage(int(recipe.choices[LEAD]), count)
    return CompiledEngine(recipe, options.layout, options.landmark, present, storage)


def packed_odometry(odometry: BodyVelocity | None) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Odometry of one filter as the kernels take it: (1, 6), (1, 6, 6), (1,)."""
    if odometry is None:
        return _NO_ODOMETRY
    mean = np.concatenate([odometry.linear, odometry.angular])[None]
    return mean, odometry.covariance[None].copy(), np.ones(1, dtype=np.bool_)
