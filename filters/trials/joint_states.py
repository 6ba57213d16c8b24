"""The joint states of B trials in one array, so that every operation on them is one operation.

As in `filters.engine.joint_state` the error state of a trial is the 12 numbers of the camera, then the map. Here every
trial has the same number of places for landmarks, taken or free, and a landmark keeps its own numbers together: anchor
(where it has one) and parameters. Anchors are not shared: the estimates are the same, and with landmarks that come and
go there is little to share. P is kept whole, both triangles, row-major. A landmark that leaves takes nothing with it:
its place stays in the joint state as a marginal nobody looks at, which changes nothing for the others, until a new
landmark is written over it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from filters.engine.joint_state import JointState
from filters.landmarks.parametrisation import LandmarkModel, NewLandmarks
from filters.motion import CAMERA_SIZE, POSE_SIZE, CameraState
from filters.validation import BoolArray, FloatArray, IntArray

IDLE_SHARE = 0.25  # of the places, beyond which the arrays are made smaller


@dataclass(eq=False)
class JointStates:
    """Cameras, maps and covariances of B trials, with L places for landmarks of w numbers each.

    Attributes
    ----------
    camera : CameraState
        x_C of every trial: (B, 3), (B, 4), (B, 3), (B, 3).
    P : (B, n, n)
        Covariances, n = 12 + w L.
    model : LandmarkModel
        Parametrisation of the landmarks.
    numbers : (B, L, w)
        Anchor (if the model has anchors) and parameters of the landmarks.
    taken : (B, L) bool
        Which places hold a landmark.
    ids : (B, L) int64
        Identities of those landmarks.
    """

    camera: CameraState
    P: FloatArray
    model: LandmarkModel
    numbers: FloatArray
    taken: BoolArray
    ids: IntArray

    @classmethod
    def without_maps(cls, camera: CameraState, P: FloatArray, model: LandmarkModel) -> JointStates:
        """B cameras with their covariances (B, 12, 12), and nothing seen yet."""
        trials, width = len(P), 6 if model.anchored else 3
        nobody = np.zeros((trials, 1), dtype=np.int64)
        states = cls(camera, P.copy(), model, np.zeros((trials, 0, width)), nobody[:, :0].astype(bool), nobody[:, :0])
        states._resize(1)
        return states

    def __len__(self) -> int:
        return len(self.P)

    @property
    def width(self) -> int:
        """Numbers a landmark, w."""
        return self.numbers.shape[2]

    def locate(self, trial: IntArray, ids: IntArray) -> tuple[BoolArray, IntArray]:
        """Which landmarks (N,) are in the maps of their trials, and the place of each that is."""
        same = (self.ids[trial] == ids[:, None]) & self.taken[trial]
        place = same.argmax(axis=1)
        return same[np.arange(len(ids)), place], place

    def anchors_and_parameters(self, trial: IntArray, place: IntArray) -> tuple[FloatArray | None, FloatArray]:
        """Anchors (N, 3), None where the model has none, and parameters (N, 3) of landmarks."""
        numbers = self.numbers[trial, place]
        return (numbers[:, :3] if self.model.anchored else None), numbers[:, -3:]

    def map_rows(self, place: IntArray) -> IntArray:
        """Rows of P of the landmarks at these places; (N,) -> (N, w)."""
        rows: IntArray = CAMERA_SIZE + self.width * place[:, None] + np.arange(self.width)
        return rows

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
        self._make_room(counts)
        number = np.arange(len(trial)) - (np.cumsum(counts) - counts)[trial]
        place = np.argsort(self.taken, axis=1, kind="stable")[trial, number]  # the free ones come first
        self.ids[trial, place] = ids
        self.taken[trial, place] = True
        self.numbers[trial, place, :3] = self.camera.position[trial]
        self.numbers[trial, place, -3:] = new.parameters
        by_pose = np.zeros((len(trial), self.width, POSE_SIZE))
        by_pose[:, :3, :3] = np.eye(3)
        by_pose[:, -3:, :3], by_pose[:, -3:, 3:] = new.by_position, new.by_rotation
        rows = self.map_rows(place)
        # The columns first: with them in place, the rows get the covariances of the new landmarks among each other.
        self.P[trial[:, None], :, rows] = by_pose @ self.P[trial, :POSE_SIZE]
        self.P[trial[:, None], rows] = by_pose @ self.P[trial, :POSE_SIZE]
        own = rows[:, -3:]
        noise = new.by_measurement @ R @ new.by_measurement.swapaxes(1, 2)
        self.P[trial[:, None, None], own[:, :, None], own[:, None, :]] += noise

    def remove(self, gone: BoolArray) -> None:
        """Take the landmarks at the places marked in `gone` (B, L) out of the maps."""
        self.taken &= ~gone

    def single(self, trial: int) -> JointState:
        """The joint state of one trial, on its own."""
        place = np.flatnonzero(self.taken[trial])
        rows = np.concatenate([np.arange(CAMERA_SIZE), self.map_rows(place).ravel()])
        cameras = self.camera
        camera = CameraState(
            cameras.position[trial].copy(),
            cameras.orientation[trial].copy(),
            cameras.linear_velocity[trial].copy(),
            cameras.angular_velocity[trial].copy(),
        )
        blocks, a_landmark = self.numbers[trial, place].reshape(-1, 3), self.width // 3
        parameter_block = a_landmark * np.arange(len(place)) + a_landmark - 1
        return JointState(
            camera,
            np.asfortranarray(self.P[trial][np.ix_(rows, rows)]),
            self.model,
            predicted=camera,
            blocks=blocks,
            first_blocks=blocks.copy(),
            ids=self.ids[trial, place],
            parameter_block=parameter_block,
            anchor_block=parameter_block - 1 if self.model.anchored else np.full(len(place), -1),
        )

    def _make_room(self, wanted: IntArray) -> None:
        """See that every trial has as many free places as it wants (B,), and not far too many."""
        needed = int((self.taken.sum(axis=1) + wanted).max())
        if not needed <= self.taken.shape[1] <= 1 + needed / (1.0 - IDLE_SHARE):
            self._resize(needed + needed // 32)

    def _resize(self, size: int) -> None:
        """Make the arrays anew with `size` places a trial, those taken first."""
        trials, old = self.taken.shape
        kept = np.argsort(~self.taken, axis=1, kind="stable")[:, :size]
        rows = CAMERA_SIZE + self.width * kept[:, :, None] + np.arange(self.width)
        camera = np.broadcast_to(np.arange(CAMERA_SIZE), (trials, CAMERA_SIZE))
        rows = np.concatenate([camera, rows.reshape(trials, -1)], axis=1)
        n, stay = CAMERA_SIZE + self.width * size, rows.shape[1]
        P = np.zeros((trials, n, n))
        of_rows = np.take_along_axis(self.P, rows[:, :, None], axis=1)
        P[:, :stay, :stay] = np.take_along_axis(of_rows, rows[:, None, :], axis=2)
        self.P = P

        def rearranged(values: Any) -> Any:
            made = np.zeros((trials, size, *values.shape[2:]), dtype=values.dtype)
            made[:, : kept.shape[1]] = values[np.arange(trials)[:, None], kept]
            return made

        self.numbers, self.taken, self.ids = rearranged(self.numbers), rearranged(self.taken), rearranged(self.ids)
