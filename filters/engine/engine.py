"""The engine: the EKF of one filter or of many, called with plain arrays."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any

import numpy as np

from filters.engine.frame_arrays import FrameOutcome, Observations, Odometry
from filters.engine.recipes import compiled_calls
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.kernels.calls import Packed, raise_failure
from filters.kernels.entries import (
    CLONE,
    CLOSE_GAPS,
    FORGET,
    carry_along,
    change,
    compile_forecasts,
    correct_by,
    forecasts,
    points_at,
)
from filters.kernels.frame import run_frames
from filters.kernels.recipe import Recipe
from filters.kernels.records import (
    BLOCKS,
    LANDMARKS,
    FilterState,
    FrameArrays,
    Scratch,
    Storage,
    empty_frame,
    empty_storage,
    exported,
    grown,
    load,
    scratch,
)

_ROOM = 32  # blocks, at first


_NOTHING = FrameOutcome(np.zeros(0, dtype=np.uint8), np.zeros(0), np.zeros(0, dtype=np.int64), ())
"""Of a step without measurements."""


def _run(*arguments: Any) -> None:
    """Run frames, and raise what a function of a part has raised."""
    run_frames(*arguments)
    raise_failure()


class Engine:
    """The EKF of `count` filters that all do the same.

    Parameters
    ----------
    recipe : Recipe
        What they do.
    count : int
        Number of filters.
    threads : int
        Over which a call is spread.
    """

    def __init__(self, recipe: Recipe, count: int = 1, threads: int = 1) -> None:
        self.recipe = recipe
        self.count = count
        self.threads = max(1, min(threads, count))
        self._fuses = self._odometry_there = False
        self._calls = self._compiled()
        self._plan = Packed(recipe.plan)
        self._storage = Packed(empty_storage(recipe, count, _ROOM))
        self._frame = Packed(empty_frame(recipe, count, _ROOM, 1))
        self._scratch: list[Packed] = []
        self._most = self._rows = self._width = 0
        self._pool: ThreadPoolExecutor | None = None
        self._make_room(_ROOM, 8)

    def assume(self, recipe: Recipe) -> None:
        """Go on with a recipe of the same parts and sizes: another drift, another gauge walk."""
        self.recipe = recipe
        self._calls = self._compiled()
        self._plan = Packed(recipe.plan)

    def __getstate__(self) -> dict[str, Any]:
        """State that a copy needs: it packs arrays of its own."""
        names = ("recipe", "count", "threads", "storage")
        return {name: getattr(self, name) for name in names}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["recipe"], state["count"], state["threads"])  # type: ignore[misc]
        storage = type(state["storage"])(*(np.array(array) for array in state["storage"]))
        self._storage = Packed(storage)
        self._frame = Packed(empty_frame(self.recipe, self.count, storage.ids.shape[1], 1))
        self._scratch = []
        self._make_room(0, 8)

    @property
    def storage(self) -> Storage:
        """State of the filters."""
        storage: Storage = self._storage.value
        return storage

    @property
    def frame(self) -> FrameArrays:
        """Input of the frame."""
        frame: FrameArrays = self._frame.value
        return frame

    def scratch(self, thread: int) -> Scratch:
        """Room of a thread."""
        room: Scratch = self._scratch[thread].value
        return room

    def points(self, values: FloatArray, points: FloatArray, by_own: FloatArray) -> None:
        """Write homogeneous points of landmarks, from their anchors, and the Jacobians by their errors, zero before."""
        points_at(self._calls.address, self.recipe.plan.landmark, values, points, by_own)
        raise_failure()

    def reset(self, index: int, x: FloatArray, P: FloatArray) -> None:
        """Start filter `index` again with leading values x (values,) and covariance P (leading, leading)."""
        none = np.zeros(0, dtype=np.int64)
        nothing = np.zeros((0, self.recipe.block_values))
        self.load(index, FilterState(x, x, P, nothing, nothing, none, np.zeros((0, 3)), none, none, none, none))

    def load(self, index: int, state: FilterState) -> None:
        """Put the state of filter `index` there."""
        self._make_room(len(state.blocks), 1)
        load(self.storage, index, state)

    def export(self, index: int) -> FilterState:
        """A copy of the state of filter `index`."""
        return exported(self.storage, self.recipe, index)

    def clone_pose(self, index: int) -> None:
        """Keep the present pose of filter `index` as two held blocks, those of the last clone."""
        self._make_room(int(self.storage.counts[index, BLOCKS]) + 2, 1)
        self._change(index, CLONE)

    def hold(self, index: int, state: FilterState, rows: IntArray, J: FloatArray) -> None:
        """Add held blocks to filter `index`: values, kinds and walks of `state`, errors J e + those with its P.

        e are the errors at `rows`.
        """
        count, size = len(state.blocks), self.recipe.plan.size
        self._make_room(int(self.storage.counts[index, BLOCKS]) + count, 1)
        S, old = self.storage, int(self.storage.counts[index, BLOCKS])
        n, P = self.recipe.plan.leading + size * old, S.P[index]
        every, new = np.arange(n), slice(n, n + size * count)
        given = P[np.minimum(rows[:, None], every), np.maximum(rows[:, None], every)]
        P[:n, new] = (J @ given).T
        P[new, new] = J @ given[:, rows] @ J.T + state.P
        blocks = slice(old, old + count)
        S.blocks[index, blocks] = S.first[index, blocks] = state.blocks
        S.kind[index, blocks], S.walk[index, blocks], S.users[index, blocks] = state.kind, state.walk, 1
        held = int((S.held[index] >= 0).sum())
        S.held[index, held : held + count] = np.arange(old, old + count)
        S.counts[index, BLOCKS] += count

    def add_noise(self, index: int, rows: IntArray, Q: FloatArray) -> None:
        """Add process noise Q (w, w) to P of filter `index` at these rows."""
        P = self.storage.P[index]
        P[np.minimum(rows[:, None], rows), np.maximum(rows[:, None], rows)] += Q

    def move(self, index: int, rows: IntArray, columns: IntArray, T: FloatArray) -> None:
        """P = T P T^T of filter `index`, T the identity but for C rows with at most k numbers each.

        Row `rows[i]` has T[i, j] in column columns[i, j], (C, k) both; -1 where it has no more.
        """
        n = self.recipe.plan.leading + self.recipe.plan.size * int(self.storage.counts[index, BLOCKS])
        sources, places = np.unique(columns, return_inverse=True)
        places, count = places.reshape(columns.shape), len(rows)
        if len(sources) and sources[0] < 0:
            sources, places = sources[1:], places - 1
        room = np.empty((len(sources), n)), np.empty((count, n)), np.empty((count, count))
        T = np.array(T, dtype=np.float64, order="C")
        carry_along(self._storage.address, index, rows, sources, np.ascontiguousarray(places), T, *room)

    def release(self, index: int, blocks: IntArray) -> None:
        """Hold these blocks of filter `index` no longer; those that no landmark uses leave the map."""
        held, users = self.storage.held[index], self.storage.users[index]
        freed_blocks = held[(held >= 0) & ~np.isin(held, blocks)]
        users[blocks] -= 1
        held[:] = -1
        held[: len(freed_blocks)] = freed_blocks
        self._change(index, CLOSE_GAPS)

    def forget(self, index: int, ids: IntArray) -> None:
        """Marginalise landmarks of filter `index` out; ids that are not in its map are ignored."""
        landmarks = self.storage.counts[index, LANDMARKS]
        self._make_room(0, int(landmarks))
        self.scratch(0).gone[:landmarks] = np.isin(self.storage.ids[index, :landmarks], ids)
        self._change(index, FORGET)

    def correct(
        self, index: int, rows: IntArray, H: FloatArray, innovation: FloatArray, R: FloatArray, limit: float
    ) -> tuple[float, bool]:
        """Correct filter `index` with a measurement that is linear in the errors at `rows`.

        Parameters
        ----------
        rows : (w,) int64
            Rows of P.
        H : (k, w)
            By the errors there.
        innovation, R : (k,), (k, k)
            Measured minus predicted, and its noise.
        limit : float
            Squared distance up to which it is believed.

        Returns
        -------
        float
            Normalised innovation squared; -1 where its covariance has no Cholesky factor.
        bool
            Whether it was used.
        """
        self._make_room(0, 1, *H.shape)
        arguments = np.array(H, order="C"), np.array(innovation), np.array(R, order="C")
        at = self._calls.address, self._plan.address, self._storage.address, self._scratch[0].address
        with self._unless_failed(np.arange(self.count) == index):
            correct_by(*at, index, rows, *arguments, limit)
            raise_failure()
        nis, used = self.scratch(0).result.tolist()
        return nis, bool(used)

    def forecast(self, which: slice, noise: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Predicted (u, v, d), (M, 3), and S, (M, 3, 3), of all landmarks of adjacent filters, and which are in front.

        `noise` (F, 3, 3) is of each filter.
        """
        compile_forecasts()
        counts = self.storage.counts[which, LANDMARKS]
        self._make_room(0, int(counts.max(initial=0)))
        offsets = np.concatenate([[0], np.cumsum(counts)])
        total = int(offsets[-1])
        uvd, S, in_front = np.empty((total, 3)), np.empty((total, 3, 3)), np.empty(total, dtype=np.bool_)
        at = self._calls.address, self._plan.address, self._storage.address, self._scratch[0].address
        forecasts(*at, which.start, offsets, np.array(noise, order="C"), uvd, S, in_front)
        raise_failure()
        return uvd, S, in_front

    def step(
        self, dt: FloatArray | float, observations: Observations | None, odometry: Odometry | None = None
    ) -> FrameOutcome:
        """Predict by dt (B,) s, zero for none, and update, without returning to Python in between."""
        o = observations
        M = 0 if o is None else len(o.ids)
        if len(self.frame.ids) < M:
            self._frame_with(measurements=M + M // 4)
        self._make_room(0, M if o is None or self.count == 1 else int(np.diff(o.offsets).max(initial=0)))
        self.frame.dt[:] = dt
        if odometry is not None or self._odometry_there:
            self._put_odometry(odometry)
        frame = self.frame
        frame.nis[:], frame.dof[:], frame.outcome[:] = 0.0, 0, 0
        if o is None:
            frame.seen[:] = False
            frame.offsets[:] = 0
        else:
            frame.seen[:], frame.offsets[:], frame.with_right[:] = o.seen, o.offsets, o.with_right
            frame.ids[:M], frame.uvd[:M], frame.R[:M] = o.ids, o.uvd, o.R
            if o.v_right is not None:
                frame.v_right[:M] = o.v_right
        with self._unless_failed(frame.seen | (frame.dt > 0.0)):
            self._run()
            needed = int(frame.outcome[0, 1] if self.count == 1 else frame.outcome[:, 1].max())
            if needed:  # for these filters nothing has happened yet
                late = frame.outcome[:, 1] > 0
                frame.dt[~late], frame.seen[~late] = 0.0, False
                self._make_room(needed, 0)
                frame = self._frame_with(blocks=self.storage.ids.shape[1])
                self._run()
        if o is None:
            return _NOTHING
        dropped = tuple(frame.dropped[b, :gone].copy() for b, gone in enumerate(frame.outcome[:, 0].tolist()))
        return FrameOutcome(frame.fates[:M].copy(), frame.nis.copy(), frame.dof.copy(), dropped)

    def _put_odometry(self, odometry: Odometry | None) -> None:
        """Rows of the odometry of each filter: velocities and their covariance, or an inertial unit and its samples."""
        frame = self.frame
        self._odometry_there = odometry is not None
        frame.fused[:], frame.odometry_rows[:] = False, 0
        if odometry is None:
            return
        if not self._fuses and odometry.fused.any():  # the first odometry
            self._fuses = True
            self._calls = self._compiled()
        frame = self._frame_with(odometry=odometry.rows.shape[1:])
        frame.fused[:], frame.odometry_rows[:] = odometry.fused, odometry.counts
        K, w = odometry.rows.shape[1:]
        frame.odometry[:, :K, :w] = odometry.rows

    def _frame_with(self, blocks: int = 0, measurements: int = 0, odometry: tuple[int, int] = (0, 0)) -> FrameArrays:
        """The frame, with room for at least these, and with what it brings already."""
        frame = self.frame
        sizes_now = frame.dropped.shape[1], len(frame.ids), *frame.odometry.shape[1:]
        sizes_wanted = blocks, measurements, *odometry
        if all(most <= size for most, size in zip(sizes_wanted, sizes_now, strict=True)):
            return frame
        blocks, measurements, K, w = map(max, sizes_wanted, sizes_now)
        larger = empty_frame(self.recipe, self.count, blocks, measurements, (K, w))
        for old, new in zip(frame, larger, strict=True):
            new[tuple(slice(0, size) for size in old.shape)] = old
        self._frame = Packed(larger)
        return larger

    def _compiled(self) -> Packed:
        """Addresses of what the frame calls: units, functions of parts, LAPACK."""
        return Packed(compiled_calls(self.recipe, self._fuses and self.recipe.plan.odometry_rows > 0))

    @contextmanager
    def _unless_failed(self, which: BoolArray) -> Iterator[None]:
        """Put these filters back where a function of a part raises an error."""
        saved = [(b, self.export(b)) for b in np.flatnonzero(which).tolist()] if self.recipe.in_python else []
        try:
            yield
        except BaseException:
            for b, state in saved:
                self.load(b, state)
            raise

    def _change(self, index: int, what: int) -> None:
        change(self._plan.address, self._storage.address, self._scratch[0].address, index, what)

    def _run(self) -> None:
        calls, plan, storage, frame = (one.address for one in (self._calls, self._plan, self._storage, self._frame))
        if self.threads == 1:
            _run(calls, plan, storage, self._scratch[0].address, frame, 0, self.count)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads)
        edges = [self.count * i // self.threads for i in range(self.threads + 1)]
        runs = [
            self._pool.submit(_run, calls, plan, storage, room.address, frame, first, last)
            for room, first, last in zip(self._scratch, edges[:-1], edges[1:], strict=True)
        ]
        wait(runs)
        for run in runs:
            run.result()

    def _make_room(self, blocks: int, measurements: int, rows: int = 0, width: int = 0) -> None:
        """Room for so many blocks of a filter, measurements of a frame, rows and columns of one measurement."""
        larger = blocks > self.storage.blocks.shape[1]
        has_room = self._scratch and not larger and measurements <= self._most
        if has_room and rows <= self._rows and width <= self._width:
            return
        if larger:
            self._storage = Packed(grown(self.storage, self.recipe, blocks + blocks // 4))
        room = max(self._most, measurements), max(self._rows, rows), max(self._width, width)
        self._most, self._rows, self._width = room
        self._scratch = [Packed(scratch(self.recipe, self.storage, *room)) for _ in range(self.threads)]
