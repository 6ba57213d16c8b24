"""The joint states of B trials in one array, so that every operation on them is one operation.

As in `filters.engine.joint_state` the error state of a trial is the 12 numbers of the camera and blocks of three:
landmark parameters and anchors. Here every trial has the same number of blocks, used or idle. P is kept whole, both
triangles, row-major. A landmark that leaves takes nothing with it: its block stays in the joint state as a marginal
nobody looks at, which changes nothing for the others, until a new landmark is written over it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.engine.joint_state import JointState
from filters.landmarks.parametrisation import LandmarkModel, NewLandmarks
from filters.motion import CAMERA_SIZE, POSE_SIZE, CameraState
from filters.validation import BoolArray, FloatArray, IntArray

SPARE = 2  # blocks beyond those needed, whenever the arrays are made anew
IDLE_SHARE = 0.3  # of all blocks, beyond which the arrays are made anew
_THREE = np.arange(3)


@dataclass(eq=False)
class JointStates:
    """Cameras, maps and covariances of B trials, with S blocks each.

    Attributes
    ----------
    camera : CameraState
        x_C of every trial: (B, 3), (B, 4), (B, 3), (B, 3).
    P : (B, n, n)
        Covariances, n = 12 + 3 S.
    model : LandmarkModel
        Parametrisation of the landmarks. Those that enter a map in one frame always share an anchor here, if they
        have one: the estimates are the same.
    blocks : (B, S, 3)
        Values of the blocks.
    occupied : (B, S) bool
        Which blocks hold the parameters of a landmark.
    ids, anchor_block : (B, S) int64
        Identity of that landmark, and the block of its anchor (where there are anchors).
    """

    camera: CameraState
    P: FloatArray
    model: LandmarkModel
    blocks: FloatArray
    occupied: BoolArray
    ids: IntArray
    anchor_block: IntArray

    @classmethod
    def without_maps(cls, camera: CameraState, P: FloatArray, model: LandmarkModel) -> JointStates:
        """B cameras with their covariances (B, 12, 12), and nothing seen yet."""
        trials, n = len(P), CAMERA_SIZE + 3 * SPARE
        whole = np.zeros((trials, n, n))
        whole[:, :CAMERA_SIZE, :CAMERA_SIZE] = P
        nobody = np.zeros((trials, SPARE), dtype=np.int64)
        return cls(camera, whole, model, np.zeros((trials, SPARE, 3)), nobody.astype(bool), nobody, nobody.copy())

    def __len__(self) -> int:
        return len(self.P)

    def locate(self, trial: IntArray, ids: IntArray) -> tuple[BoolArray, IntArray]:
        """Which landmarks (N,) are in the maps of their trials, and the block of each that is."""
        same = (self.ids[trial] == ids[:, None]) & self.occupied[trial]
        block = same.argmax(axis=1)
        return same[np.arange(len(ids)), block], block

    def parameters(self, trial: IntArray, block: IntArray) -> FloatArray:
        """Parameters of landmarks, (N, 3)."""
        taken: FloatArray = self.blocks[trial, block]
        return taken

    def anchors(self, trial: IntArray, block: IntArray) -> FloatArray | None:
        """Their anchors, (N, 3); None where landmarks have none."""
        return self.blocks[trial, self.anchor_block[trial, block]] if self.model.anchored else None

    def map_rows(self, trial: IntArray, block: IntArray) -> IntArray:
        """Rows of P that belong to each landmark, anchor first; (N, 6) or (N, 3)."""
        if not self.model.anchored:
            return _rows(block)
        return np.concatenate([_rows(self.anchor_block[trial, block]), _rows(block)], axis=1)

    def transform_camera(self, F: FloatArray, added: FloatArray | None = None) -> None:
        """P <- blockdiag(F, I) P blockdiag(F, I)^T, plus `added` on the camera block (Eq. 12); F (B, 12, 12)."""
        rows = F @ self.P[:, :CAMERA_SIZE]
        camera = rows[:, :, :CAMERA_SIZE] @ F.swapaxes(1, 2)
        if added is not None:
            camera += added
        rows[:, :, :CAMERA_SIZE] = 0.5 * (camera + camera.swapaxes(1, 2))
        self.P[:, :CAMERA_SIZE] = rows
        self.P[:, CAMERA_SIZE:, :CAMERA_SIZE] = rows[:, :, CAMERA_SIZE:].swapaxes(1, 2)

    def augment(self, trial: IntArray, ids: IntArray, new: NewLandmarks, R: FloatArray) -> None:
        """Add landmarks with their covariances and cross-covariances (Eq. 19-25).

        Parameters
        ----------
        trial, ids : (N,) int64
            Ascending trials, and the landmarks.
        new : NewLandmarks
            N landmarks.
        R : (N, 3, 3)
            Covariances of the measurements they start from.
        """
        counts = np.bincount(trial, minlength=len(self))
        with_anchor = int(self.model.anchored)
        free = self._free_blocks(counts + with_anchor * (counts > 0))
        number = np.arange(len(trial)) - (np.cumsum(counts) - counts)[trial]
        block = free[trial, with_anchor + number]
        self.ids[trial, block] = ids
        self.occupied[trial, block] = True
        self.blocks[trial, block] = new.parameters
        by_pose = np.concatenate([new.by_position, new.by_rotation], axis=2)
        entered, entered_block = trial, block
        if with_anchor:
            anchored = np.flatnonzero(counts)
            self.anchor_block[trial, block] = free[trial, 0]
            self.blocks[anchored, free[anchored, 0]] = self.camera.position[anchored]
            anchor_by_pose = np.broadcast_to(np.eye(3, POSE_SIZE), (len(anchored), 3, POSE_SIZE))
            by_pose = np.concatenate([by_pose, anchor_by_pose])
            entered, entered_block = np.concatenate([trial, anchored]), np.concatenate([block, free[anchored, 0]])
        rows = _rows(entered_block)
        # The columns first: with them in place, the rows get the covariances of the new blocks among each other.
        self.P[entered[:, None], :, rows] = by_pose @ self.P[entered, :POSE_SIZE]
        self.P[entered[:, None], rows] = by_pose @ self.P[entered, :POSE_SIZE]
        own = rows[: len(trial)]
        noise = new.by_measurement @ R @ new.by_measurement.swapaxes(1, 2)
        self.P[trial[:, None, None], own[:, :, None], own[:, None, :]] += noise

    def remove(self, gone: BoolArray) -> None:
        """Take the landmarks whose blocks are marked in `gone` (B, S) out of the maps."""
        self.occupied &= ~gone

    def single(self, trial: int) -> JointState:
        """The joint state of one trial, on its own."""
        block = np.flatnonzero(self.occupied[trial])
        used = np.flatnonzero(self._in_use()[trial])
        rows = np.concatenate([np.arange(CAMERA_SIZE), _rows(used).ravel()])
        camera = self.camera_of(trial)
        values = self.blocks[trial, used]
        anchor = np.searchsorted(used, self.anchor_block[trial, block]) if self.model.anchored else -np.ones_like(block)
        return JointState(
            camera,
            np.asfortranarray(self.P[trial][np.ix_(rows, rows)]),
            self.model,
            predicted=camera,
            blocks=values,
            first_blocks=values.copy(),
            ids=self.ids[trial, block],
            parameter_block=np.searchsorted(used, block),
            anchor_block=anchor,
        )

    def camera_of(self, trial: int) -> CameraState:
        """x_C of one trial."""
        camera = self.camera
        return CameraState(
            camera.position[trial].copy(),
            camera.orientation[trial].copy(),
            camera.linear_velocity[trial].copy(),
            camera.angular_velocity[trial].copy(),
        )

    def _in_use(self) -> BoolArray:
        """Blocks that hold a landmark or the anchor of one, (B, S)."""
        used = self.occupied.copy()
        if self.model.anchored:
            trial, block = np.nonzero(self.occupied)
            used[trial, self.anchor_block[trial, block]] = True
        return used

    def _free_blocks(self, wanted: IntArray) -> IntArray:
        """All blocks of each trial, free ones first, of which there are at least as many as `wanted` (B,); (B, S)."""
        used = self._in_use()
        needed = int((used.sum(axis=1) + wanted).max())
        if not needed <= used.shape[1] <= (needed + SPARE) / (1.0 - IDLE_SHARE):
            self._rearrange(used, needed + SPARE)
            used = self._in_use()
        return np.argsort(used, axis=1, kind="stable")

    def _rearrange(self, used: BoolArray, size: int) -> None:
        """Make the arrays anew with `size` blocks a trial, those in use first."""
        trials, old = used.shape
        kept = np.argsort(~used, axis=1, kind="stable")[:, :size]
        place = np.zeros_like(self.anchor_block)
        np.put_along_axis(place, kept, np.broadcast_to(np.arange(kept.shape[1]), kept.shape), axis=1)
        moved_anchors = np.take_along_axis(place, self.anchor_block, axis=1)
        rows = np.concatenate(
            [np.broadcast_to(np.arange(CAMERA_SIZE), (trials, CAMERA_SIZE)), _rows(kept).reshape(trials, -1)], axis=1
        )
        n, size_kept = CAMERA_SIZE + 3 * size, rows.shape[1]
        P = np.zeros((trials, n, n))
        taken = np.take_along_axis(self.P, rows[:, :, None], axis=1)
        P[:, :size_kept, :size_kept] = np.take_along_axis(taken, rows[:, None, :], axis=2)
        self.P = P

        def rearranged(values: FloatArray | IntArray | BoolArray) -> FloatArray | IntArray | BoolArray:
            index = kept.reshape(*kept.shape, *(1,) * (values.ndim - 2))
            made = np.zeros((trials, size, *values.shape[2:]), dtype=values.dtype)
            made[:, : kept.shape[1]] = np.take_along_axis(values, index, axis=1)
            return made

        self.blocks, self.occupied = rearranged(self.blocks), rearranged(self.occupied)
        self.ids, self.anchor_block = rearranged(self.ids), rearranged(moved_anchors)


def _rows(block: IntArray) -> IntArray:
    """Rows of P of each block; (..., ) -> (..., 3)."""
    rows: IntArray = CAMERA_SIZE + 3 * block[..., None] + _THREE
    return rows
