"""`StereoEKF` in machine code: its options as a recipe, and its state as the compiled engine keeps it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.contract.noise import StereoNoise
from filters.contract.observation import StereoObservation
from filters.contract.odometry import BodyVelocity
from filters.contract.update_report import UpdateReport
from filters.engine.compiled import frame
from filters.engine.compiled.engine import CompiledEngine, Observations, Outcome
from filters.engine.compiled.recipe import JOINT, Recipe, StageRows
from filters.engine.compiled.storage import FilterState
from filters.engine.options import Options
from filters.geometry.camera import StereoCamera
from filters.motions.model import CameraState
from filters.parts import kernel_of
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
    """What a filter does, in plain numbers; all its parts have kernels."""
    layout, error = options.layout, kernel_of(options.error)
    anchored, shares = options.landmark.anchored, options.landmark.shares_anchors
    if error in ("right-invariant", "left-invariant") and getattr(options.error, "reset", True):
        error = "invariant"
    without, with_right = _stages(
        kernel_of(options.measurement), getattr(options.measurement, "copied_row_variance", None)
    )
    rates = layout.walk_rates
    recipe = Recipe(
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        camera.disparity_constant,
        landmark=("shared-anchor" if shares else "inverse-depth") if anchored else "euclidean",
        error=error or "",
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
        motion=kernel_of(options.motion) or "",
        sigma_acceleration=getattr(options.motion, "sigma_acceleration", 0.0),
        sigma_angular_acceleration=getattr(options.motion, "sigma_angular_acceleration", 0.0),
        calibration=getattr(options.measurement, "numbers", ()),
        considered=tuple(layout.considered.tolist()),
    )
    if rates is None:
        return recipe
    walk = np.zeros(recipe.leading)
    walk[: layout.size] = rates
    return Recipe(**{**vars(recipe), "walk": tuple(walk.tolist())})


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
class CompiledFilter:
    """One filter of a compiled engine: what `StereoEKF` asks of it.

    Attributes
    ----------
    engine : CompiledEngine
        Its engine, perhaps with others.
    options : Options
        Of the filter.
    number : int
        Which filter of the engine it is.
    """

    engine: CompiledEngine
    options: Options
    number: int = 0

    @classmethod
    def of(cls, camera: StereoCamera, options: Options) -> CompiledFilter:
        """A filter with an engine of its own."""
        return cls(CompiledEngine(recipe_of(camera, options)), options)

    def predict(self, dt: float, odometry: BodyVelocity | None) -> None:
        """Move the belief forward by dt, then fuse what odometry adds."""
        steps = np.zeros(self.engine.count)
        steps[self.number] = dt
        if odometry is None:
            self.engine.predict(steps)
            return
        values = np.concatenate([odometry.linear, odometry.angular])
        self.engine.predict(steps, steps > 0.0, values, odometry.covariance)

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
        return report(self.engine.update(packed), observation.ids, slice(0, count), self.number)

    @property
    def state(self) -> JointState:
        """A copy of what it knows; to be assigned after a change."""
        state, layout, leading = self.engine.export(self.number), self.options.layout, self.engine.recipe.leading
        P = state.P.T  # the upper triangle of rows is the lower one of columns
        if layout.size < leading:  # what is between them is padding
            P = symmetric.keep(P, np.delete(np.arange(len(P)), np.arange(layout.size, leading)))
        return JointState(
            layout,
            self._camera(state.x),
            P,
            self.options.landmark,
            self._camera(state.predicted),
            state.blocks,
            state.first,
            state.ids,
            state.own,
            state.anchor,
            held=state.held,
        )

    @state.setter
    def state(self, state: JointState) -> None:
        layout, leading = self.options.layout, self.engine.recipe.leading
        used = np.delete(np.arange(len(state.blocks)), state.empty_blocks)
        number = np.full(len(state.blocks) + 1, -1)
        number[used] = np.arange(len(used))
        P = np.zeros((leading + 3 * len(used),) * 2)
        rows = np.concatenate([layout.rows, np.arange(leading, len(P))])
        kept = state.rows_in_use
        P[np.ix_(rows, rows)] = symmetric.full(symmetric.keep(state.P, np.sort(kept)))[np.ix_(*[_ranks(kept)] * 2)]
        self.engine.load(
            self.number,
            FilterState(
                x=self._values(state.camera),
                predicted=self._values(state.predicted),
                P=P,
                blocks=state.blocks[used],
                first=state.first_blocks[used],
                ids=state.ids,
                own=number[state.parameter_block],
                anchor=number[state.anchor_block],
                held=number[state.held],
            ),
        )

    @property
    def ids(self) -> IntArray:
        """Landmarks in the map, ascending."""
        storage = self.engine.storage
        return storage.ids[self.number, : storage.counts[self.number, 0]].copy()

    @property
    def state_size(self) -> int:
        """Rows of the covariance."""
        return self.options.layout.size + 3 * int(self.engine.storage.counts[self.number, 1])

    @property
    def camera(self) -> CameraState:
        """Values of the named variables."""
        return self._camera(self.engine.storage.x[self.number].copy())

    def covariance(self, place: slice) -> FloatArray:
        """Covariance of some of the named variables."""
        return symmetric.full(self.engine.storage.P[self.number, place, place].T)

    def _values(self, camera: CameraState) -> FloatArray:
        """Values of the variables as the engine has them; what is padding is zero."""
        recipe = self.engine.recipe
        x, v = np.zeros(recipe.values), recipe.velocity
        x[:3], x[3:7] = camera.position, camera.orientation
        x[v + 1 : v + 4], x[v + 4 : v + 7] = camera.linear_velocity, camera.angular_velocity
        for name, value in camera.variables.items():
            place = self.options.layout.places[name]
            x[place.start + 1 : place.stop + 1] = value
        return x

    def _camera(self, x: FloatArray) -> CameraState:
        v = self.engine.recipe.velocity
        places = self.options.layout.places
        others = {y.name: x[places[y.name].start + 1 : places[y.name].stop + 1] for y in self.options.layout.variables}
        return CameraState(x[:3], x[3:7], x[v + 1 : v + 4], x[v + 4 : v + 7], others)


def report(outcome: Outcome, ids: IntArray, mine: slice, number: int) -> UpdateReport:
    """Report of filter `number`, whose measurements are at `mine`."""
    fates, ids = outcome.fates[mine], ids[mine]
    told = {name: ids[fates == fate] for name, fate in _FATES.items()} if fates.any() else {"updated": ids}
    return UpdateReport(
        **told, dropped=outcome.dropped[number], nis=float(outcome.nis[number]), nis_dof=int(outcome.dof[number])
    )


def _ranks(numbers: IntArray) -> IntArray:
    """Place of each number among all of them."""
    return np.argsort(np.argsort(numbers))
