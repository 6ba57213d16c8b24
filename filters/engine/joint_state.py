"""The joint state x = (x_C, y_1, ..., y_n) of Eq. 1 with its covariance, and how it grows, shrinks and moves.

The error state is the 12 numbers of the camera followed by blocks of three: landmark parameters and anchors.
Only the lower triangle of P is valid. Each operation checks nothing: the filter has done so.
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
_FIRST_BLOCK = np.arange(CAMERA_SIZE, CAMERA_SIZE + 3)
_LOWER = np.tril(np.ones((CAMERA_SIZE, CAMERA_SIZE), dtype=bool))


Adjust = Callable[[FloatArray, FloatArray], FloatArray]
"""(J of new blocks by the pose (m, 6), effect of a rotation of the world on them (m, 3)) -> J to be used."""


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
        Values of the map blocks, now and when they entered; block b is at rows 12 + 3 b of P.
    ids : (N,) int64
        Landmark identities, in the order in which they entered.
    parameter_block, anchor_block : (N,) int64
        Blocks of each landmark; the anchor block is -1 where there is none.
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
    held: IntArray = field(default_factory=_no_landmarks)

    @classmethod
    def without_map(cls, camera: CameraState, P: FloatArray, model: LandmarkModel) -> JointState:
        """A camera with its covariance (12, 12), and nothing seen yet."""
        return cls(camera, np.array(P, order="F"), model, predicted=camera)

    def __len__(self) -> int:
        return len(self.ids)

    def parameters(self, index: IntArray) -> FloatArray:
        """Parameters of the landmarks at `index`, (M, 3)."""
        taken: FloatArray = self.blocks[self.parameter_block[index]]
        return taken

    def anchors(self, index: IntArray | slice = slice(None)) -> FloatArray | None:
        """Anchors of the landmarks at `index`, (M, 3); None where landmarks have none."""
        return self.blocks[self.anchor_block[index]] if self.model.anchored else None

    def map_rows(self, index: IntArray) -> IntArray:
        """Rows of P that belong to each landmark, anchor first; (M, 6) or (M, 3)."""
        first = self.parameter_block[index, None]
        if self.model.anchored:
            first = np.hstack([self.anchor_block[index, None], first])
        return (3 * first[:, :, None] + _FIRST_BLOCK).reshape(len(index), 3 * first.shape[1])

    def transform_camera(self, F: FloatArray, added: FloatArray | None = None) -> None:
        """P <- blockdiag(F, I) P blockdiag(F, I)^T, plus `added` on the camera block (Eq. 12)."""
        camera = self.P[:CAMERA_SIZE, :CAMERA_SIZE]
        moved = F @ np.where(_LOWER, camera, camera.T) @ F.T
        if added is not None:
            moved += added
        self.P[:CAMERA_SIZE, :CAMERA_SIZE] = 0.5 * (moved + moved.T)
        cross = self.P[CAMERA_SIZE:, :CAMERA_SIZE].T
        cross[...] = F @ cross

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
        count, old, first_block = len(ids), len(self.P), len(self.blocks)
        anchors = 0 if not self.model.anchored else 1 if self.model.shares_anchors else count
        blocks = np.empty((anchors + count, 3))
        blocks[:anchors] = self.camera.position
        blocks[anchors:] = new.parameters
        by_pose = np.zeros((anchors + count, 3, POSE_SIZE))
        by_pose[:anchors, :, :3] = np.eye(3)
        by_pose[anchors:, :, :3] = new.by_position
        by_pose[anchors:, :, 3:] = new.by_rotation
        J = by_pose.reshape(-1, POSE_SIZE)
        if adjust is not None:
            effect = -rotations.skew(blocks)
            effect[anchors:] = self.model.world_rotation(blocks[:anchors] if anchors else None, new.parameters)
            J = adjust(J, effect.reshape(-1, 3))
        cross = J @ symmetric.rows(self.P, np.arange(POSE_SIZE))

        P = np.zeros((old + len(J), old + len(J)), order="F")
        P[:old, :old] = self.P
        P[old:, :old] = cross
        P[old:, old:] = cross[:, :POSE_SIZE] @ J.T
        own = old + 3 * (anchors + np.arange(count))[:, None] + np.arange(3)
        P[own[:, :, None], own[:, None, :]] += new.by_measurement @ R @ new.by_measurement.transpose(0, 2, 1)

        parameter_block = first_block + anchors + np.arange(count)
        anchor_block = np.full(count, -1) if anchors == 0 else first_block + np.arange(count) % anchors
        self.P = P
        self.blocks = np.vstack([self.blocks, blocks])
        self.first_blocks = np.vstack([self.first_blocks, blocks])
        self.ids = np.concatenate([self.ids, ids])
        self.parameter_block = np.concatenate([self.parameter_block, parameter_block])
        self.anchor_block = np.concatenate([self.anchor_block, anchor_block])

    def remove(self, gone: BoolArray) -> None:
        """Take the landmarks marked in `gone` (N,) out of the map, and the anchors nobody uses any more."""
        if not gone.any():
            return
        stays = ~gone
        self.ids = self.ids[stays]
        self.parameter_block = self.parameter_block[stays]
        self.anchor_block = self.anchor_block[stays]
        self._drop_unused_blocks()

    def _drop_unused_blocks(self) -> None:
        used = np.zeros(len(self.blocks), dtype=bool)
        used[self.parameter_block] = True
        used[self.anchor_block[self.anchor_block >= 0]] = True
        used[self.held] = True
        if used.all():
            return
        renumbered = np.cumsum(used) - 1
        kept_rows = CAMERA_SIZE + 3 * np.flatnonzero(used)[:, None] + np.arange(3)
        self.P = symmetric.keep(self.P, np.concatenate([_CAMERA, kept_rows.ravel()]))
        self.blocks = self.blocks[used]
        self.first_blocks = self.first_blocks[used]
        self.parameter_block = renumbered[self.parameter_block]
        self.anchor_block = np.where(self.anchor_block < 0, -1, renumbered[self.anchor_block])
        self.held = renumbered[self.held]

    def block_rows(self, blocks: IntArray) -> IntArray:
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
        old, new = len(self.P), np.arange(len(self.blocks), len(self.blocks) + len(values))
        P = np.zeros((old + len(own), old + len(own)), order="F")
        P[:old, :old] = self.P
        P[old:, :old] = cross
        P[old:, old:] = own
        self.P = P
        self.blocks = np.vstack([self.blocks, values])
        self.first_blocks = np.vstack([self.first_blocks, first])
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
        self.remove(gone)
