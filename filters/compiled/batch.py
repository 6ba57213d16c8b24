"""Many filters in one call, each with its own map, measurements and time step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from filters.compiled.engine import CompiledFilter, Outcome, engine_of
from filters.compiled.recipe import Recipe
from filters.engine.ekf import StereoEKF
from filters.interface import AT_ORIGIN, BodyVelocity, StereoObservation, UpdateReport
from filters.start import Start
from filters.state import symmetric
from filters.validation import BoolArray, FloatArray, IntArray, whole_number

_Odometry = tuple[FloatArray, FloatArray, BoolArray]
_Measurements = tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]


class FilterBatch:
    """Filters of the same parts that run together, in machine code and over threads.

    Each gives the same bits as on its own. `batch[i]` is the i-th as a `StereoEKF`, which reads and writes what the
    batch knows.

    Parameters
    ----------
    make : callable
        Makes one filter; all must have the same parts, options, camera and noise.
    count : int
        Number of filters.
    threads : int
        Threads over which the filters are spread.

    Raises
    ------
    ValueError
        The filters differ, or have no compiled form.
    """

    def __init__(self, make: Callable[[], StereoEKF], count: int, threads: int = 1) -> None:
        whole_number("count", count, 1)
        self.threads = whole_number("threads", threads, 1)
        self._filters = [make() for _ in range(count)]
        first = self._filters[0]
        recipe = _recipe_of(first)
        self._noise = first.noise
        self._engine = engine_of(recipe, first.options, count)
        for number, slam in enumerate(self._filters):
            if _recipe_of(slam) != recipe or not np.array_equal(slam.noise.R, self._noise.R):
                raise ValueError(
                    f"make must give filters of the same parts, options, camera and noise: {number} differs"
                )
            slam.share(CompiledFilter(self._engine, number))
        edges = [count * i // min(threads, count) for i in range(min(threads, count) + 1)]
        self._ranges = list(pairwise(edges))
        self._pool: ThreadPoolExecutor | None = None

    def __len__(self) -> int:
        return len(self._filters)

    def __getitem__(self, number: int) -> StereoEKF:
        return self._filters[number]

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_pool": None}

    def reset(self, start: Start | Sequence[Start] = AT_ORIGIN, which: ArrayLike | None = None) -> None:
        """Start again with empty maps.

        Parameters
        ----------
        start : Start or sequence of Start
            One for all, or one for each of `which`.
        which : (b,) array_like of int, optional
            Numbers of the filters; None: all.
        """
        numbers = range(len(self)) if which is None else np.asarray(which, dtype=np.int64).tolist()
        starts = [start] * len(numbers) if isinstance(start, Start) else list(start)
        if len(starts) != len(numbers):
            raise ValueError(f"start must be one, or one for each of {len(numbers)} filters, got {len(starts)}")
        for number, own in zip(numbers, starts, strict=True):
            self._filters[number].reset(own)

    def predict(self, dt: ArrayLike, odometry: Sequence[BodyVelocity | None] | None = None) -> None:
        """Move the beliefs forward: `dt` > 0 for all or for each, NaN for a filter that is left as it is."""
        steps, active = self._steps(dt)
        packed = self._packed_odometry(odometry, active)
        self._run(lambda first, last: self._predict(first, last, steps, packed, active))

    def update(self, observations: Sequence[StereoObservation | None]) -> Reports:
        """Use the frame of each filter; None leaves a filter as it is."""
        packed, active = self._packed_observations(observations)
        return self._updated(packed, active, lambda first, last: None)

    def step(
        self,
        dt: ArrayLike,
        observations: Sequence[StereoObservation | None],
        odometry: Sequence[BodyVelocity | None] | None = None,
    ) -> Reports:
        """`predict`, then `update`, without a return to Python in between."""
        steps, moving = self._steps(dt)
        drive = self._packed_odometry(odometry, moving)
        packed, active = self._packed_observations(observations)
        return self._updated(packed, active, lambda first, last: self._predict(first, last, steps, drive, moving))

    def step_arrays(self, dt: ArrayLike, ids: ArrayLike, uvd: ArrayLike, odometry: _Odometry | None = None) -> Reports:
        """`step` with arrays, as environments have them.

        Parameters
        ----------
        dt : float or (B,) array_like
            As of `predict`; a filter whose dt is NaN is left as it is.
        ids : (B, N) array_like of int
            Landmarks, unique in each row; -1 where there is no measurement.
        uvd : (B, N, 3) array_like
            Measurements, px; anything where there is none.
        odometry : tuple of (B, 6), (B, 6, 6) and (B,) arrays, optional
            Linear and angular velocity, their covariance, and whether there is any.
        """
        steps, active = self._steps(dt)
        table, measured = np.asarray(ids), np.asarray(uvd, dtype=np.float64)
        if table.shape[:1] != (len(self),) or table.ndim != 2 or measured.shape != (*table.shape, 3):
            raise ValueError(
                f"ids and uvd must have shapes ({len(self)}, N) and ({len(self)}, N, 3), "
                f"got {table.shape} and {measured.shape}"
            )
        order = np.argsort(table, axis=1, kind="stable")
        table = np.take_along_axis(table, order, axis=1).astype(np.int64)
        there = table >= 0
        if (there[:, 1:] & (table[:, 1:] == table[:, :-1])).any():
            raise ValueError("ids must be unique in each row, or -1: keep one measurement per landmark")
        measured = np.take_along_axis(measured, order[:, :, None], axis=1)[there]
        if not np.isfinite(measured).all():
            raise ValueError("uvd must be finite where ids are, got NaN or infinity: set those ids to -1")
        offsets = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
        packed = offsets, table[there], measured, self._noise.R[None].copy(), np.zeros(0)
        drive = self._no_odometry() if odometry is None else odometry
        return self._updated(packed, active, lambda first, last: self._predict(first, last, steps, drive, active))

    @property
    def poses(self) -> FloatArray:
        """Positions (W, m) and orientations (xyzw), (B, 7)."""
        return self._engine.storage.values[:, :7].copy()

    @property
    def pose_covariances(self) -> FloatArray:
        """Covariances of the pose, as in `PoseBelief`, (B, 6, 6)."""
        upper = self._engine.storage.P[:, :6, :6]
        return np.stack([symmetric.full(P.T) for P in upper])

    def _predict(self, first: int, last: int, dt: FloatArray, odometry: _Odometry, active: BoolArray) -> None:
        part = slice(first, last)
        mean, covariance, there = odometry
        self._engine.predict(first, last, dt[part], (mean[part], covariance[part], there[part]), active[part])

    def _updated(self, packed: _Measurements, active: BoolArray, before: Callable[[int, int], None]) -> Reports:
        offsets, ids, uvd, R, v_right = packed
        self._engine.make_room(0, len(self), offsets)

        def run(first: int, last: int) -> Outcome:
            before(first, last)
            part = slice(first, last)
            return self._engine.update(first, last, offsets[first : last + 1], ids, uvd, R, v_right, active[part])

        return Reports(tuple(self._run(run)), tuple(self._ranges))

    def _run(self, job: Callable[[int, int], Any]) -> list[Any]:
        """The job for each range of filters, in threads of their own if there are several."""
        if len(self._ranges) == 1:
            return [job(*self._ranges[0])]
        if self._pool is None:
            self._pool = ThreadPoolExecutor(len(self._ranges), thread_name_prefix="filters")
        return list(self._pool.map(lambda ends: job(*ends), self._ranges))

    def _steps(self, dt: ArrayLike) -> tuple[FloatArray, BoolArray]:
        steps = np.array(np.broadcast_to(np.asarray(dt, dtype=np.float64), (len(self),)))
        active = ~np.isnan(steps)
        if not (np.isfinite(steps[active]) & (steps[active] > 0.0)).all():
            raise ValueError(f"dt must be finite and > 0, or NaN to leave a filter as it is, got {steps.tolist()}")
        return steps, active

    def _no_odometry(self) -> _Odometry:
        count = len(self)
        return np.zeros((count, 6)), np.zeros((count, 6, 6)), np.zeros(count, dtype=np.bool_)

    def _packed_odometry(self, odometry: Sequence[BodyVelocity | None] | None, active: BoolArray) -> _Odometry:
        given = [None] * len(self) if odometry is None else list(odometry)
        if len(given) != len(self):
            raise ValueError(f"odometry must be one for each of {len(self)} filters, got {len(given)}")
        mean, covariance, there = self._no_odometry()
        motion = self._filters[0].options.motion
        for number, own in enumerate(given):
            if own is not None and not isinstance(own, BodyVelocity):
                raise ValueError(f"odometry must be BodyVelocity or None for each filter, got {own!r}")
            if active[number]:
                motion.check_odometry(own)
            if own is not None:
                mean[number, :3], mean[number, 3:] = own.linear, own.angular
                covariance[number], there[number] = own.covariance, True
        return mean, covariance, there

    def _packed_observations(self, observations: Sequence[StereoObservation | None]) -> tuple[_Measurements, BoolArray]:
        if len(observations) != len(self):
            raise ValueError(f"observations must be one for each of {len(self)} filters, got {len(observations)}")
        active = np.array([seen is not None for seen in observations])
        for seen in observations:
            if seen is not None and not isinstance(seen, StereoObservation):
                raise ValueError(f"observations must be StereoObservation or None, got {type(seen).__name__}")
        frames = [_NOTHING if seen is None else seen.ordered() for seen in observations]
        offsets = np.concatenate([[0], np.cumsum([len(frame) for frame in frames])])
        ids, uvd = np.concatenate([f.ids for f in frames]), np.concatenate([f.uvd for f in frames])
        R, v_right = self._noise.R[None].copy(), np.zeros(0)
        if any(frame.R is not None for frame in frames):
            R = np.concatenate([frame.covariances(self._noise) for frame in frames])
        if any(frame.v_right is not None for frame in frames):
            rows = [np.full(len(f), np.nan) if f.v_right is None else f.v_right for f in frames]
            v_right = np.concatenate(rows)
        return (offsets, ids, uvd, R, v_right), active


@dataclass(frozen=True, eq=False)
class Reports(Sequence[UpdateReport]):
    """`UpdateReport` of each filter of a batch, made when it is asked for."""

    outcomes: tuple[Outcome, ...]
    ranges: tuple[tuple[int, int], ...]

    def __len__(self) -> int:
        return self.ranges[-1][1]

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return [self[i] for i in range(*number.indices(len(self)))]
        number = range(len(self))[number]
        for outcome, (first, last) in zip(self.outcomes, self.ranges, strict=True):
            if number < last:
                return outcome.report(number - first)
        raise AssertionError("the ranges cover all filters")


_NOTHING = StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))


def _recipe_of(slam: StereoEKF) -> Recipe:
    if not isinstance(slam, StereoEKF):
        raise ValueError(f"make must give a StereoEKF, got {type(slam).__name__}")
    if slam.compiled is None:
        raise ValueError("make must give filters with a compiled form: see the option compiled of StereoEKF")
    return slam.compiled.engine.recipe
