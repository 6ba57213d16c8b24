"""The joint state x = (x_C, y_1, ..., y_n) of Eq. 1 with its covariance, and how it grows, shrinks and moves.

The error state is the 12 numbers of the camera followed by blocks of three: landmark parameters and anchors.
Only the lower triangle of P is valid. Each operation checks nothing: the filter has done so.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from filters.engine import symmetric
from filters.landmarks.parametrisation import LandmarkModel, NewLandmarks
from filters.motion import CAMERA_SIZE, POSE_SIZE, CameraState
from filters.validation import BoolArray, FloatArray, IntArray

_CAMERA = np.arange(CAMERA_SIZE)


def _empty_blocks() -> IntArray:
    return np.zeros(0, dtype=np.int64)


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
    blocks : (B, 3)
        Values of the map blocks; block b is at rows 12 + 3 b of P.
    ids : (N,) int64
        Landmark identities, in the order in which they entered.
    parameter_block, anchor_block : (N,) int64
        Blocks of each landmark; the anchor block is -1 where there is none.
    """

    camera: CameraState
    P: FloatArray
    model: LandmarkModel
    blocks: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    ids: IntArray = field(default_factory=_empty_blocks)
    parameter_block: IntArray = field(default_factory=_empty_blocks)
    anchor_block: IntArray = field(default_factory=_empty_blocks)

    def __len__(self) -> int:
        return len(self.ids)

    def parameters(self, index: IntArray) -> FloatArray:
        """Parameters of the landmarks at `index`, (M, 3)."""
        taken: FloatArray = self.blocks[self.parameter_block[index]]
        return taken

    def anchors(self, index: IntArray) -> FloatArray | None:
        """Anchors of the landmarks at `index`, (M, 3); None where landmarks have none."""
        return self.blocks[self.anchor_block[index]] if self.model.anchored else None

    def map_rows(self, index: IntArray) -> IntArray:
        """Rows of P that belong to each landmark, anchor first; (M, 6) or (M, 3)."""
        columns = [self.parameter_block[index]]
        if self.model.anchored:
            columns.insert(0, self.anchor_block[index])
        first = CAMERA_SIZE + 3 * np.stack(columns, axis=1)
        return (first[:, :, None] + np.arange(3)).reshape(len(index), 3 * len(columns))

    def transform_camera(self, F: FloatArray, added: FloatArray | None = None) -> None:
        """P <- blockdiag(F, I) P blockdiag(F, I)^T, plus `added` on the camera block (Eq. 12)."""
        camera = symmetric.blocks(self.P, _CAMERA[None])[0]
        moved = F @ camera @ F.T
        if added is not None:
            moved += added
        self.P[:CAMERA_SIZE, :CAMERA_SIZE] = 0.5 * (moved + moved.T)
        self.P[CAMERA_SIZE:, :CAMERA_SIZE] = self.P[CAMERA_SIZE:, :CAMERA_SIZE] @ F.T

    def augment(self, ids: IntArray, new: NewLandmarks, R: FloatArray) -> None:
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
        self.ids = np.concatenate([self.ids, ids])
        self.parameter_block = np.concatenate([self.parameter_block, parameter_block])
        self.anchor_block = np.concatenate([self.anchor_block, anchor_block])

    def remove(self, gone: BoolArray) -> None:
        """Take the landmarks marked in `gone` (N,) out of the map, and the anchors nobody uses any more."""
        if not gone.any():
            return
        stays = ~gone
        used = np.zeros(len(self.blocks), dtype=bool)
        used[self.parameter_block[stays]] = True
        used[self.anchor_block[stays & (self.anchor_block >= 0)]] = True
        renumbered = np.cumsum(used) - 1
        kept_rows = CAMERA_SIZE + 3 * np.flatnonzero(used)[:, None] + np.arange(3)
        self.P = symmetric.keep(self.P, np.concatenate([_CAMERA, kept_rows.ravel()]))
        self.blocks = self.blocks[used]
        self.ids = self.ids[stays]
        self.parameter_block = renumbered[self.parameter_block[stays]]
        anchor = self.anchor_block[stays]
        self.anchor_block = np.where(anchor < 0, -1, renumbered[anchor])
