"""The joint state x = (x_C, y_1, ..., y_n) of Eq. 1 with its covariance, as filters built on the engine see it.

The error state is that of the named variables (`state.layout`) followed by blocks: landmarks, anchors and clones of
the pose. All blocks have as many rows as a landmark has error numbers; anchors, and positions and orientations of
clones, use the first three, the others are zero. Only the lower triangle of P is valid. Each operation checks nothing:
the filter has done so.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from filters.contract.inputs import Start
from filters.contract.variables import Variable
from filters.geometry import symmetric
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.landmarks.landmark_model import LandmarkModel
from filters.motions.motion_model import CameraState
from filters.state.layout import StateLayout


def _no_landmarks() -> IntArray:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Clone:
    """Copy of the pose at some instant: position (3,), orientation (4,), and the two blocks of its errors."""

    position: FloatArray
    orientation: FloatArray
    blocks: IntArray


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
        own = self.own_rows(index)
        if not self.model.anchored:
            return own
        anchor, block = self.anchor_block[index], self.parameter_block[index]
        first = self.layout.size + self.size * np.where(anchor < 0, block, anchor)
        return np.hstack([first[:, None] + np.arange(3), own])

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
        cross, own = np.zeros((self.size * count, len(self.P))), np.zeros((self.size * count, self.size * count))
        cross[:size] = symmetric.rows(self.P, self.layout.rows)
        own[:size, :size] = cross[:size, :size]
        nothing = np.zeros((count, self.blocks.shape[1]))
        return self.append(nothing, nothing, cross, own)

    def adopt(self, ids: IntArray, parameter_block: IntArray, anchor_block: IntArray) -> None:
        """Make landmarks of blocks that are here already; (M,) each, anchor block -1 where there is none."""
        self.ids = np.concatenate([self.ids, ids])
        self.parameter_block = np.concatenate([self.parameter_block, parameter_block])
        self.anchor_block = np.concatenate([self.anchor_block, anchor_block])

    def rest(self, gone: BoolArray, held: IntArray) -> None:
        """Marginalise the landmarks marked in `gone` (N,), and from now on hold only the blocks `held`."""
        stays = ~gone
        self.ids = self.ids[stays]
        own, anchors = self.parameter_block[stays], self.anchor_block[stays]
        kept = np.unique(np.concatenate([own, anchors[anchors >= 0], held]))
        number = np.full(len(self.blocks) + 1, -1)  # the last one, for -1: no anchor
        number[kept] = np.arange(len(kept))
        self.P = symmetric.keep(self.P, np.concatenate([self.layout.rows, self.block_rows(kept)]))
        self.blocks, self.first_blocks = self.blocks[kept], self.first_blocks[kept]
        self.parameter_block, self.anchor_block, self.held = number[own], number[anchors], number[held]
        self.clones = {name: replace(clone, blocks=number[clone.blocks]) for name, clone in self.clones.items()}
        self.added = {name: replace(one, blocks=number[one.blocks]) for name, one in self.added.items()}
