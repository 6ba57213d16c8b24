"""One filter of an engine: its options as a recipe, and its state as the engine keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from filters.contract.known_names import require_known
from filters.contract.noise import StereoNoise
from filters.contract.observation import StereoObservation
from filters.contract.odometry import BodyVelocity
from filters.contract.update_report import UpdateReport
from filters.engine.compiled import frame
from filters.engine.compiled.recipe import JOINT, Recipe, StageRows
from filters.engine.compiled.storage import CLONE_POSITION, CLONE_ROTATION, OWN, POINT, FilterState
from filters.engine.doors import Parts, clones_at
from filters.engine.engine import Engine, Observations, Odometry, Outcome
from filters.engine.options import Options
from filters.engine.values import ValuePlaces
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from filters.geometry.retractions import ADDITIVE
from filters.motions.model import POSE_SIZE, CameraState
from filters.parts import SLOTS, kernel_of
from filters.state import symmetric
from filters.state.joint_state import JointState
from filters.validation import FloatArray, IntArray

_U, _V, _U_RIGHT = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, -1.0)
_FATES = {
    "updated": frame.USED,
    "initialised": frame.STARTED,
    "gated": frame.GATED,
    "rejected": frame.REJECTED,
    "behind_camera": frame.BEHIND,
    "failed": frame.FAILED,
}


def recipe_of(camera: StereoCamera, options: Options) -> Recipe:
    """What a filter does, in plain numbers; where parts have no kernel, by their numbers."""
    layout, error = options.layout, kernel_of(options.error)
    landmark, measurement = kernel_of(options.landmark), kernel_of(options.measurement)
    in_world = any(variable.in_world for variable in layout.variables)
    if error in ("right-invariant", "left-invariant") and getattr(options.error, "reset", True):
        error = "invariant"
    by_numbers = landmark is None or measurement is None or kernel_of(options.update) is None
    own_landmarks = landmark is None
    moves_by_numbers = (
        error is None
        or not options.landmark.additive
        or (own_landmarks and error in ("right-invariant", "invariant"))
        or (in_world and error == "right-invariant")
        or any(variable.retraction is not ADDITIVE for variable in layout.variables)
    )
    without, with_right = _stages(measurement, getattr(options.measurement, "copied_row_variance", None))
    calibration = () if by_numbers else getattr(options.measurement, "numbers", ())
    rates, values = layout.walk_rates, ValuePlaces(layout)
    return Recipe(
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        camera.disparity_constant,
        anchored=options.landmark.anchored,
        shares_anchors=options.landmark.shares_anchors,
        value_size=options.landmark.value_size,
        own_landmarks=own_landmarks,
        by_numbers=by_numbers,
        moves_by_numbers=moves_by_numbers,
        walks_by_numbers=bool(options.gauge_walk) and (own_landmarks or in_world),
        changes=not options.landmark.steady,
        parts=tuple(getattr(options, slot) for slot in SLOTS if kernel_of(getattr(options, slot)) is None),
        most_landmarks=options.max_landmarks or 0,
        error=error or "so3",
        stages=without,
        stages_with_right=with_right,
        gate=options.gate,
        consensus=options.consensus,
        tail_dof=options.tail_dof,
        drift=options.drift,
        gauge_walk=options.gauge_walk,
        iterations=options.iterations,
        drop_unseen=options.drop_unseen,
        min_disparity=options.min_disparity,
        motion=kernel_of(options.motion),
        sigma_acceleration=getattr(options.motion, "sigma_acceleration", 0.0),
        sigma_angular_acceleration=getattr(options.motion, "sigma_angular_acceleration", 0.0),
        calibration=calibration,
        measured_others=layout.measured - POSE_SIZE - len(calibration),
        others=layout.size - layout.measured - POSE_SIZE,
        more_values=values.size - layout.size - 1,
        considered=tuple(layout.considered.tolist()),
        walk=() if rates is None else tuple(rates.tolist()),
    )


def _stages(kernel: str | None, copied: float | None) -> tuple[tuple[StageRows, ...], tuple[StageRows, ...]]:
    """Stages of a measurement model without and with a measured right row."""
    left = StageRows((_U, _V))
    if kernel == "left":
        return (left,), (left,)
    if kernel == "sequential":
        right = StageRows((_U_RIGHT,)) if copied is None else StageRows((_U_RIGHT, _V), -1, 1, copied)
        return (left, right), (left, StageRows((_U_RIGHT, _V), 1))
    if kernel == "stacked":
        rows = (_U, _V, _U_RIGHT, _V)
        both = StageRows(rows[:3]) if copied is None else StageRows(rows, -1, 3, copied)
        return (both,), (StageRows(rows, 3, 3),)
    return (JOINT,), (JOINT,)


@dataclass(eq=False)
class Row:
    """One filter of an engine: what `StereoEKF` asks of it.

    Attributes
    ----------
    engine : Engine
        Its engine, perhaps with others.
    options : Options
        Of the filter.
    number : int
        Which filter of the engine it is.
    clones : list of str
        Names of the clones of the pose, in the order in which they were made.
    """

    engine: Engine
    options: Options
    number: int = 0
    clones: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, camera: StereoCamera, options: Options) -> Row:
        """A filter with an engine of its own."""
        return cls(Engine(recipe_of(camera, options), parts=Parts(camera, options)), options)

    def predict(self, dt: float, odometry: BodyVelocity | None) -> None:
        """Move the belief forward by dt, then fuse what odometry adds."""
        steps = np.zeros(self.engine.count)
        steps[self.number] = dt
        if odometry is None:
            self.engine.step(steps, None)
            return
        given: list[BodyVelocity | None] = [None] * self.engine.count
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
        self, innovation: FloatArray, H: Mapping[str | int, FloatArray], R: FloatArray, limit: float
    ) -> tuple[float, bool]:
        """Correct with a measurement that is linear in named variables, clones and landmarks."""
        rows = np.concatenate([self._rows(name) for name in H])
        return self.engine.correct(self.number, rows, np.hstack(list(H.values())), innovation, R, limit)

    def size_of(self, name: str | int) -> int:
        """Error numbers of a variable, a clone, or a landmark by its id.

        Raises
        ------
        ValueError
            There is none.
        """
        return len(self._rows(name))

    def _rows(self, name: str | int) -> IntArray:
        """Rows of a variable, of a clone, or of a landmark: its anchor, if it has one, and its own."""
        layout, S, b = self.options.layout, self.engine.storage, self.number
        if isinstance(name, str):
            require_known("there is no variable", [name], [*layout.places, *self.clones])
            if name in layout.places:
                return layout.rows[layout.places[name]]
            blocks = self._clone_blocks(name)
        else:
            (index,) = np.nonzero(self.ids == name)
            if len(index) == 0:
                raise ValueError(f"ids must be in the map, not there: {name}: see landmarks.ids")
            blocks = np.array([S.anchor[b, index[0]], S.own[b, index[0]]])
            blocks = blocks[blocks >= 0]
        return (layout.size + 3 * blocks[:, None] + np.arange(3)).ravel()

    def _clone_blocks(self, name: str) -> IntArray:
        S, b = self.engine.storage, self.number
        held = S.held[b][S.held[b] >= 0]
        first = np.flatnonzero(S.kind[b, held] == CLONE_POSITION)[self.clones.index(name)]
        blocks: IntArray = held[first : first + 2]
        return blocks

    def clone_pose(self, name: str) -> None:
        """Keep the present pose as a variable of that name."""
        self.engine.clone_pose(self.number)
        self.clones.append(name)

    def forget_clone(self, name: str) -> None:
        """Marginalise a clone out."""
        self.engine.release(self.number, self._clone_blocks(name))
        self.clones.remove(name)

    def clone(self, name: str) -> Pose:
        """Value of a clone."""
        blocks, values = self._clone_blocks(name), self.engine.storage.blocks[self.number]
        return Pose(values[blocks[0], :3].copy(), values[blocks[1], :4].copy())

    def joint(self, *names: str) -> FloatArray:
        """Covariance of the errors of some variables and clones together."""
        rows = np.concatenate([self._rows(name) for name in names])
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
            clones=dict(zip(self.clones, clones_at(state.blocks, state.kind, state.held).values(), strict=True)),
        )

    @state.setter
    def state(self, state: JointState) -> None:
        used = np.delete(np.arange(len(state.blocks)), state.empty_blocks)
        number = np.full(len(state.blocks) + 1, -1)
        number[used] = np.arange(len(used))
        kept = np.concatenate([state.layout.rows, state.block_rows(used)])
        blocks, first = np.zeros((2, len(used), self.engine.recipe.block_values))
        kind, own = np.full(len(used), POINT), number[state.parameter_block]
        size = state.blocks.shape[1]
        blocks[:, :size], first[:, :size] = state.blocks[used], state.first_blocks[used]
        free = state.anchor_block < 0
        points = free & (self.engine.recipe.changes or not self.engine.recipe.own_landmarks)
        kind[own[~points]] = OWN
        for clone in state.clones.values():
            position, rotation = number[clone.blocks]
            kind[position], kind[rotation] = CLONE_POSITION, CLONE_ROTATION
            for values in (blocks, first):
                values[position, :3], values[rotation, :4] = clone.position, clone.orientation
        values_of = ValuePlaces(state.layout)
        self.engine.load(
            self.number,
            FilterState(
                x=values_of.of(state.camera),
                predicted=values_of.of(state.predicted),
                P=symmetric.keep(state.P, kept).T,
                blocks=blocks,
                first=first,
                kind=kind,
                ids=state.ids,
                own=own,
                anchor=number[state.anchor_block],
                held=number[state.held],
            ),
        )
        self.clones = list(state.clones)

    @property
    def ids(self) -> IntArray:
        """Landmarks in the map, ascending."""
        storage = self.engine.storage
        return storage.ids[self.number, : storage.counts[self.number, 0]].copy()

    @property
    def state_size(self) -> int:
        """Rows of the covariance."""
        return self.options.layout.errors + 3 * int(self.engine.storage.counts[self.number, 1])

    @property
    def camera(self) -> CameraState:
        """Values of the named variables."""
        return ValuePlaces(self.options.layout).camera(self.engine.storage.x[self.number].copy())


def report(outcome: Outcome, ids: IntArray, mine: slice, number: int) -> UpdateReport:
    """Report of filter `number`, whose measurements are at `mine`."""
    fates, ids = outcome.fates[mine], ids[mine]
    told = {name: ids[fates == fate] for name, fate in _FATES.items()} if fates.any() else {"updated": ids}
    return UpdateReport(
        **told, dropped=outcome.dropped[number], nis=float(outcome.nis[number]), nis_dof=int(outcome.dof[number])
    )
