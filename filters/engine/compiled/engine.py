"""`CompiledEngine`: the compiled EKF of one filter or of many, called from Python with plain arrays."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from filters.engine.compiled.frame import advance, kernels
from filters.engine.compiled.recipe import Recipe
from filters.engine.compiled.storage import (
    FilterState,
    Frame,
    Storage,
    empty_frame,
    empty_storage,
    exported,
    grown,
    load,
    scratch,
)
from filters.engine.compiled.units import Packed
from filters.validation import BoolArray, FloatArray, IntArray

_ROOM = 32  # blocks, at first


@dataclass(frozen=True, eq=False)
class Observations:
    """Measurements of B filters, one after the other.

    Attributes
    ----------
    seen : (B,) bool
        Whether a filter has an observation: one without measurements is something else than none.
    offsets : (B + 1,) int64
        The measurements of filter b are offsets[b] to offsets[b + 1] - 1.
    ids : (M,) int64
        Ascending for each filter.
    uvd : (M, 3)
        Measurements, px.
    R : (M, 3, 3) or (3, 3)
        Their noise, or one for all, px^2.
    with_right : (B,) bool
        Whether the right row is measured on its own.
    v_right : (M,), optional
        The right row, px.
    """

    seen: BoolArray
    offsets: IntArray
    ids: IntArray
    uvd: FloatArray
    R: FloatArray
    with_right: BoolArray
    v_right: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of the measurements.

    Attributes
    ----------
    fates : (M,) uint8
        `frame.USED`, BEHIND, GATED, FAILED, STARTED or REJECTED.
    nis, dof : (B,)
        Normalised innovation squared and its degrees of freedom.
    dropped : tuple of (K,) int64
        Ids that left the map of each filter.
    """

    fates: IntArray
    nis: FloatArray
    dof: IntArray
    dropped: tuple[IntArray, ...]


class CompiledEngine:
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
        self._plan = Packed(recipe.plan)
        self._fuses = False
        self._kernels = kernels(recipe.plan, fuses=False)
        self._storage = Packed(empty_storage(recipe, count, _ROOM))
        self._frame = Packed(empty_frame(count, _ROOM, 1))
        self._scratch: list[Packed] = []
        self._most = 0
        self._pool: ThreadPoolExecutor | None = None
        self._make_room(_ROOM, 8)

    def __getstate__(self) -> dict[str, Any]:
        """What a copy needs: it packs arrays of its own."""
        return {"recipe": self.recipe, "count": self.count, "threads": self.threads, "storage": self.storage}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["recipe"], state["count"], state["threads"])  # type: ignore[misc]
        storage = type(state["storage"])(*(np.array(array) for array in state["storage"]))
        self._storage = Packed(storage)
        self._frame = Packed(empty_frame(self.count, storage.ids.shape[1], 1))
        self._scratch = []
        self._make_room(0, 8)

    @property
    def storage(self) -> Storage:
        """State of the filters."""
        storage: Storage = self._storage.value
        return storage

    def reset(self, index: int, x: FloatArray, P: FloatArray) -> None:
        """Start filter `index` again with leading values x (values,) and covariance P (leading, leading)."""
        none = np.zeros(0, dtype=np.int64)
        nothing = np.zeros((0, 3))
        self.load(index, FilterState(x, x, P, nothing, nothing, none, none, none, none))

    def load(self, index: int, state: FilterState) -> None:
        """Put the state of filter `index` there."""
        self._make_room(len(state.blocks), 1)
        load(self.storage, index, state)

    def export(self, index: int) -> FilterState:
        """A copy of the state of filter `index`."""
        return exported(self.storage, self.recipe, index)

    def predict(
        self,
        dt: FloatArray | float,
        fused: BoolArray | None = None,
        odometry: FloatArray | None = None,
        odometry_covariance: FloatArray | None = None,
    ) -> None:
        """Move the filters forward by dt (B,) s, zero for none; odometry (B, 6) where `fused` (B,)."""
        self.step(dt, None, fused, odometry, odometry_covariance)

    def update(self, observations: Observations) -> Outcome:
        """Use the measurements."""
        return self.step(0.0, observations)

    def step(
        self,
        dt: FloatArray | float,
        observations: Observations | None,
        fused: BoolArray | None = None,
        odometry: FloatArray | None = None,
        odometry_covariance: FloatArray | None = None,
    ) -> Outcome:
        """Predict and update, without returning to Python in between."""
        o = observations
        M = 0 if o is None else len(o.ids)
        if len(self._frame.value.ids) < M:
            self._frame = Packed(empty_frame(self.count, self.storage.ids.shape[1], M + M // 4))
        self._make_room(0, M if o is None or self.count == 1 else int(np.diff(o.offsets).max(initial=0)))
        frame: Frame = self._frame.value
        frame.dt[:] = dt
        if fused is None:
            frame.fused[:] = False
        else:
            if not self._fuses:  # the first odometry
                self._fuses, self._kernels = True, kernels(self.recipe.plan, fuses=not self.recipe.plan.velocity_driven)
            frame.fused[:], frame.odometry[:], frame.odometry_covariance[:] = fused, odometry, odometry_covariance
        frame.nis[:], frame.dof[:], frame.outcome[:] = 0.0, 0, 0
        if o is None:
            frame.seen[:] = False
            frame.offsets[:] = 0
        else:
            frame.seen[:], frame.offsets[:], frame.with_right[:] = o.seen, o.offsets, o.with_right
            frame.ids[:M], frame.uvd[:M], frame.R[:M] = o.ids, o.uvd, o.R
            if o.v_right is not None:
                frame.v_right[:M] = o.v_right
        self._run()
        needed = int(frame.outcome[:, 1].max())
        if needed:  # for these filters nothing has happened yet
            late = frame.outcome[:, 1] > 0
            frame.dt[~late], frame.seen[~late] = 0.0, False
            self._make_room(needed, 0)
            larger = empty_frame(self.count, self.storage.ids.shape[1], len(frame.ids))
            for old, new in zip(frame, larger, strict=True):
                new[tuple(slice(0, size) for size in old.shape)] = old
            self._frame, frame = Packed(larger), larger
            self._run()
        dropped = tuple(frame.dropped[b, :gone].copy() for b, gone in enumerate(frame.outcome[:, 0].tolist()))
        return Outcome(frame.fates[:M].copy(), frame.nis.copy(), frame.dof.copy(), dropped)

    def _run(self) -> None:
        plan, storage, frame = self._plan.address, self._storage.address, self._frame.address
        if self.threads == 1:
            advance(self._kernels, plan, storage, self._scratch[0].address, frame, 0, self.count)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads)
        edges = [self.count * i // self.threads for i in range(self.threads + 1)]
        runs = [
            self._pool.submit(advance, self._kernels, plan, storage, room.address, frame, first, last)
            for room, first, last in zip(self._scratch, edges[:-1], edges[1:], strict=True)
        ]
        for run in runs:
            run.result()

    def _make_room(self, blocks: int, measurements: int) -> None:
        """Room for so many blocks of a filter and measurements of a frame."""
        larger = blocks > self.storage.blocks.shape[1]
        if larger:
            self._storage = Packed(grown(self.storage, self.recipe, blocks + blocks // 4))
        if larger or measurements > self._most or not self._scratch:
            self._most = max(self._most, measurements)
            self._scratch = [Packed(scratch(self.recipe, self.storage, self._most)) for _ in range(self.threads)]
