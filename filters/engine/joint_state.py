"""The joint state x = (x_C, y_1, ..., y_n) of Eq. 1 with its covariance: augmentation, marginalisation, correction.

The error state is the 12 numbers of the camera followed by blocks of three: landmark parameters and anchors.
Only the lower triangle of P is valid. Each operation checks nothing: the filter has done so.

A landmark that leaves only empties its blocks: their values, and their rows and columns of P, become zero, which every
other operation leaves as they are. New landmarks move into empty blocks, so that coming and going costs in proportion
to who comes and goes, not to the size of P; only when too many blocks stand empty does P become smaller.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import blas

from filters import rotations
from filters.engine import symmetric
from filters.landmarks.parametrisation import LandmarkModel, NewLandmarks
from filters.motion import CAMERA_SIZE, LINEAR, POSE_SIZE, POSITION, ROTATION, CameraState
from filters.validation import BoolArray, FloatArray, IntArray

_CAMERA = np.arange(CAMERA_SIZE)
_EYE = np.eye(CAMERA_SIZE)
_NOTHING = np.zeros((CAMERA_SIZE, CAMERA_SIZE))
_EMPTY_SHARE = 1 / 8  # of the blocks: where carrying empty rows through every update costs more than leaving them out
_FIRST_BLOCK = np.arange(CAMERA_SIZE, CAMERA_SIZE + 3)


Adjust = Callable[[FloatArray, FloatArray], FloatArray]
"""(J of new blocks by the pose (m, 6), effect of a rotation of the world on them (m, 3)) -> J to be used."""


TransformLeading = Callable[[FloatArray, FloatArray, FloatArray], None]


def _no_landmarks() -> IntArray:
    return np.zeros(0, dtype=np.int64)


def _no_blocks() -> FloatArray:
    return np.zeros((0, 3))


def world_rotation_of_camera(camera: CameraState) -> FloatArray:
    """Gamma of the camera: effect of a rotation of the world about its origin on the error state; (12, 3)."""
    effect = np.zeros((CAMERA_SIZE, 3))
    effect[POSITION] = -rotations.skew(camera.position)
    effect[ROTATION] = camera.R_wc.T
    effect[LINEAR] = -rotations.skew(camera.linear_velocity)
    return effect


@dataclass(eq=False)
class JointState:
    """Camera, map and covariance.

    Attributes
    ----------
    camera : CameraState
        x_C.
    P : (n, n)
        Covariance of the error state, lower triangle, column-major.
    model : LandmarkModel
        Parametrisation of the landmarks.
    predicted : CameraState
        The camera as it was predicted last, before any correction.
    blocks, first_blocks : (B, 3)
        Values of the map blocks, now and when they entered; block b is at rows 12 + 3 b of P. Empty ones are zero.
    ids : (N,) int64
        Landmark identities, in the order in which they entered.
    parameter_block, anchor_block : (N,) int64
        Blocks of each landmark; the anchor block is -1 where there is none.
    empty_blocks : (E,) int64
        Blocks without a landmark or anchor, ascending.
    transform_leading : function
        How P is transformed with the camera, see `symmetric.transform_leading`.
    held : (H,) int64
        Blocks that stay whether or not a landmark uses them, in the order in which they were held.
    """

    camera: CameraState
    P: FloatArray
    model: LandmarkModel
    predicted: CameraState
    blocks: FloatArray = field(default_factory=_no_blocks)
    first_blocks: FloatArray = field(default_factory=_no_blocks)
    ids: IntArray = field(default_factory=_no_landmarks)
    parameter_block: IntArray = field(default_factory=_no_landmarks)
    anchor_block: IntArray = field(default_factory=_no_landmarks)
    empty_blocks: IntArray = field(default_factory=_no_landmarks)
    transform_leading: TransformLeading = symmetric.transform_leading
    held: IntArray = field(default_factory=_no_landmarks)

    @classmethod
    def without_map(
        cls,
        camera: CameraState,
        P: FloatArray,
        model: LandmarkModel,
        transform_leading: TransformLeading = symmetric.transform_leading,
    ) -> JointState:
        """A camera with its covariance (12, 12), and nothing seen yet."""
        return cls(camera, np.array(P, order="F"), model, predicted=camera, transform_leading=transform_leading)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def rows_in_use(self) -> IntArray:
        """Rows of P of the camera, landmarks and anchors: all but those of empty blocks, which are zero."""
        used = np.delete(np.arange(len(self.blocks)), self.empty_blocks)
        return np.concatenate([_CAMERA, self.block_rows(used)])

    def parameters(self, index: IntArray | slice = slice(None)) -> FloatArray:
        """Parameters of the landmarks at `index`, (M, 3)."""
        taken: FloatArray = self.blocks[self.parameter_block[index]]
        return taken

    def anchors(self, index: IntArray | slice = slice(None)) -> FloatArray | None:
        """Anchors of the landmarks at `index`, (M, 3), NaN where one has none; None where no landmark has."""
        if not self.model.anchored:
            return None
        block = self.anchor_block[index]
        anchors: FloatArray = self.blocks[block]
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
        return (3 * first[:, :, None] + _FIRST_BLOCK).reshape(len(index), 3 * first.shape[1])

    def transform_camera(self, F: FloatArray, added: FloatArray | None = None) -> None:
        """P <- blockdiag(F, I) P blockdiag(F, I)^T, plus `added` on the camera block (Eq. 12)."""
        self.transform_leading(self.P, F, _NOTHING if added is None else added)

    def world_rotation(self) -> FloatArray:
        """Gamma: effect of a rotation of the world about its origin on the error state; (n, 3)."""
        effect = -rotations.skew(self.blocks)
        effect[self.parameter_block] = self.model.world_rotation(self.anchors(), self.blocks[self.parameter_block])
        return np.vstack([world_rotation_of_camera(self.camera), effect.reshape(-1, 3)])

    def turned_blocks(self, turn: FloatArray, spread: FloatArray, correction: FloatArray) -> FloatArray:
        """Map blocks turned with the world and corrected, see `LandmarkModel.turned`; (B, 3)."""
        moved = self.blocks @ turn.T + correction @ spread.T
        own = self.parameter_block
        moved[own] = self.model.turned(self.anchors(), self.blocks[own], turn, spread, correction[own])
        return moved

    def at_first_estimates(self) -> JointState:
        """This state with the predicted camera and the map as it was first estimated."""
        blocks = self.first_blocks.copy()
        own = self.parameter_block
        blocks[own] = self.model.first_estimates(self.anchors(), self.first_blocks[own], self.blocks[own])
        return replace(self, camera=self.predicted, blocks=blocks)

    def shear_by_rotation(self, W: FloatArray) -> None:
        """P <- (I + W E^T) P (I + W E^T)^T, E selecting the rotation of the camera; W (12, 3) or (n, 3)."""
        if len(W) == CAMERA_SIZE:
            M = _EYE.copy()
            M[:, ROTATION] += W
            self.transform_camera(M)
            return
        rotation = symmetric.rows(self.P, np.arange(ROTATION.start, ROTATION.stop))
        half = rotation.T + 0.5 * W @ rotation[:, ROTATION].T
        blas.dsyr2k(1.0, np.asfortranarray(W), np.asfortranarray(half), beta=1.0, c=self.P, lower=1, overwrite_c=1)

    def augment(self, ids: IntArray, new: NewLandmarks, R: FloatArray, adjust: Adjust | None = None) -> None:
        """Add landmarks with their covariance and their cross-covariance with everything else (Eq. 19-25).

        Eq. 25 as printed leaves out the correlation of the new landmark with the old map, which it inherits
        from the pose it was seen from; J P for the rows of the pose gives all of it.
        """
        count = len(ids)
        anchors = int(new.anchored.sum())
        which_anchor = np.cumsum(new.anchored) - 1
        if self.model.shares_anchors:
            anchors, which_anchor = min(anchors, 1), np.zeros_like(which_anchor)
        blocks = np.empty((anchors + count, 3))
        blocks[:anchors] = self.camera.position
        blocks[anchors:] = new.parameters
        by_pose = np.zeros((anchors + count, 3, POSE_SIZE))
        by_pose[:anchors, :, :3] = _EYE[:3, :3]
        by_pose[anchors:, :, :3] = new.by_position
        by_pose[anchors:, :, 3:] = new.by_rotation
        J = by_pose.reshape(-1, POSE_SIZE)
        if adjust is not None:
            effect = -rotations.skew(blocks)
            here = np.where(new.anchored[:, None], self.camera.position, np.nan)
            effect[anchors:] = self.model.world_rotation(here, new.parameters)
            J = adjust(J, effect.reshape(-1, 3))
        taken = self._take_blocks(len(blocks))
        anchor_block, parameter_block = taken[:anchors], taken[anchors:]
        rows = self.block_rows(taken)
        cross = J @ symmetric.leading_rows(self.P, POSE_SIZE)
        cross[:, rows] = cross[:, :POSE_SIZE] @ J.T
        symmetric.put_rows(self.P, rows, cross)
        own = rows[3 * anchors :].reshape(count, 3)
        self.P[own[:, :, None], own[:, None, :]] += new.by_measurement @ R @ new.by_measurement.transpose(0, 2, 1)
        self.blocks[taken] = self.first_blocks[taken] = blocks
        self.ids = np.concatenate([self.ids, ids])
        self.parameter_block = np.concatenate([self.parameter_block, parameter_block])
        by_landmark = np.full(count, -1)
        by_landmark[new.anchored] = anchor_block[which_anchor[new.anchored]]
        self.anchor_block = np.concatenate([self.anchor_block, by_landmark])

    def remove(self, gone: BoolArray) -> None:
        """Take the landmarks marked in `gone` (N,) out of the map, and the anchors nobody uses any more."""
        if gone.any():
            self.rest(gone, self.held)

    def become_points(self, index: IntArray, at: JointState) -> None:
        """Turn the inverse-depth landmarks at `index` into XYZ (Eq. 4), with Jacobians taken at the state `at`."""
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
        self.blocks[own] = self.model.points(self.anchors(index), self.parameters(index)).positions
        self.first_blocks[own] = points.positions
        self.anchor_block[index] = -1
        self._leave_empty_what_nobody_uses()

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
            self.blocks = np.vstack([self.blocks, np.zeros((missing, 3))])
            self.first_blocks = np.vstack([self.first_blocks, np.zeros((missing, 3))])
            self.empty_blocks = np.concatenate([self.empty_blocks, np.arange(size, size + missing)])
        taken, self.empty_blocks = self.empty_blocks[:count], self.empty_blocks[count:]
        return taken

    def _keep_blocks(self, kept: IntArray) -> None:
        """Leave out all blocks but the ascending `kept`."""
        number = np.full(len(self.blocks) + 1, -1)  # the last one, for -1: no anchor
        number[kept] = np.arange(len(kept))
        self.P = symmetric.keep(self.P, np.concatenate([_CAMERA, self.block_rows(kept)]))
        self.blocks, self.first_blocks = self.blocks[kept], self.first_blocks[kept]
        self.parameter_block, self.anchor_block = number[self.parameter_block], number[self.anchor_block]
        self.held = number[self.held]
        self.empty_blocks = _no_landmarks()

    @staticmethod
    def block_rows(blocks: IntArray) -> IntArray:
        """Rows of P that belong to map blocks, in their order; (M,) -> (3 M,)."""
        return (3 * blocks[:, None] + _FIRST_BLOCK).ravel()

    def append(self, values: FloatArray, first: FloatArray, cross: FloatArray, own: FloatArray) -> IntArray:
        """Add M blocks that belong to no landmark yet, and hold them.

        Parameters
        ----------
        values, first : (M, 3)
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

    def hold_camera(self) -> IntArray:
        """Keep the camera's present error, 12 numbers that are zero now, as four held blocks; returns those."""
        cross = symmetric.rows(self.P, _CAMERA)
        nothing = np.zeros((CAMERA_SIZE // 3, 3))
        return self.append(nothing, nothing, cross, cross[:, :CAMERA_SIZE])

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
