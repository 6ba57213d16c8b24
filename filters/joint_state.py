"""The joint state x = (x_C, y_1, ..., y_n) of Eq. 1 with its covariance, as filters built on the engine see it.

The pose comes first, then the variables of the measurement model, so that what a measurement depends on besides its
landmark is one block of leading rows; then velocity and the variables of the motion model; then the map in blocks:
landmarks, anchors and clones of the pose. All blocks have as many rows as a landmark has error numbers; anchors, and
positions and orientations of clones, use the first three, the others are zero. Only the lower triangle of P is valid.
Each operation checks nothing: the filter has done so.

Derivation: docs/derivations/errors.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate

import numpy as np

from filters.contract.inputs import Start
from filters.contract.outputs import POSE, VELOCITY, LandmarkBelief, Variable
from filters.geometry import symmetric
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.landmarks.landmark_model import LandmarkModel, Points
from filters.motions.motion_model import CAMERA_SIZE, POSE_SIZE, VELOCITY_SIZE, CameraState


@dataclass(frozen=True, eq=False)
class StateLayout:
    """Places of the variables."""

    variables: tuple[Variable, ...] = ()
    """Those besides pose and velocity: of the measurement model, then of the motion model."""
    measured: int = POSE_SIZE
    """Leading rows that a measurement depends on."""
    sees_velocity: bool = False
    """Whether the velocity, which stands behind the variables of the measurement model, is among them."""

    @classmethod
    def of(
        cls, measurement: tuple[Variable, ...], motion: tuple[Variable, ...], sees_velocity: bool = False
    ) -> StateLayout:
        """Places of the variables of both models; one that both name is one variable.

        Raises
        ------
        ValueError
            A name stands for two variables.
        """
        names = [variable.name for variable in measurement]
        placed_landmarks = []
        for variable in motion:
            if variable.name not in names:
                placed_landmarks.append(variable)
            elif not any(variable is matched for matched in measurement):
                raise ValueError(
                    f"variable {variable.name!r} is asked for by measurement and motion with different starts: "
                    "give both the same Variable, or two names"
                )
        for entries in (measurement, motion):
            given_names = [variable.name for variable in entries]
            if len(set(given_names)) < len(given_names):
                raise ValueError(f"variables must have different names, got {', '.join(given_names)}")
        rows = POSE_SIZE + sum(variable.size for variable in measurement)
        return cls((*measurement, *placed_landmarks), rows + VELOCITY_SIZE * sees_velocity, sees_velocity)

    @cached_property
    def places(self) -> Mapping[str, slice]:
        """Rows of each variable by name."""
        sizes = [(POSE, POSE_SIZE), *((variable.name, variable.size) for variable in self.variables)]
        stops = list(accumulate(size for _, size in sizes))
        first = self.measured - VELOCITY_SIZE * self.sees_velocity
        sizes.insert(stops.index(first) + 1, (VELOCITY, VELOCITY_SIZE))
        places, row = {}, 0
        for name, size in sizes:
            places[name], row = slice(row, row + size), row + size
        return places

    @cached_property
    def errors(self) -> int:
        """Error numbers of all variables."""
        return CAMERA_SIZE + sum(variable.size for variable in self.variables)

    @cached_property
    def size(self) -> int:
        """Rows before those of the map, a multiple of three: the last ones may be zero."""
        return -(-self.errors // 3) * 3

    @cached_property
    def rows(self) -> IntArray:
        """All of them."""
        return np.arange(self.size)

    @cached_property
    def linear_velocity(self) -> slice:
        """Rows of the linear velocity."""
        first = self.places[VELOCITY].start
        return slice(first, first + 3)

    @cached_property
    def angular_velocity(self) -> slice:
        """Rows of the angular velocity."""
        first = self.places[VELOCITY].start + 3
        return slice(first, first + 3)

    @cached_property
    def considered(self) -> IntArray:
        """Rows of considered variables."""
        rows = [np.arange(self.size)[self.places[x.name]] for x in self.variables if x.considered]
        return np.concatenate([np.zeros(0, dtype=np.int64), *rows])

    @cached_property
    def walk_rates(self) -> FloatArray | None:
        """Variance that the random walks add each second, (size,); None: none walks."""
        if all(variable.random_walk is None for variable in self.variables):
            return None
        rates = np.zeros(self.size)
        for variable in self.variables:
            if variable.random_walk is not None:
                rates[self.places[variable.name]] = variable.random_walk**2
        return rates

    def rows_of(self, names: tuple[str, ...]) -> IntArray:
        """Rows of the variables, in the order of their names."""
        return np.concatenate([np.arange(self.size)[self.places[name]] for name in names])

    def start(self, start: Start) -> tuple[CameraState, FloatArray]:
        """Values and covariance at the start."""
        P = np.zeros((self.size, self.size), order="F")
        camera = self.rows_of((POSE, VELOCITY))
        P[np.ix_(camera, camera)] = start.assumed_covariance
        for variable in self.variables:
            place = self.places[variable.name]
            P[place, place] = variable.covariance
        return CameraState.at(start, {variable.name: variable.value for variable in self.variables}), P


def _no_landmarks() -> IntArray:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Clone:
    """Copy of the pose at some instant: position (3,), orientation (4,), and the two blocks of its errors."""

    position: FloatArray
    orientation: FloatArray
    blocks: IntArray
    moves: bool = False
    """Whether it has been moved since, as the pose of a body."""


@dataclass(frozen=True, eq=False)
class AddedVariable:
    """Variable that came after the start: its blocks hold its value, three numbers each."""

    variable: Variable
    blocks: IntArray


@dataclass(eq=False)
class JointState:
    """Named variables, map and covariance."""

    layout: StateLayout
    """Rows of the named variables."""
    camera: CameraState
    """Their values."""
    P: FloatArray
    """(n, n): covariance of the error state, lower triangle, column-major."""
    model: LandmarkModel
    """Parametrisation of the landmarks."""
    predicted: CameraState
    """The variables before landmarks last corrected them: predicted, then corrected by odometry and `correct`."""
    blocks: FloatArray
    """(B, v): values of the map blocks; block b of s rows is at rows c + s b of P, c the size of the layout. Anchors
    are the first three numbers."""
    first_blocks: FloatArray
    """(B, v): their values when they entered."""
    ids: IntArray = field(default_factory=_no_landmarks)
    """(N,): landmark identities, in the order in which they entered."""
    parameter_block: IntArray = field(default_factory=_no_landmarks)
    """(N,): block of each landmark."""
    anchor_block: IntArray = field(default_factory=_no_landmarks)
    """(N,): block of each landmark's anchor; -1 where there is none."""
    held: IntArray = field(default_factory=_no_landmarks)
    """(H,): blocks that stay whether or not a landmark uses them, in the order in which they were held."""
    clones: dict[str, Clone] = field(default_factory=dict)
    """Clones of the pose by name; their blocks are held."""
    added: dict[str, AddedVariable] = field(default_factory=dict)
    """Variables that came after the start, by name; their blocks are held."""

    @classmethod
    def at(cls, start: Start, layout: StateLayout, model: LandmarkModel) -> JointState:
        """The variables at the start, and nothing seen yet."""
        camera, P = layout.start(start)
        nothing = np.zeros((0, model.value_size))
        return cls(layout, camera, P, model, camera, nothing, nothing)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def size(self) -> int:
        """Rows of a block."""
        return self.model.size

    def parameters(self, index: IntArray | slice = slice(None)) -> FloatArray:
        """Values of the landmarks at `index`, (M, v)."""
        taken: FloatArray = self.blocks[self.parameter_block[index]]
        return taken

    def anchors(self, index: IntArray | slice = slice(None)) -> FloatArray | None:
        """Anchors of the landmarks at `index`, (M, 3), NaN where one has none; None where no landmark has."""
        if not self.model.anchored:
            return None
        block = self.anchor_block[index]
        anchors: FloatArray = self.blocks[block, :3]
        anchors[block < 0] = np.nan
        return anchors

    def map_rows(self, index: IntArray) -> IntArray:
        """Rows of P that belong to each landmark, anchor first; (M, size) or (M, 3 + size).

        Where there are anchors, a landmark without one has its own first rows twice.
        """
        own_rows = self.own_rows(index)
        if not self.model.anchored:
            return own_rows
        anchor, block = self.anchor_block[index], self.parameter_block[index]
        first = self.layout.size + self.size * np.where(anchor < 0, block, anchor)
        return np.hstack([first[:, None] + np.arange(3), own_rows])

    def own_rows(self, index: IntArray | slice = slice(None)) -> IntArray:
        """Rows of P of the landmarks themselves, without their anchors; (M, size)."""
        rows: IntArray = self.layout.size + self.size * self.parameter_block[index, None] + np.arange(self.size)
        return rows

    def block_rows(self, blocks: IntArray) -> IntArray:
        """Rows of P that belong to map blocks, in their order; (M,) -> (size M,)."""
        return (self.layout.size + self.size * blocks[:, None] + np.arange(self.size)).ravel()

    def append(self, values: FloatArray, first: FloatArray, cross: FloatArray, own: FloatArray) -> IntArray:
        """Add M blocks that belong to no landmark yet, and hold them.

        Parameters
        ----------
        values, first : (M, v)
            Now, and when they were first estimated.
        cross, own : (size M, n), (size M, size M)
            Their covariance with all rows of P as it is, and among themselves.

        Returns
        -------
        (M,) int64
            The new blocks.
        """
        old, count = len(self.P), len(self.blocks)
        new = count + np.arange(len(values))
        P = np.zeros((old + len(own), old + len(own)), order="F")
        P[:old, :old], P[old:, :old], P[old:, old:] = self.P, cross, own
        self.P = P
        self.blocks, self.first_blocks = np.vstack([self.blocks, values]), np.vstack([self.first_blocks, first])
        self.held = np.concatenate([self.held, new])
        return new

    def hold_variables(self) -> IntArray:
        """Keep the present errors of the named variables, which are zero now, as held blocks; returns those."""
        size = self.layout.size
        count = -(-size // self.size)
        cross, own_block = np.zeros((self.size * count, len(self.P))), np.zeros((self.size * count, self.size * count))
        cross[:size] = symmetric.rows(self.P, self.layout.rows)
        own_block[:size, :size] = cross[:size, :size]
        nothing = np.zeros((count, self.blocks.shape[1]))
        return self.append(nothing, nothing, cross, own_block)

    def adopt(self, ids: IntArray, parameter_block: IntArray, anchor_block: IntArray) -> None:
        """Make landmarks of blocks that are here already; (M,) each, anchor block -1 where there is none."""
        self.ids = np.concatenate([self.ids, ids])
        self.parameter_block = np.concatenate([self.parameter_block, parameter_block])
        self.anchor_block = np.concatenate([self.anchor_block, anchor_block])

    def rest(self, gone: BoolArray, held: IntArray) -> None:
        """Marginalise the landmarks marked in `gone` (N,), and from now on hold only the blocks `held`."""
        stays = ~gone
        self.ids = self.ids[stays]
        own_blocks, anchors = self.parameter_block[stays], self.anchor_block[stays]
        kept_blocks = np.unique(np.concatenate([own_blocks, anchors[anchors >= 0], held]))
        number = np.full(len(self.blocks) + 1, -1)  # the last one, for -1: no anchor
        number[kept_blocks] = np.arange(len(kept_blocks))
        self.P = symmetric.keep(self.P, np.concatenate([self.layout.rows, self.block_rows(kept_blocks)]))
        self.blocks, self.first_blocks = self.blocks[kept_blocks], self.first_blocks[kept_blocks]
        self.parameter_block, self.anchor_block, self.held = number[own_blocks], number[anchors], number[held]
        self.clones = {name: replace(clone, blocks=number[clone.blocks]) for name, clone in self.clones.items()}
        self.added = {name: replace(one, blocks=number[one.blocks]) for name, one in self.added.items()}


def landmark_belief(state: JointState) -> LandmarkBelief:
    """The map, in ascending order of ids."""
    index, model = np.argsort(state.ids), state.model
    points, rows = _points(state, index)
    P_map = symmetric.blocks(state.P, rows)
    with np.errstate(invalid="ignore", over="ignore"):
        covariances = _mirrored(points.by_map @ P_map @ points.by_map.transpose(0, 2, 1))
    inverse = model.inverse_distances(state.camera.position, state.anchors(index), state.parameters(index))
    own_rows = state.own_rows(index)
    position_rows = np.broadcast_to(np.arange(3), (len(index), 3))
    P_own = symmetric.blocks(state.P, np.concatenate([position_rows, own_rows], axis=1))
    J = np.concatenate([inverse.by_position, inverse.by_parameters], axis=1)
    variance = np.einsum("mi,mij,mj->m", J, P_own, J)
    return LandmarkBelief(state.ids[index], points.positions, covariances, inverse.values, variance)


def _points(state: JointState, index: IntArray) -> tuple[Points, IntArray]:
    """Positions in W of the landmarks at `index`, and the rows (M, w) of P that their Jacobian is by."""
    return state.model.points(state.anchors(index), state.parameters(index)), state.map_rows(index)


def joint_covariance(state: JointState, index: IntArray) -> FloatArray:
    """J P J^T of the pose error and the positions (W) of the landmarks at `index`; (6 + 3 M, 6 + 3 M).

    J is the identity on the pose; on each landmark it is the Jacobian of its position by its own rows, to which the
    products are confined. Rows of landmarks without a finite position are not finite.
    """
    points, rows = _points(state, index)
    by_map = points.by_map
    needed = np.zeros(len(state.P), dtype=bool)
    needed[:POSE_SIZE] = needed[rows] = True
    place = (np.cumsum(needed) - 1)[rows]
    P = symmetric.full(symmetric.keep(state.P, np.flatnonzero(needed)))
    count = len(index)
    half, joint = np.empty((POSE_SIZE + 3 * count, len(P))), np.empty((POSE_SIZE + 3 * count,) * 2)
    half[:POSE_SIZE] = P[:POSE_SIZE]
    with np.errstate(invalid="ignore", over="ignore"):
        half[POSE_SIZE:] = (by_map @ P[place]).reshape(-1, len(P))
        joint[:POSE_SIZE] = half[:, :POSE_SIZE].T
        joint[POSE_SIZE:] = (by_map @ half.T[place]).reshape(-1, len(half))
    return symmetric.full(joint)


def pose_landmark_covariances(state: JointState, index: IntArray) -> FloatArray:
    """The parts of `joint_covariance` that belong to the pose and to one landmark each; (M, 9, 9)."""
    points, rows = _points(state, index)
    pose = np.broadcast_to(np.arange(POSE_SIZE), (len(index), POSE_SIZE))
    P = symmetric.blocks(state.P, np.concatenate([pose, rows], axis=1))
    J = np.zeros((len(index), POSE_SIZE + 3, POSE_SIZE + rows.shape[1]))
    J[:, :POSE_SIZE, :POSE_SIZE] = np.eye(POSE_SIZE)
    J[:, POSE_SIZE:, POSE_SIZE:] = points.by_map
    with np.errstate(invalid="ignore", over="ignore"):
        return _mirrored(J @ P @ J.transpose(0, 2, 1))


def _mirrored(products: FloatArray) -> FloatArray:
    """Products J P J^T (M, n, n), symmetric to the last bit: where they are large, rounding alone is not."""
    return 0.5 * (products + products.transpose(0, 2, 1))
