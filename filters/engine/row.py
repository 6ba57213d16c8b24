"""One filter of an engine: its options as a recipe, and its state as the engine keeps it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from filters.contract.inputs import StereoObservation
from filters.contract.noise import StereoNoise
from filters.contract.outputs import UpdateReport
from filters.contract.validation import require_known
from filters.contract.variables import VELOCITY
from filters.engine.doors import Parts, anchor_poses, clones_at
from filters.engine.engine import Engine
from filters.engine.frames import FrameOutcome, Observations, Odometry, ValuePlaces
from filters.engine.options import Options
from filters.errors.error_definition import ErrorKernels
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.machine_code import settings_of
from filters.geometry.retractions import ADDITIVE
from filters.kernels import storage as fates
from filters.kernels.lift import compiled_functions
from filters.kernels.recipe import Plan, Recipe, stage_tables
from filters.kernels.storage import CLONE_POSITION, CLONE_ROTATION, OWN, POINT, FilterState
from filters.measurements.measurement_model import MeasurementModel
from filters.motions.motion_model import CameraState, StepInput
from filters.parts import SLOTS
from filters.state.joint_state import JointState

_FATES = {
    "updated": fates.USED,
    "initialised": fates.STARTED,
    "gated": fates.GATED,
    "rejected": fates.REJECTED,
    "behind_camera": fates.BEHIND,
    "failed": fates.FAILED,
}


def recipe_of(camera: StereoCamera, options: Options) -> Recipe:
    """What a filter does, in plain numbers; where parts have no kernels, by their numbers."""
    layout, model, sensor, motion = options.layout, options.landmark, options.measurement, options.motion
    landmark, error = compiled_functions(model), compiled_functions(options.error)
    # Kernels know no other linearisation point and no other constraint than those of `FirstEstimates`.
    own_jacobians = error is None and (options.error.constrains or not options.error.linearises_at_the_state)
    own_stages = type(sensor).stages is not MeasurementModel.stages
    seen = None if own_stages else compiled_functions(sensor)
    driven = None if own_jacobians else compiled_functions(motion)
    by_numbers = own_jacobians or landmark is None or seen is None or not compiled_functions(options.update)
    sigma_points = options.update.sigma_points(layout.measured + 3 * model.anchored + model.size)
    by_numbers |= bool(sigma_points) and landmark is not None and landmark.turn is None and not model.additive
    turns = error is not None and error.turns
    moves_by_numbers = (
        error is None
        or (landmark is None and (turns or not model.additive))
        or any(variable.retraction is not ADDITIVE for variable in layout.variables)
    )
    has_place = landmark is not None and (model.anchored or landmark.turn is None)
    values, flags = ValuePlaces(layout), error or ErrorKernels()
    v = layout.places[VELOCITY].start
    tables = ((), ()) if by_numbers else (sensor.rows(False), sensor.rows(True))
    prior = np.zeros((0, 0)) if model.prior is None else np.array(model.prior, dtype=np.float64)
    plan = Plan(
        camera=np.array((camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline)),
        landmark=_settings(model, landmark),
        sensor=_settings(sensor, None if by_numbers else seen),
        motion=_settings(motion, driven),
        size=model.size,
        prior=prior,
        memory=np.inf if model.memory is None else float(model.memory),
        anchors=2 if model.in_anchor else int(model.anchored),
        shares_anchors=model.shares_anchors,
        additive=model.additive,
        points=landmark is not None and landmark.turn is None,
        follows=_places(model.follows),
        additive_quaternion=flags.additive_quaternion,
        first_estimates=flags.first_estimates,
        turns=flags.turns,
        resets=flags.turns and options.error.reset,
        by_numbers=by_numbers,
        moves_by_numbers=moves_by_numbers,
        changes=not model.steady,
        most_landmarks=options.max_landmarks or 0,
        walks_by_numbers=bool(options.gauge_walk) and (own_jacobians or not has_place),
        driven_by_numbers=driven is None,
        odometry_rows=0 if driven is None else driven.rows,
        consensus=options.consensus,
        tail_dof=np.inf if options.tail_dof is None else float(options.tail_dof),
        iterations=options.iterations,
        relinearise_above=float(options.relinearise_above),
        drop_unseen=options.drop_unseen,
        sigma_points=np.array(() if by_numbers else sigma_points),
        min_disparity=-np.inf if options.min_disparity is None else float(options.min_disparity),
        measured=layout.measured,
        velocity=v,
        sees_velocity=layout.sees_velocity,
        leading=layout.size,
        sensed=_places(values.of_variables(tuple(variable.name for variable in sensor.variables))),
        moved=_places(() if driven is None else values.of_camera(motion.moves[2:])),
        moved_rows=_places(() if driven is None else layout.rows_of(motion.moves)),
        in_world=_places([layout.places[x.name].start for x in layout.variables if x.in_world]),
        considered=layout.considered,
        walk=np.zeros(layout.size) if layout.walk_rates is None else layout.walk_rates,
        drift=np.zeros((2, 4)) if options.drift is None else options.drift.parts,
        gauge_walk=float(options.gauge_walk),
        **stage_tables(tables, sensor.size, options.gate),
    )
    return Recipe(
        plan,
        landmark,
        None if by_numbers else seen,
        driven,
        sensor.size,
        model.value_size,
        model.seen_size,
        values.size,
        tuple(getattr(options, slot) for slot in SLOTS if not compiled_functions(getattr(options, slot))),
    )


def _settings(part: object, kernels: Any) -> FloatArray:
    return np.zeros(0) if kernels is None else settings_of(part, kernels)


def _places(numbers: Sequence[int] | IntArray) -> IntArray:
    return np.array(numbers, dtype=np.int64)


@dataclass(eq=False)
class Row:
    """One filter of an engine: what `StereoEKF` asks of it."""

    engine: Engine
    """Its engine, perhaps with others."""
    options: Options
    """Of the filter."""
    number: int = 0
    """Which filter of the engine it is."""
    clones: list[str] = field(default_factory=list)
    """Names of the clones of the pose, in the order in which they were made."""

    @classmethod
    def of(cls, camera: StereoCamera, options: Options) -> Row:
        """A filter with an engine of its own."""
        return cls(Engine(recipe_of(camera, options), parts=Parts(camera, options)), options)

    def assume(self, camera: StereoCamera, options: Options) -> None:
        """Go on with another drift and gauge walk; of an engine with this filter alone."""
        self.engine.assume(recipe_of(camera, options), Parts(camera, options))
        self.options = options

    def predict(self, dt: float, odometry: StepInput | None) -> None:
        """Move the belief forward by dt, then fuse what odometry adds."""
        steps = np.zeros(self.engine.count)
        steps[self.number] = dt
        if odometry is None:
            self.engine.step(steps, None)
            return
        given: list[StepInput | None] = [None] * self.engine.count
        given[self.number] = odometry
        self.engine.step(steps, None, Odometry.of(given))

    def update(self, observation: StereoObservation, noise: StereoNoise) -> UpdateReport:
        """Use the frame; ids ascending."""
        seen = np.zeros(self.engine.count, dtype=np.bool_)
        seen[self.number] = True
        count = len(observation)
        offsets = np.zeros(self.engine.count + 1, dtype=np.int64)
        offsets[self.number + 1 :] = count
        R = noise.R if observation.R is None else observation.R
        right = observation.v_right
        packed = Observations(seen, offsets, observation.ids, observation.uvd, R, seen & (right is not None), right)
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
        clones: dict[str, IntArray] = {}
        if self.clones:
            of_clones = (layout.size + size * self._clone_blocks()[:, :, None] + np.arange(3)).reshape(-1, 6)
            clones = dict(zip(self.clones, of_clones, strict=True))
        found: list[IntArray] = []
        for name in names:
            if isinstance(name, tuple):
                found.append(np.concatenate(self.rows_of(name)))
                continue
            if isinstance(name, str):
                if name in clones:
                    found.append(clones[name])
                    continue
                require_known("there is no variable", [name], [*layout.places, *clones])
                found.append(layout.rows[layout.places[name]])
                continue
            (index,) = np.nonzero(self.ids == name)
            if len(index) == 0:
                raise ValueError(f"ids must be in the map, not there: {name}: see landmarks.ids")
            anchor, own = S.anchor[b, index[0]], layout.size + size * S.own[b, index[0]] + np.arange(size)
            there = layout.size + size * anchor[anchor >= 0, None] + np.arange(3)
            found.append(np.concatenate([there.ravel(), own]))
        return found

    def _clone_blocks(self) -> IntArray:
        """Blocks of position and rotation of each clone, (C, 2)."""
        S, b = self.engine.storage, self.number
        held = S.held[b][S.held[b] >= 0]
        blocks: IntArray = held[np.flatnonzero(S.kind[b, held] == CLONE_POSITION)[:, None] + np.arange(2)]
        return blocks

    def clone_pose(self, name: str) -> None:
        """Keep the present pose as a variable of that name."""
        self.engine.clone_pose(self.number)
        self.clones.append(name)

    def forget_clone(self, name: str) -> None:
        """Marginalise a clone out."""
        self.engine.release(self.number, self._clone_blocks()[self.clones.index(name)])
        self.clones.remove(name)

    def clone_values(self) -> dict[str, FloatArray]:
        """Position and orientation of each clone, (7,)."""
        position, rotation = self._clone_blocks().T
        values = self.engine.storage.blocks[self.number]
        return dict(zip(self.clones, np.hstack([values[position, :3], values[rotation, :4]]), strict=True))

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
        clones = clones_at(state.blocks, state.kind, state.held)
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
            state.anchor[:, 0],
            held=state.held,
            clones={**dict(zip(self.clones, clones.values(), strict=True)), **anchor_poses(state.blocks, state.anchor)},
        )

    @state.setter
    def state(self, state: JointState) -> None:
        own, size = state.parameter_block, state.blocks.shape[1]
        blocks, first = np.zeros((2, len(state.blocks), self.engine.recipe.block_values))
        kind = np.full(len(blocks), POINT)
        blocks[:, :size], first[:, :size] = state.blocks, state.first_blocks
        free = state.anchor_block < 0
        plan = self.engine.recipe.plan
        points = free & (plan.changes or plan.points)
        kind[own[~points]] = OWN
        turns = np.full(len(state), -1)
        if state.model.in_anchor:
            turns = state.anchor_poses()[2]
        for clone in state.clones.values():
            position, rotation = clone.blocks
            kind[position], kind[rotation] = CLONE_POSITION, CLONE_ROTATION
            for values in (blocks, first):
                values[position, :3], values[rotation, :4] = clone.position, clone.orientation
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
                ids=state.ids,
                own=own,
                anchor=np.column_stack([state.anchor_block, turns]),
                held=state.held,
            ),
        )
        self.clones = [name for name in state.clones if isinstance(name, str)]

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
    told = {name: ids[fates == fate] for name, fate in _FATES.items()} if fates.any() else {"updated": ids}
    return UpdateReport(
        **told, dropped=outcome.dropped[number], nis=float(outcome.nis[number]), nis_dof=int(outcome.dof[number])
    )
