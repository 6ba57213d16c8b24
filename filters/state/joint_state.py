"""The joint state x = (x_C, y_1, ..., y_n) of Eq. 1 with its covariance: augmentation, marginalisation, correction.

The error state is that of the named variables (`engine.layout`) followed by blocks of three: landmarks, anchors and
clones of the pose. Only the lower triangle of P is valid. Each operation checks nothing: the filter has done so.

A landmark that leaves only empties its blocks: their values, and their rows and columns of P, become zero, which every
other operation leaves as they are. New landmarks move into empty blocks, so that coming and going costs in proportion
to who comes and goes, not to the size of P; only when too many blocks stand empty does P become smaller.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from filters.contract.start import Start
from filters.geometry import rotations
from filters.landmarks.model import LandmarkModel, StartedLandmarks
from filters.motions.model import POSE_SIZE, POSITION, ROTATION, CameraState
from filters.state import symmetric
from filters.state.layout import Layout
from filters.validation import BoolArray, FloatArray, IntArray

_EMPTY_SHARE = 1 / 8  # of the blocks: where carrying empty rows through every update costs more than leaving them out
_BLOCK = np.arange(3)

Adjust = Callable[[FloatArray, FloatArray], FloatArray]
"""(J of new blocks by leading rows (m, c), effect of a rotation of the world on them (m, 3)) -> J to be used."""


def _no_landmarks() -> IntArray:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class NewLandmarks:
    """M landmarks that enter the map.

    Attributes
    ----------
    ids : (M,) int64
        Their identities.
    started : StartedLandmarks
        Their values.
    by_leading : (M, 3, c)
        Jacobian of their error numbers by the leading rows (J_xc of Eq. 25).
    noise : (M, 3, 3)
        What the measurement adds to their covariance (J_R R J_R^T).
    """

    ids: IntArray
    started: StartedLandmarks
    by_leading: FloatArray
    noise: FloatArray


@dataclass(frozen=True, eq=False)
class Clone:
    """Copy of the pose at some instant: position (3,), orientation (4,), and the two blocks of its errors."""

    position: FloatArray
    orientation: FloatArray
    blocks: IntArray


def world_rotation_of_variables(layout: Layout, camera: CameraState) -> FloatArray:
    """Gamma of the variables: effect of a rotation of the world about its origin on their errors; (c, 3)."""
    effect = np.zeros((layout.size, 3))
    effect[POSITION] = -rotations.skew(camera.position)
    effect[ROTATION] = camera.R_wc.T
    effect[layout.linear_velocity] = -rotations.skew(camera.linear_velocity)
    for variable in layout.variables:
        effect[layout.places[variable.name]] = variable.world_rotation(camera.variables[variable.name])
    return effect


@dataclass(eq=False)
class JointState:
    """Named variables, map and covariance.

    Attributes
    ----------
    layout : Layout
        Rows of the named variables.
    camera : CameraState
        Their values.
    P : (n, n)
        Covariance of the error state, lower triangle, column-major.
    model : LandmarkModel
        Parametrisation of the landmarks.
    predicted : CameraState
        The variables as they were predicted last, before any correction.
    blocks, first_blocks : (B, v)
        Values of the map blocks, now and when they entered; block b is at rows c + 3 b of P, c the size of the layout.
        Empty ones are zero; anchors are the first three numbers.
    ids : (N,) int64
        Landmark identities, in the order in which they entered.
    parameter_block, anchor_block : (N,) int64
        Blocks of each landmark; the anchor block is -1 where there is none.
    empty_blocks : (E,) int64
        Blocks without a landmark or anchor, ascending.
    held : (H,) int64
        Blocks that stay whether or not a landmark uses them, in the order in which they were held.
    clones : dict of str to Clone
        Clones of the pose by name; their blocks are held.
    """

    layout: Layout
    camera: CameraState
    P: FloatArray
    model: LandmarkModel
    predicted: CameraState
    blocks: FloatArray
    first_blocks: FloatArray
    ids: IntArray = field(default_factory=_no_landmarks)
    parameter_block: IntArray = field(default_factory=_no_landmarks)
    anchor_block: IntArray = field(default_factory=_no_landmarks)
    empty_blocks: IntArray = field(default_factory=_no_landmarks)
    held: IntArray = field(default_factory=_no_landmarks)
    clones: dict[str, Clone] = field(default_factory=dict)

    @classmethod
    def at(cls, start: Start, layout: Layout, model: LandmarkModel) -> JointState:
        """The variables at the start, and nothing seen yet."""
        camera, P = layout.start(start)
        nothing = np.zeros((0, model.value_size))
        return cls(layout, camera, P, model, camera, nothing, nothing)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def rows_in_use(self) -> IntArray:
        """Rows of P of the variables, landmarks and anchors: all but those of empty blocks, which are zero."""
        used = np.delete(np.arange(len(self.blocks)), self.empty_blocks)
        return np.concatenate([self.layout.rows, self.block_rows(used)])

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
        """Rows of P that belong to each landmark, anchor first; (M, 6) or (M, 3).

        Where there are anchors, a landmark without one has its own rows twice.
        """
        first = self.parameter_block[index, None]
        if self.model.anchored:
            anchor = self.anchor_block[index, None]
            first = np.hstack([np.where(anchor < 0, first, anchor), first])
        return (self.layout.size + 3 * first[:, :, None] + _BLOCK).reshape(len(index), 3 * first.shape[1])

    def own_rows(self, index: IntArray | slice = slice(None)) -> IntArray:
        """Rows of P of the landmarks themselves, without their anchors; (M, 3)."""
        rows: IntArray = self.layout.size + 3 * self.parameter_block[index, None] + _BLOCK
        return rows

    def world_rotation(self) -> FloatArray:
        """Gamma: effect of a rotation of the world about its origin on the error state; (n, 3)."""
        effect = -rotations.skew(self.blocks[:, :3])
        effect[self.parameter_block] = self.model.world_rotation(self.anchors(), self.parameters())
        for clone in self.clones.values():
            effect[clone.blocks] = -rotations.skew(clone.position), rotations.matrix(clone.orientation).T
        return np.vstack([world_rotation_of_variables(self.layout, self.camera), effect.reshape(-1, 3)])

    def world_translation(self) -> FloatArray:
        """Effect of a shift of the world on the error state, clones of the pose left out; (n, 3)."""
        effect = np.broadcast_to(np.eye(3), (len(self.blocks), 3, 3)).copy()
        if self.model.anchored:  # rays have no place of their own
            effect[self.parameter_block[self.anchor_block >= 0]] = 0.0
        for clone in self.clones.values():
            effect[clone.blocks] = 0.0
        leading = np.zeros((self.layout.size, 3))
        leading[POSITION] = np.eye(3)
        return np.vstack([leading, effect.reshape(-1, 3)])

    def at_first_estimates(self) -> JointState:
        """This state with the predicted camera and the map as it was first estimated."""
        blocks = self.first_blocks.copy()
        own = self.parameter_block
        blocks[own] = self.model.first_estimates(self.anchors(), self.first_blocks[own], self.blocks[own])
        return replace(self, camera=self.predicted, blocks=blocks)

    def augment(self, new: NewLandmarks, adjust: Adjust | None = None) -> None:
        """Add landmarks with their covariance and their cross-covariance with everything else (Eq. 19-25).

        Eq. 25 as printed leaves out the correlation of the new landmark with the old map, which it inherits
        from the pose it was seen from; J P for the rows of the pose gives all of it.
        """
        started, count = new.started, len(new.ids)
        anchors = int(started.anchored.sum())
        which_anchor = np.cumsum(started.anchored) - 1
        if self.model.shares_anchors:
            anchors, which_anchor = min(anchors, 1), np.zeros_like(which_anchor)
        blocks = np.zeros((anchors + count, self.blocks.shape[1]))
        blocks[:anchors, :3] = self.camera.position
        blocks[anchors:] = started.parameters
        leading = new.by_leading.shape[2]
        by_leading = np.zeros((anchors + count, 3, leading))
        by_leading[:anchors, :, :3] = np.eye(3)
        by_leading[anchors:] = new.by_leading
        J = by_leading.reshape(-1, leading)
        if adjust is not None:
            effect = -rotations.skew(blocks[:, :3])
            here = np.where(started.anchored[:, None], self.camera.position, np.nan)
            effect[anchors:] = self.model.world_rotation(here, started.parameters)
            J = adjust(J, effect.reshape(-1, 3))
        taken = self._take_blocks(len(blocks))
        anchor_block, parameter_block = taken[:anchors], taken[anchors:]
        rows = self.block_rows(taken)
        cross = J @ symmetric.leading_rows(self.P, leading)
        cross[:, rows] = cross[:, :leading] @ J.T
        symmetric.put_rows(self.P, rows, cross)
        own = rows[3 * anchors :].reshape(count, 3)
        self.P[own[:, :, None], own[:, None, :]] += new.noise
        self.blocks[taken] = self.first_blocks[taken] = blocks
        by_landmark = np.full(count, -1)
        by_landmark[started.anchored] = anchor_block[which_anchor[started.anchored]]
        self.adopt(new.ids, parameter_block, by_landmark)

    def remove(self, gone: BoolArray) -> None:
        """Take the landmarks marked in `gone` (N,) out of the map, and the anchors nobody uses any more."""
        if gone.any():
            self.rest(gone, self.held)

    def become_points(self, index: IntArray, at: JointState) -> None:
        """Turn the inverse-depth landmarks at `index` into XYZ (Eq. 4), with Jacobians taken at the state `at`.

        In place; their anchors stay, whether or not another landmark has them.
        """
        if len(index) == 0:
            return
        rows, own = self.map_rows(index), self.parameter_block[index]
        points = self.model.points(at.anchors(index), at.parameters(index))
        J = points.by_map
        moved = (J @ symmetric.rows(self.P, rows.ravel()).reshape(*rows.shape, -1)).reshape(-1, len(self.P))
        own_rows = rows[:, 3:].ravel()
        crossed = J @ moved[:, rows].transpose(1, 2, 0)
        moved[:, own_rows] = crossed.reshape(-1, len(moved)).T
        symmetric.put_rows(self.P, own_rows, moved)
        self.blocks[own, :3] = self.model.points(self.anchors(index), self.parameters(index)).positions
        self.first_blocks[own, :3] = points.positions
        self.anchor_block[index] = -1

    def _leave_empty_what_nobody_uses(self) -> None:
        empty = np.ones(len(self.blocks), dtype=bool)
        empty[self.parameter_block] = False
        empty[self.anchor_block[self.anchor_block >= 0]] = False
        empty[self.held] = False
        left = empty.copy()
        left[self.empty_blocks] = False
        self.empty_blocks = np.flatnonzero(empty)
        if len(self.empty_blocks) > _EMPTY_SHARE * len(self.blocks):
            self._keep_blocks(np.flatnonzero(~empty))
            return
        left_blocks = np.flatnonzero(left)
        rows = self.block_rows(left_blocks)
        self.P[rows] = self.P[:, rows] = 0.0
        self.blocks[left_blocks] = self.first_blocks[left_blocks] = 0.0

    def _take_blocks(self, count: int) -> IntArray:
        """Numbers of `count` empty blocks, made where there are too few."""
        missing = count - len(self.empty_blocks)
        if missing > 0:
            old, size = len(self.P), len(self.blocks)
            P = np.zeros((old + 3 * missing, old + 3 * missing), order="F")
            P[:old, :old] = self.P
            self.P = P
            none = np.zeros((missing, self.blocks.shape[1]))
            self.blocks, self.first_blocks = np.vstack([self.blocks, none]), np.vstack([self.first_blocks, none])
            self.empty_blocks = np.concatenate([self.empty_blocks, np.arange(size, size + missing)])
        taken, self.empty_blocks = self.empty_blocks[:count], self.empty_blocks[count:]
        return taken

    def _keep_blocks(self, kept: IntArray) -> None:
        """Leave out all blocks but the ascending `kept`."""
        number = np.full(len(self.blocks) + 1, -1)  # the last one, for -1: no anchor
        number[kept] = np.arange(len(kept))
        self.P = symmetric.keep(self.P, np.concatenate([self.layout.rows, self.block_rows(kept)]))
        self.blocks, self.first_blocks = self.blocks[kept], self.first_blocks[kept]
        self.parameter_block, self.anchor_block = number[self.parameter_block], number[self.anchor_block]
        self.held = number[self.held]
        self.clones = {name: replace(clone, blocks=number[clone.blocks]) for name, clone in self.clones.items()}
        self.empty_blocks = _no_landmarks()

    def block_rows(self, blocks: IntArray) -> IntArray:
        """Rows of P that belong to map blocks, in their order; (M,) -> (3 M,)."""
        return (self.layout.size + 3 * blocks[:, None] + _BLOCK).ravel()

    def append(self, values: FloatArray, first: FloatArray, cross: FloatArray, own: FloatArray) -> IntArray:
        """Add M blocks that belong to no landmark yet, and hold them.

        Parameters
        ----------
        values, first : (M, v)
            Now, and when they were first estimated.
        cross, own : (3 M, n), (3 M, 3 M)
            Their covariance with all rows of P as it is, and among themselves.

        Returns
        -------
        (M,) int64
            The new blocks.
        """
        new = self._take_blocks(len(values))
        rows, old = self.block_rows(new), cross.shape[1]
        whole = np.zeros((len(rows), len(self.P)))
        whole[:, :old] = cross
        whole[:, rows] = own
        symmetric.put_rows(self.P, rows, whole)
        self.blocks[new], self.first_blocks[new] = values, first
        self.held = np.concatenate([self.held, new])
        return new

    def hold_variables(self) -> IntArray:
        """Keep the present errors of the named variables, which are zero now, as held blocks; returns those."""
        size = self.layout.size
        count = -(-size // 3)
        cross, own = np.zeros((3 * count, len(self.P))), np.zeros((3 * count, 3 * count))
        cross[:size] = symmetric.rows(self.P, self.layout.rows)
        own[:size, :size] = cross[:size, :size]
        nothing = np.zeros((count, self.blocks.shape[1]))
        return self.append(nothing, nothing, cross, own)

    def clone_pose(self, name: str) -> None:
        """Keep the present pose as a variable of that name."""
        cross = symmetric.rows(self.P, np.arange(POSE_SIZE))
        nothing = np.zeros((POSE_SIZE // 3, self.blocks.shape[1]))
        blocks = self.append(nothing, nothing, cross, cross[:, :POSE_SIZE])
        self.clones = {**self.clones, name: Clone(self.camera.position, self.camera.orientation, blocks)}

    def forget_clone(self, name: str) -> None:
        """Marginalise a clone out."""
        blocks = self.clones[name].blocks
        self.clones = {other: clone for other, clone in self.clones.items() if other != name}
        self.rest(np.zeros(len(self), dtype=bool), self.held[~np.isin(self.held, blocks)])

    def adopt(self, ids: IntArray, parameter_block: IntArray, anchor_block: IntArray) -> None:
        """Make landmarks of blocks that are here already; (M,) each, anchor block -1 where there is none."""
        self.ids = np.concatenate([self.ids, ids])
        self.parameter_block = np.concatenate([self.parameter_block, parameter_block])
        self.anchor_block = np.concatenate([self.anchor_block, anchor_block])

    def rest(self, gone: BoolArray, held: IntArray) -> None:
        """Marginalise the landmarks marked in `gone` (N,), and from now on hold only the blocks `held`."""
        self.held = held
        stays = ~gone
        self.ids = self.ids[stays]
        self.parameter_block, self.anchor_block = self.parameter_block[stays], self.anchor_block[stays]
        self._leave_empty_what_nobody_uses()
