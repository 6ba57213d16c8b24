"""One filter of an engine: its options as a recipe, and its state as the engine keeps it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from filters.contract.inputs import StereoObservation
from filters.contract.noise import StereoNoise
from filters.contract.outputs import UpdateReport, Variable, VariableSteps
from filters.contract.validation import require_known
from filters.engine.carried_landmarks import carried, landmark_positions
from filters.engine.engine import Engine
from filters.engine.frame_arrays import FrameOutcome, Observations, Odometry, ValuePlaces
from filters.engine.options import Options
from filters.engine.recipes import recipe_of
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.joint_state import AddedVariable, Clone, JointState
from filters.kernels import records as fates
from filters.kernels.records import AXES, CLONE_POSITION, CLONE_ROTATION, OWN, PLAIN, POINT, VECTOR, FilterState
from filters.motions.motion_model import CameraState, StepInput

_FATES = {
    "updated": fates.USED,
    "initialised": fates.STARTED,
    "gated": fates.GATED,
    "rejected": fates.REJECTED,
    "behind_camera": fates.BEHIND,
    "failed": fates.FAILED,
}


@dataclass(frozen=True, eq=False)
class Held:
    """Variable whose blocks stand among those that are held, in their order from `first` on."""

    first: int
    count: int
    variable: Variable | None = None
    """None: a clone of the pose."""


def _by_three(numbers: FloatArray, count: int) -> FloatArray:
    """Numbers of a variable as its blocks hold them, (count, 3), with zeros at the end."""
    return np.pad(numbers, (0, 3 * count - len(numbers))).reshape(-1, 3)


def _walk_of(variable: Variable, count: int) -> FloatArray:
    """Variance that the numbers of a variable gain in a second, by blocks."""
    walk = np.zeros(variable.size) if variable.random_walk is None else variable.random_walk
    return _by_three(walk**2, count)


@dataclass(eq=False)
class Row:
    """One filter of an engine: what `StereoEKF` asks of it."""

    engine: Engine
    """Its engine, perhaps with others."""
    options: Options
    """Of the filter."""
    number: int = 0
    """Which filter of the engine it is."""
    held: dict[str, Held] = field(default_factory=dict)
    """Clones of the pose and variables that were added, in the order in which they came."""

    @classmethod
    def of(cls, camera: StereoCamera, options: Options) -> Row:
        """A filter with an engine of its own."""
        return cls(Engine(recipe_of(camera, options)), options)

    def assume(self, camera: StereoCamera, options: Options) -> None:
        """Go on with another drift and gauge walk; of an engine with this filter alone."""
        self.engine.assume(recipe_of(camera, options))
        self.options = options

    def predict(self, dt: float, odometry: StepInput | None) -> None:
        """Move the belief forward by dt, then fuse what odometry adds."""
        steps = np.zeros(self.engine.count)
        steps[self.number] = dt
        if odometry is None:
            self.engine.step(steps, None)
            return
        inputs: list[StepInput | None] = [None] * self.engine.count
        inputs[self.number] = odometry
        self.engine.step(steps, None, Odometry.of(inputs))

    def update(self, observation: StereoObservation, noise: StereoNoise) -> UpdateReport:
        """Use the frame; ids ascending."""
        updated = np.zeros(self.engine.count, dtype=np.bool_)
        updated[self.number] = True
        count = len(observation)
        offsets = np.zeros(self.engine.count + 1, dtype=np.int64)
        offsets[self.number + 1 :] = count
        R = noise.R if observation.R is None else observation.R
        right = observation.v_right
        packed = Observations(
            updated, offsets, observation.ids, observation.uvd, R, updated & (right is not None), right
        )
        return report(self.engine.step(0.0, packed), observation.ids, slice(0, count), self.number)

    def correct(
        self, innovation: FloatArray, rows: IntArray, H: FloatArray, R: FloatArray, limit: float
    ) -> tuple[float, bool]:
        """Correct with a measurement that is linear in the errors at `rows` of P."""
        return self.engine.correct(self.number, rows, H, innovation, R, limit)

    def rows_of(self, names: Iterable[str | int | tuple[str | int, ...]]) -> list[IntArray]:
        """Rows of variables, clones, and landmarks by their ids: of the anchor, if it has one, and of its own.

        Of a tuple of names those of all, one after the other.

        Raises
        ------
        ValueError
            There is none of a name.
        """
        layout, S, b, size = self.options.layout, self.engine.storage, self.number, self.options.landmark.size
        rows: list[IntArray] = []
        for name in names:
            if isinstance(name, tuple):
                rows.append(np.concatenate(self.rows_of(name)))
                continue
            if isinstance(name, str):
                if name in self.held:
                    variable = self.held[name].variable
                    at = (layout.size + size * self.blocks_of(name)[:, None] + np.arange(3)).ravel()
                    rows.append(at if variable is None else at[: variable.size])
                    continue
                require_known("there is no variable", [name], [*layout.places, *self.held])
                rows.append(layout.rows[layout.places[name]])
                continue
            (index,) = np.nonzero(self.ids == name)
            if len(index) == 0:
                raise ValueError(f"ids must be in the map, not there: {name}: see landmarks.ids")
            anchor, own_rows = S.anchor[b, index[0]], layout.size + size * S.own[b, index[0]] + np.arange(size)
            of_anchor = layout.size + size * anchor + np.arange(3 if anchor >= 0 else 0)
            rows.append(np.concatenate([of_anchor, own_rows]))
        return rows

    def blocks_of(self, name: str) -> IntArray:
        """Blocks of a clone or an added variable."""
        one = self.held[name]
        blocks: IntArray = self.engine.storage.held[self.number, one.first : one.first + one.count]
        return blocks

    def _count_held(self) -> int:
        return int((self.engine.storage.held[self.number] >= 0).sum())

    def clone_pose(self, name: str) -> None:
        """Keep the present pose as a variable of that name."""
        first = self._count_held()
        self.engine.clone_pose(self.number)
        self.held[name] = Held(first, 2)

    def add(self, variable: Variable, J: Mapping[Any, FloatArray]) -> None:
        """Add a variable whose error is the sum of J times the errors that it names, and one of its own."""
        size, s, count = self.options.landmark.size, variable.size, -(-variable.size // 3)
        place = (size * np.arange(count)[:, None] + np.arange(3)).ravel()[:s]
        blocks = np.zeros((count, self.engine.recipe.block_values))
        blocks[:, :3] = _by_three(variable.value, count)
        rows = np.concatenate([np.zeros(0, dtype=np.int64), *self.rows_of(J)])
        by_rows, P = np.zeros((size * count, len(rows))), np.zeros((size * count, size * count))
        by_rows[place] = np.hstack([np.zeros((s, 0)), *J.values()])
        P[np.ix_(place, place)] = variable.covariance
        none = np.zeros(0, dtype=np.int64)
        kind = np.full(count, VECTOR if variable.in_world else PLAIN)
        first, x = self._count_held(), np.zeros(0)
        state = FilterState(x, x, P, blocks, blocks, kind, _walk_of(variable, count), none, none, none, none)
        self.engine.hold(self.number, state, rows, by_rows)
        self.held[variable.name] = Held(first, count, variable)

    def move(self, steps: VariableSteps) -> None:
        """Steps of variables and clones, and of the landmarks that these carry along."""
        layout, size, moved = self.options.layout, self.options.landmark.size, steps.landmarks
        places = [self._places(names) for names in steps.names]
        blocks = self.engine.storage.held[self.number, [place for one in places for place, _ in one]]
        within = [number for one in places for _, number in one]
        variable_rows = (layout.size + size * blocks + within).reshape(len(places), -1)
        for rows, Q in zip(variable_rows, steps.Q, strict=True):
            self.engine.add_noise(self.number, rows, Q)
        rows, T = variable_rows.ravel(), steps.F.reshape(-1, variable_rows.shape[1])
        columns = np.repeat(variable_rows, variable_rows.shape[1], axis=0)
        if len(moved.ids):
            own_rows, anchored_rows, by_all = carried(self.engine, self.number, self.options, moved)
            wide = np.hstack([variable_rows[steps.carriers], anchored_rows])
            more = ((0, 0), (0, anchored_rows.shape[1]))
            rows = np.concatenate([rows, own_rows.ravel()])
            columns = np.concatenate([np.pad(columns, more, constant_values=-1), np.repeat(wide, 3, axis=0)])
            T = np.concatenate([np.pad(T, more), by_all.reshape(-1, by_all.shape[2])])
        self.engine.move(self.number, rows, columns, T)
        for names, value in zip(steps.names, steps.values, strict=True):
            self._put_values(names, value)

    def _places(self, names: Iterable[str]) -> list[tuple[int, int]]:
        """Places among the held blocks, and there, of the errors of variables and clones."""
        places = []
        for one in (self.held[name] for name in names):
            count = 6 if one.variable is None else one.variable.size
            places += [(one.first + i // 3, i % 3) for i in range(count)]
        return places

    def _put_values(self, names: Iterable[str], value: FloatArray) -> None:
        """Put the values of variables and clones there, one after the other; they are their first estimates, too."""
        S, b, first = self.engine.storage, self.number, 0
        for one in (self.held[name] for name in names):
            held = S.held[b, one.first : one.first + one.count].tolist()
            if one.variable is None:
                parts = [value[first : first + 3], value[first + 3 : first + 7]]
                S.kind[b, held] = POINT, AXES  # they go with the world, not with where the camera was
                first += 7
            else:
                parts = [value[first + i : first + min(i + 3, one.variable.size)] for i in range(0, 3 * one.count, 3)]
                first += one.variable.size
            for block, numbers in zip(held, parts, strict=True):
                S.blocks[b, block, : len(numbers)] = S.first[b, block, : len(numbers)] = numbers

    def landmark_positions(self, ids: IntArray) -> FloatArray:
        """Positions of landmarks in W, (N, 3) m; of a landmark at infinity they are not finite."""
        return landmark_positions(self.engine, self.number, ids)

    def remove(self, name: str) -> None:
        """Marginalise a clone or an added variable out."""
        block = self.held[name]
        self.engine.release(self.number, self.blocks_of(name))
        del self.held[name]
        for other, one in self.held.items():
            if one.first > block.first:
                self.held[other] = replace(one, first=one.first - block.count)

    def held_values(self) -> dict[str, FloatArray]:
        """Value of each clone, position and orientation (7,), and of each added variable."""
        values, numbers = self.engine.storage.blocks[self.number], dict[str, FloatArray]()
        for name, one in self.held.items():
            blocks = values[self.blocks_of(name)]
            if one.variable is None:
                numbers[name] = np.concatenate([blocks[0, :3], blocks[1, :4]])
            else:
                numbers[name] = blocks[:, :3].ravel()[: one.variable.size]
        return numbers

    def joint(self, *names: str) -> FloatArray:
        """Covariance of the errors of some variables and clones together."""
        rows = np.concatenate(self.rows_of(names))
        P = self.engine.storage.P[self.number]
        covariance: FloatArray = P[np.minimum(rows[:, None], rows), np.maximum(rows[:, None], rows)]
        return covariance

    def forget(self, ids: IntArray) -> None:
        """Marginalise landmarks out; others are ignored."""
        self.engine.forget(self.number, ids)

    @property
    def state(self) -> JointState:
        """A copy of what it knows; to be assigned after a change."""
        state, values = self.engine.export(self.number), ValuePlaces(self.options.layout)
        size = self.options.landmark.value_size
        clones, added = dict[str, Clone](), dict[str, AddedVariable]()
        for name, one in self.held.items():
            blocks = self.blocks_of(name).copy()
            if one.variable is None:
                moves = bool(state.kind[blocks[1]] == AXES)
                clones[name] = Clone(state.blocks[blocks[0], :3], state.blocks[blocks[1], :4], blocks, moves)
            else:
                added[name] = AddedVariable(one.variable, blocks)
        return JointState(
            self.options.layout,
            values.camera(state.x),
            state.P.T,  # the upper triangle of rows is the lower one of columns
            self.options.landmark,
            values.camera(state.predicted),
            state.blocks[:, :size],
            state.first[:, :size],
            state.ids,
            state.own,
            state.anchor,
            held=state.held,
            clones=clones,
            added=added,
        )

    @state.setter
    def state(self, state: JointState) -> None:
        own_blocks, size = state.parameter_block, state.blocks.shape[1]
        blocks, first = np.zeros((2, len(state.blocks), self.engine.recipe.block_values))
        walk = np.zeros((len(blocks), 3))
        kind = np.full(len(blocks), POINT)
        blocks[:, :size], first[:, :size] = state.blocks, state.first_blocks
        free = state.anchor_block < 0
        plan = self.engine.recipe.plan
        points = free & (plan.changes or plan.points)
        kind[own_blocks[~points]] = OWN
        for clone in state.clones.values():
            position, rotation = clone.blocks
            kind[clone.blocks] = (POINT, AXES) if clone.moves else (CLONE_POSITION, CLONE_ROTATION)
            for values in (blocks, first):
                values[position, :3], values[rotation, :4] = clone.position, clone.orientation
        for one in state.added.values():
            kind[one.blocks] = VECTOR if one.variable.in_world else PLAIN
            walk[one.blocks] = _walk_of(one.variable, len(one.blocks))
        values_of = ValuePlaces(state.layout)
        self.engine.load(
            self.number,
            FilterState(
                x=values_of.of(state.camera),
                predicted=values_of.of(state.predicted),
                P=state.P.T,
                blocks=blocks,
                first=first,
                kind=kind,
                walk=walk,
                ids=state.ids,
                own=own_blocks,
                anchor=state.anchor_block,
                held=state.held,
            ),
        )
        places = {block: number for number, block in enumerate(state.held.tolist())}
        self.held = {name: Held(places[int(clone.blocks[0])], 2) for name, clone in state.clones.items()}
        for name, one in state.added.items():
            self.held[name] = Held(places[int(one.blocks[0])], len(one.blocks), one.variable)
        self.held = dict(sorted(self.held.items(), key=lambda item: item[1].first))

    def move_to(self, camera: CameraState) -> None:
        """Put the values of the named variables elsewhere."""
        self.engine.storage.x[self.number] = ValuePlaces(self.options.layout).of(camera)

    @property
    def ids(self) -> IntArray:
        """Landmarks in the map, ascending."""
        storage = self.engine.storage
        ids: IntArray = storage.ids[self.number, : storage.counts[self.number, 0]].copy()
        return ids

    @property
    def state_size(self) -> int:
        """Rows of the covariance."""
        blocks = int(self.engine.storage.counts[self.number, 1])
        return self.options.layout.errors + self.options.landmark.size * blocks

    @property
    def camera(self) -> CameraState:
        """Values of the named variables."""
        return ValuePlaces(self.options.layout).camera(self.engine.storage.x[self.number].copy())


def report(outcome: FrameOutcome, ids: IntArray, mine: slice, number: int) -> UpdateReport:
    """Report of filter `number`, whose measurements are at `mine`."""
    fates, ids = outcome.fates[mine], ids[mine]
    ids_by_fate = {name: ids[fates == fate] for name, fate in _FATES.items()} if fates.any() else {"updated": ids}
    return UpdateReport(
        **ids_by_fate, dropped=outcome.dropped[number], nis=float(outcome.nis[number]), nis_dof=int(outcome.dof[number])
    )
