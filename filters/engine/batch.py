"""`FilterBatch`: many equal filters, each with its own map, through the compiled kernels in one call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeGuard, overload

import numpy as np
from numpy.typing import ArrayLike

from filters.contract.inputs import BodyVelocity, InertialSamples, Start, StereoObservation
from filters.contract.noise import LARGEST_VARIANCE
from filters.contract.outputs import Forecast, UpdateReport
from filters.contract.stereo_filter import (
    AT_ORIGIN,
    LONGEST_STEP,
    StereoFilter,
    check_start,
    check_step,
    time_step,
)
from filters.contract.validation import whole_number
from filters.engine.engine import Engine
from filters.engine.frame_arrays import FrameOutcome, Observations, Odometry
from filters.engine.row import Row, report
from filters.engine.stereo_ekf import StereoEKF
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.kernels.entries import relative_landmarks
from filters.motions.motion_model import input_of


@dataclass(frozen=True, eq=False)
class Reports(Sequence[UpdateReport]):
    """Reports of a batch, each made when it is asked for."""

    offsets: IntArray
    """(B + 1,): measurements of filter b are offsets[b] to offsets[b + 1] - 1, ids ascending."""
    ids: IntArray
    """(M,): measurements of filter b are offsets[b] to offsets[b + 1] - 1, ids ascending."""
    outcome: FrameOutcome
    """What became of them."""

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @overload
    def __getitem__(self, index: int) -> UpdateReport: ...
    @overload
    def __getitem__(self, index: slice) -> list[UpdateReport]: ...
    def __getitem__(self, index: int | slice) -> UpdateReport | list[UpdateReport]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        b = range(len(self))[index]
        return report(self.outcome, self.ids, slice(self.offsets[b], self.offsets[b + 1]), b)


@dataclass(frozen=True, eq=False)
class RelativeLandmarks:
    """The maps of a batch as its cameras see them."""

    offsets: IntArray
    """(B + 1,): landmarks of filter b are offsets[b] to offsets[b + 1] - 1, ids ascending."""
    ids: IntArray
    """(M,): landmarks."""
    points_c: FloatArray
    """(M, 3): positions in the camera frame, m."""
    covariances: FloatArray
    """(M, 3, 3): of those, m^2; errors of the pose and their correlation count."""
    located: BoolArray
    """(M,): whether the landmark is in front of its anchor, at a finite distance."""


@dataclass(frozen=True, eq=False)
class WorldLandmarks:
    """The maps of many filters in W."""

    offsets: IntArray
    """(B + 1,): landmarks of filter b are offsets[b] to offsets[b + 1] - 1, ids ascending."""
    ids: IntArray
    """(M,): landmarks."""
    positions: FloatArray
    """(M, 3), m."""
    covariances: FloatArray
    """(M, 3, 3): of those, m^2."""


def goes_in_a_batch(slam: object) -> TypeGuard[StereoEKF]:
    """Whether a filter may run in a batch."""
    return isinstance(slam, StereoEKF) and slam.does_as_the_engine


class FilterBatch(Sequence[StereoEKF]):
    """Many filters that do the same, each with its own map, observations and time step.

    Every filter has the same bits as if it ran alone, whatever the number of threads.

    Parameters
    ----------
    make : function
        Makes a `StereoEKF`; called once for each filter.
    count : int
        Number of filters.
    threads : int
        Threads over which the filters are spread. They are started when they are first needed.

    Raises
    ------
    ValueError
        A filter does something else than the first one.
    """

    def __init__(self, make: Callable[[], StereoEKF], count: int, threads: int = 1) -> None:
        whole_number("count", count, 1)
        whole_number("threads", threads, 1)
        self._filters = [make() for _ in range(count)]
        for slam in self._filters:
            if not isinstance(slam, StereoEKF):
                raise ValueError(f"make must give a StereoEKF, got {type(slam).__name__}")
        recipes = [slam.engine.recipe for slam in self._filters]
        for index, recipe in enumerate(recipes):
            if not recipe.is_that_of(recipes[0]):
                raise ValueError(f"make must give filters that do the same, filter {index} differs from the first")
        self._engine = Engine(recipes[0], count, threads)
        self.R: FloatArray = np.array([slam.noise.R for slam in self._filters])
        """(B, 3, 3): noise that each filter assumes, px^2."""
        for index, slam in enumerate(self._filters):
            slam.join(Row(self._engine, slam.options, index))

    def __len__(self) -> int:
        return self._engine.count

    @overload
    def __getitem__(self, index: int) -> StereoEKF: ...
    @overload
    def __getitem__(self, index: slice) -> list[StereoEKF]: ...
    def __getitem__(self, index: int | slice) -> StereoEKF | list[StereoEKF]:
        return self._filters[index]

    @property
    def engine(self) -> Engine:
        """The engine of all filters."""
        return self._engine

    @property
    def poses(self) -> FloatArray:
        """Position (W, m) and orientation (xyzw) of every filter; (B, 7)."""
        poses: FloatArray = self._engine.storage.x[:, :7].copy()
        return poses

    @property
    def pose_covariances(self) -> FloatArray:
        """Covariance of the pose errors, as in `PoseBelief`; (B, 6, 6)."""
        return self._covariances(0)

    @property
    def velocities(self) -> FloatArray:
        """Linear (W, m/s) and angular (camera, rad/s) velocity of every filter; (B, 6)."""
        first = self._engine.recipe.plan.velocity + 1  # an orientation has one number more than its error
        velocities: FloatArray = self._engine.storage.x[:, first : first + 6].copy()
        return velocities

    @property
    def velocity_covariances(self) -> FloatArray:
        """Covariance of the velocities, as in `VelocityBelief`; (B, 6, 6)."""
        return self._covariances(self._engine.recipe.plan.velocity)

    def _covariances(self, first: int) -> FloatArray:
        rows = slice(first, first + 6)
        upper = np.triu(self._engine.storage.P[:, rows, rows])
        full: FloatArray = upper + np.triu(upper, 1).transpose(0, 2, 1)
        return full

    @property
    def state_sizes(self) -> IntArray:
        """`StereoEKF.state_size` of every filter, (B,)."""
        options = self._filters[0].options
        sizes: IntArray = options.layout.errors + options.landmark.size * self._engine.storage.counts[:, 1]
        return sizes

    def forecasts(self) -> list[Forecast]:
        """`StereoEKF.forecast` of all landmarks of every filter."""
        uvd, S, in_front = self._engine.forecast(slice(0, len(self)), self.R)
        ids, counts = self._engine.storage.ids, self._engine.storage.counts[:, 0].tolist()
        in_view = in_front & self._filters[0].camera.in_view(uvd)
        ends = np.cumsum(counts).tolist()
        parts = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]
        return [Forecast(ids[b, : counts[b]].copy(), uvd[part], S[part], in_view[part]) for b, part in enumerate(parts)]

    def relative_landmarks(self) -> RelativeLandmarks:
        """The maps of all filters as their cameras see them."""
        return RelativeLandmarks(*self._read_maps(in_world=False))

    def world_landmarks(self) -> WorldLandmarks:
        """The maps of all filters in W: what `StereoEKF.landmarks` has of each."""
        return WorldLandmarks(*self._read_maps(in_world=True)[:4])

    def _read_maps(self, *, in_world: bool) -> tuple[IntArray, IntArray, FloatArray, FloatArray, BoolArray]:
        """Offsets, ids, places, covariances, and which are located."""
        storage = self._engine.storage
        counts = storage.counts[:, 0]
        offsets = np.concatenate([[0], np.cumsum(counts)])
        total = int(offsets[-1])
        ids = storage.ids[np.arange(storage.ids.shape[1]) < counts[:, None]]
        places, covariances, located = np.empty((total, 3)), np.empty((total, 3, 3)), np.empty(total, dtype=np.bool_)
        plan, model = self._engine.recipe.plan, self._filters[0].options.landmark
        filters = np.repeat(np.arange(len(self)), counts)
        block_of_row = storage.own[np.arange(storage.own.shape[1]) < counts[:, None]]
        values = storage.blocks[filters, block_of_row, : model.value_size]
        points, by_own = np.zeros((total, model.seen_size)), np.zeros((total, model.seen_size, model.size))
        self._engine.points(values, points, by_own)
        state = storage.P, storage.x, storage.blocks, storage.own, storage.anchor, storage.counts
        how = plan.leading, plan.anchors > 0, in_world
        relative_landmarks(*state, *how, points, by_own, offsets, places, covariances, located)
        return offsets, ids, places, covariances, located

    def reset(self, starts: Start | Sequence[Start] = AT_ORIGIN) -> None:
        """Start again, with empty maps: all filters alike, or each from its own start."""
        each = [starts] * len(self) if isinstance(starts, Start) else list(starts)
        self._check_length("starts", each)
        for start in each:
            check_start(start)
        for slam, start in zip(self._filters, each, strict=True):
            slam.reset(start)

    def predict(
        self,
        dt: ArrayLike,
        odometry: Sequence[BodyVelocity | None] | None = None,
        inertial: Sequence[InertialSamples | None] | None = None,
    ) -> None:
        """Move every filter forward by dt > 0 s, a number or (B,)."""
        steps = self._steps(dt)
        self._engine.step(steps, None, self._inputs(steps, odometry, inertial))

    def update(self, observations: Sequence[StereoObservation | None]) -> Reports:
        """Use the frame of every filter; None: it has none, and stays as it is."""
        return self._report(0.0, self._packed(observations))

    def step(
        self,
        dt: ArrayLike,
        observations: Sequence[StereoObservation | None],
        odometry: Sequence[BodyVelocity | None] | None = None,
        inertial: Sequence[InertialSamples | None] | None = None,
    ) -> Reports:
        """Predict and update in one call."""
        steps = self._steps(dt)
        return self._report(steps, self._packed(observations), self._inputs(steps, odometry, inertial))

    def step_arrays(self, dt: ArrayLike, ids: IntArray, uvd: FloatArray, R: FloatArray | None = None) -> Reports:
        """Predict and update from arrays of one shape, as vector environments have them.

        Parameters
        ----------
        dt : float or (B,)
            Time steps, s.
        ids : (B, N) int64
            Landmarks; -1 where there is no measurement. Unique for each filter.
        uvd : (B, N, 3)
            Measurements, px.
        R : (B, N, 3, 3), (3, 3) or None
            Noise, px^2; None: of each filter.
        """
        steps = self._steps(dt)
        odometry = self._inputs(steps, None, None)
        ids, uvd = np.asarray(ids), np.asarray(uvd, dtype=np.float64)
        if ids.ndim != 2 or len(ids) != len(self) or ids.dtype.kind not in "iu":
            raise ValueError(f"ids must be integers of shape ({len(self)}, N), got {ids.dtype} {ids.shape}")
        if uvd.shape != (*ids.shape, 3):
            raise ValueError(f"uvd must have shape {(*ids.shape, 3)}, got {uvd.shape}")
        is_tracked = ids >= 0
        order = np.argsort(np.where(is_tracked, ids, np.iinfo(np.int64).max), axis=1, kind="stable")
        counts = is_tracked.sum(axis=1)
        is_measured = np.arange(ids.shape[1]) < counts[:, None]
        rows = np.nonzero(is_measured)[0]
        columns = order[is_measured]
        flat_ids, flat_uvd = ids[rows, columns].astype(np.int64), uvd[rows, columns]
        if not np.isfinite(flat_uvd).all():
            raise ValueError("uvd must be finite, got NaN or infinity: mark those entries by id -1")
        again = (flat_ids[1:] == flat_ids[:-1]) & (rows[1:] == rows[:-1])
        if again.any():
            raise ValueError(f"ids must be unique for each filter, repeated: {flat_ids[1:][again][:5].tolist()}")
        noise = self.R[rows] if R is None else np.asarray(R, dtype=np.float64)
        if R is not None and (noise[..., 2, 2] >= LARGEST_VARIANCE).any():
            raise ValueError("R must be that of measured disparities: give observations of one camera to step")
        if noise.ndim == 4:
            noise = noise[rows, columns]
        offsets = np.concatenate([[0], np.cumsum(counts)])
        everybody = np.ones(len(self), dtype=np.bool_)
        return self._report(steps, Observations(everybody, offsets, flat_ids, flat_uvd, noise, ~everybody), odometry)

    def _report(self, dt: FloatArray | float, packed: Observations, odometry: Odometry | None = None) -> Reports:
        return Reports(packed.offsets, packed.ids, self._engine.step(dt, packed, odometry))

    def _check_length(self, name: str, given: Sequence[object]) -> None:
        if len(given) != len(self):
            raise ValueError(f"{name} must have one entry for each of the {len(self)} filters, got {len(given)}")

    def _steps(self, dt: ArrayLike) -> FloatArray:
        """Time steps (B,) of the filters, s."""
        steps = np.asarray(dt, dtype=np.float64)
        if steps.ndim == 0:
            return np.full(len(self), time_step(steps))
        if steps.shape != (len(self),) or not ((steps > 0.0) & (steps <= LONGEST_STEP)).all():
            allowed = f"numbers above 0 and up to {LONGEST_STEP:g} s, one or ({len(self)},)"
            raise ValueError(f"dt must be {allowed}, got {dt!r}")
        return steps

    def _inputs(
        self,
        steps: FloatArray,
        odometry: Sequence[BodyVelocity | None] | None,
        inertial: Sequence[InertialSamples | None] | None,
    ) -> Odometry | None:
        """Input of the motion for each filter's step; None: there is nothing at all."""
        velocities = [None] * len(self) if odometry is None else list(odometry)
        samples = [None] * len(self) if inertial is None else list(inertial)
        self._check_length("odometry", velocities)
        self._check_length("inertial", samples)
        for each in zip(steps, velocities, samples, strict=True):
            check_step(*each)
        first = self._filters[0]
        if inertial is not None and any(velocities) and first.options.motion.takes is InertialSamples:
            raise ValueError("odometry must be None in a batch with inertial samples: predict filters one by one")
        step_inputs = [input_of(first.options.motion, first, *each) for each in zip(velocities, samples, strict=True)]
        return None if odometry is None and inertial is None else Odometry.of(step_inputs)

    def _packed(self, observations: Sequence[StereoObservation | None]) -> Observations:
        """Observations one after the other, ids ascending."""
        self._check_length("observations", observations)
        for observation in observations:
            if observation is not None and not isinstance(observation, StereoObservation):
                raise ValueError(f"observations must be StereoObservation or None, got {type(observation).__name__}")
        first, is_observed = self._filters[0], np.array([o is not None for o in observations])
        sensor = first.options.measurement
        observations = [None if o is None else sensor.completed(o, first.camera) for o in observations]
        present = [o for o in observations if o is not None]
        counts = np.array([0 if o is None else len(o) for o in observations])
        offsets = np.concatenate([[0], np.cumsum(counts)])
        owner = np.repeat(np.arange(len(self)), counts)
        ids = np.concatenate([o.ids for o in present]) if present else np.zeros(0, dtype=np.int64)
        uvd = np.concatenate([o.uvd for o in present]) if present else np.zeros((0, 3))
        R, right = self.R[owner], np.zeros(len(ids))
        with_right = np.array([o is not None and o.v_right is not None for o in observations])
        for index, observation in enumerate(observations):
            if observation is not None and observation.R is not None:
                R[offsets[index] : offsets[index + 1]] = observation.R
            if observation is not None and observation.v_right is not None:
                right[offsets[index] : offsets[index + 1]] = observation.v_right
        if ((ids[1:] < ids[:-1]) & (owner[1:] == owner[:-1])).any():
            order = np.lexsort((ids, owner))
            ids, uvd, R, right = ids[order], uvd[order], R[order], right[order]
        return Observations(is_observed, offsets, ids, uvd, R, with_right, right)


def world_landmarks(slams: Sequence[StereoFilter]) -> WorldLandmarks:
    """The maps of any filters in W, read one after the other."""
    maps = [slam.landmarks for slam in slams]
    offsets = np.concatenate([[0], np.cumsum([len(each.ids) for each in maps])])
    ids, positions, covariances = (
        np.concatenate([getattr(each, name) for each in maps]) for name in ("ids", "positions", "covariances")
    )
    return WorldLandmarks(offsets, ids, positions, covariances)
