"""The joint state x = (x_C, y_1, ..., y_n) of Eq. 1 with its covariance, as parts and submaps see it.

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
from filters.geometry import rotations, symmetric
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.landmarks.landmark_model import LandmarkModel, StartedLandmarks
from filters.motions.motion_model import POSITION, ROTATION, CameraState
from filters.state.layout import StateLayout


def _no_landmarks() -> IntArray:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class NewLandmarks:
    """M landmarks that enter the map."""

    ids: IntArray
    """(M,): their identities."""
    started: StartedLandmarks
    """Their values."""
    by_leading: FloatArray
    """(M, size, c): Jacobian of their error numbers by the leading rows (J_xc of Eq. 25)."""
    noise: FloatArray
    """(M, size, size): what the measurement adds to their covariance (J_R R J_R^T), and the prior of what it leaves."""


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


def world_rotation_of_variables(layout: StateLayout, camera: CameraState) -> FloatArray:
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
    clones: dict[str | int, Clone] = field(default_factory=dict)
    """Clones of the pose by name; their blocks are held. Anchors of landmarks `in_anchor`, by their first block."""
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

    @property
    def viewpoint(self) -> tuple[FloatArray, FloatArray]:
        """Position and orientation of the camera in the frame in which landmarks start."""
        if self.model.in_anchor:
            return np.zeros(3), np.eye(3)
        return self.camera.position, self.camera.R_wc

    def anchor_poses(self, index: IntArray | slice = slice(None)) -> tuple[FloatArray, FloatArray, IntArray]:
        """Anchors of landmarks `in_anchor`: positions (M, 3), R_wa (M, 3, 3), blocks of the orientations (M,)."""
        blocks, which = np.unique(self.anchor_block[index], return_inverse=True)
        poses = [self.clones[block] for block in blocks.tolist()]
        positions, orientations = np.zeros((len(poses), 3)), np.zeros((len(poses), 4))
        turns = np.zeros(len(poses), dtype=np.int64)
        for i, pose in enumerate(poses):
            positions[i], orientations[i], turns[i] = pose.position, pose.orientation, pose.blocks[1]
        return positions[which], rotations.matrix(orientations)[which], turns[which]

    def seen_from(self, index: IntArray) -> tuple[FloatArray, FloatArray]:
        """Position and orientation of the camera in the frame of landmarks, or of each (M, ...)."""
        if not self.model.in_anchor:
            return self.viewpoint
        positions, R_wa, _ = self.anchor_poses(index)
        R_aw = R_wa.transpose(0, 2, 1)
        return rotations.turned(R_aw, self.camera.position - positions), R_aw @ self.camera.R_wc

    def through_anchors(self, index: IntArray, by_pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Jacobians by the pose in W and by the anchors, from that (M, k, 6) by the pose in the anchors' frames."""
        (r_a, R_ac), R_wa = self.seen_from(index), self.anchor_poses(index)[1]
        by_position, by_rotation = by_pose[:, :, POSITION], by_pose[:, :, ROTATION]
        in_world = by_position @ R_wa.transpose(0, 2, 1)
        by_turn = by_position @ rotations.skew(r_a) - by_rotation @ R_ac.transpose(0, 2, 1)
        return np.concatenate([in_world, by_rotation], axis=2), np.concatenate([-in_world, by_turn], axis=2)

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
        """Rows of P that belong to each landmark, anchor first; (M, size), (M, 3 + size) or, of a pose, (M, 6 + size).

        Where there are anchors, a landmark without one has its own first rows twice.
        """
        own = self.own_rows(index)
        if self.model.in_anchor:
            first = self.layout.size + self.size * np.stack([self.anchor_block[index], self.anchor_poses(index)[2]], 1)
            return np.hstack([(first[:, :, None] + np.arange(3)).reshape(-1, 6), own])
        if not self.model.anchored:
            return own
        anchor, block = self.anchor_block[index], self.parameter_block[index]
        first = self.layout.size + self.size * np.where(anchor < 0, block, anchor)
        return np.hstack([first[:, None] + np.arange(3), own])

    def own_rows(self, index: IntArray | slice = slice(None)) -> IntArray:
        """Rows of P of the landmarks themselves, without their anchors; (M, size)."""
        rows: IntArray = self.layout.size + self.size * self.parameter_block[index, None] + np.arange(self.size)
        return rows

    def world_rotation(self) -> FloatArray:
        """Gamma: effect of a rotation of the world about its origin on the error state; (n, 3)."""
        effect = self._effect(-rotations.skew(self.blocks[:, :3]))
        effect[self.parameter_block] = self.model.world_rotation(self.anchors(), self.parameters())
        for clone in self.clones.values():
            effect[clone.blocks, :3] = -rotations.skew(clone.position), rotations.matrix(clone.orientation).T
        for one in self.added.values():
            if not one.variable.in_world:
                effect[one.blocks] = 0.0
        return np.vstack([world_rotation_of_variables(self.layout, self.camera), effect.reshape(-1, 3)])

    def world_translation(self) -> FloatArray:
        """Effect of a shift of the world on the error state, (n, 3)."""
        effect = self._effect(np.eye(3))
        effect[self.parameter_block] = 0.0  # rays have no place of their own
        free = np.flatnonzero(self.anchor_block < 0)
        if len(free):
            effect[self.parameter_block[free]] = self.model.world_translation(self.parameters(free))
        for clone in self.clones.values():
            effect[clone.blocks[1]] = 0.0
        for one in self.added.values():
            effect[one.blocks] = 0.0
        leading = np.zeros((self.layout.size, 3))
        leading[POSITION] = np.eye(3)
        return np.vstack([leading, effect.reshape(-1, 3)])

    def _effect(self, of_points: FloatArray) -> FloatArray:
        """Effects (B, size, 3) on all blocks, those on points in their first three rows."""
        effect = np.zeros((len(self.blocks), self.size, 3))
        effect[:, :3] = of_points
        return effect

    def at_first_estimates(self) -> JointState:
        """This state with the predicted camera and the map as it was first estimated."""
        blocks = self.first_blocks.copy()
        own = self.parameter_block
        blocks[own] = self.model.first_estimates(self.anchors(), self.first_blocks[own], self.blocks[own])
        return replace(self, camera=self.predicted, blocks=blocks)

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
