"""The joint states of B trials in one array, so that every operation on them is one operation.

As in `filters.engine.joint_state` the error state of a trial is the 12 numbers of the camera and blocks of three. Here
every trial has the same number of them, used or idle, in a fixed order: camera, shared anchors, landmarks. An anchor
that is not shared stands before the parameters of its landmark: that makes a larger state than shared ones and needs
less looking up, so it is faster where landmarks enter one by one. P is kept whole, both triangles, row-major.

A landmark that leaves takes nothing with it: its numbers stay in the joint state as a marginal nobody looks at, which
changes nothing for the others, until a new landmark is written over it.
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
    """Cameras, maps and covariances of B trials, with places for A shared anchors and L landmarks each.

    Attributes
    ----------
    camera : CameraState
        x_C of every trial: (B, 3), (B, 4), (B, 3), (B, 3).
    P : (B, n, n)
        Covariances, n = 12 + 3 A + w L.
    model : LandmarkModel
        Parametrisation of the landmarks.
    anchors : (B, A, 3)
        Shared anchors; A = 0 where the model shares none.
    own : (B, L, w)
        Numbers of each landmark: an anchor of its own (w = 6) or none (w = 3), then its parameters.
    taken : (B, L) bool
        Which places hold a landmark.
    ids, anchor_of : (B, L) int64
        Identities of those landmarks, and the places of their anchors.
    """

    camera: CameraState
    P: FloatArray
    model: LandmarkModel
    anchors: FloatArray
    own: FloatArray
    taken: BoolArray
    ids: IntArray
    anchor_of: IntArray

    @classmethod
    def without_maps(cls, camera: CameraState, P: FloatArray, model: LandmarkModel) -> JointStates:
        """B cameras with their covariances (B, 12, 12), and nothing seen yet."""
        nobody, nowhere = np.zeros((len(P), 0), dtype=np.int64), np.zeros((len(P), 0, 6))
        own = nowhere if model.anchored and not model.shares_anchors else nowhere[:, :, :3]
        states = cls(camera, P.copy(), model, nowhere[:, :, :3], own, nobody.astype(bool), nobody, nobody)
        states._resize(int(model.shares_anchors), 1)
        return states

    def __len__(self) -> int:
        return len(self.P)

    @property
    def head(self) -> int:
        """Rows of camera and shared anchors; the landmarks' own are behind them."""
        return CAMERA_SIZE + 3 * int(self.anchors.shape[1])

    @property
    def sizes(self) -> IntArray:
        """Numbers in the error state of each trial, places in use only; (B,)."""
        sizes: IntArray = self.own.shape[2] * self.taken.sum(axis=1) + 3 * self._anchors_in_use().sum(axis=1)
        return CAMERA_SIZE + sizes

    def locate(self, trial: IntArray, ids: IntArray) -> tuple[BoolArray, IntArray]:
        """Which landmarks (N,) are in the maps of their trials, and the place of each that is."""
        same = (self.ids[trial] == ids[:, None]) & self.taken[trial]
        place = same.argmax(axis=1)
        return same[np.arange(len(ids)), place], place

    def anchors_and_parameters(self, trial: IntArray, place: IntArray) -> tuple[FloatArray | None, FloatArray]:
        """Anchors (N, 3), None where the model has none, and parameters (N, 3) of the landmarks at these places."""
        own = self.own[trial, place]
        if self.model.shares_anchors:
            return self.anchors[trial, self.anchor_of[trial, place]], own
        return (own[:, :3] if self.model.anchored else None), own[:, -3:]

    def map_rows(self, trial: IntArray, place: IntArray) -> IntArray:
        """Rows of P of the landmarks at these places, anchor first; (N,), (N,) -> (N, 6) or (N, 3)."""
        own = _rows(self.head, self.own.shape[2], place)
        if not self.model.shares_anchors:
            return own
        return np.concatenate([_rows(CAMERA_SIZE, 3, self.anchor_of[trial, place]), own], axis=1)

    def add(self, delta: FloatArray) -> None:
        """Correct anchors and parameters by delta (B, n)."""
        self.anchors += delta[:, CAMERA_SIZE : self.head].reshape(self.anchors.shape)
        self.own += delta[:, self.head :].reshape(self.own.shape)

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
        anchor_by_pose = np.eye(3, POSE_SIZE)
        if self.model.shares_anchors:
            entered = np.flatnonzero(counts)
            anchor = self._anchors_in_use().argmin(axis=1)  # a free one
            self.anchor_of[trial, place] = anchor[trial]
            self.anchors[entered, anchor[entered]] = self.camera.position[entered]
            self._correlate(entered, _rows(CAMERA_SIZE, 3, anchor[entered]), anchor_by_pose)
        self.ids[trial, place] = ids
        self.taken[trial, place] = True
        self.own[trial, place, :3] = self.camera.position[trial]
        self.own[trial, place, -3:] = new.parameters
        rows = _rows(self.head, self.own.shape[2], place)
        by_pose = np.empty((*rows.shape, POSE_SIZE))
        by_pose[:, :3] = anchor_by_pose
        by_pose[:, -3:, :3], by_pose[:, -3:, 3:] = new.by_position, new.by_rotation
        self._correlate(trial, rows, by_pose)
        rows = rows[:, -3:]
        noise = new.by_measurement @ R @ new.by_measurement.swapaxes(1, 2)
        self.P[trial[:, None, None], rows[:, :, None], rows[:, None, :]] += noise

    def remove(self, gone: BoolArray) -> None:
        """Take the landmarks at the places marked in `gone` (B, L) out of the maps."""
        self.taken &= ~gone

    def single(self, trial: int) -> JointState:
        """The joint state of one trial, on its own."""
        place = np.flatnonzero(self.taken[trial])
        anchor = np.flatnonzero(self._anchors_in_use()[trial])
        width = self.own.shape[2]
        rows = (np.arange(CAMERA_SIZE), _rows(CAMERA_SIZE, 3, anchor), _rows(self.head, width, place))
        index = np.concatenate([part.ravel() for part in rows])
        cameras = self.camera
        camera = CameraState(
            cameras.position[trial].copy(),
            cameras.orientation[trial].copy(),
            cameras.linear_velocity[trial].copy(),
            cameras.angular_velocity[trial].copy(),
        )
        blocks = np.concatenate([self.anchors[trial, anchor], self.own[trial, place].reshape(-1, 3)])
        parameter_block = len(anchor) + width // 3 * np.arange(1, len(place) + 1) - 1
        anchor_block = parameter_block - 1 if self.model.anchored else np.full(len(place), -1)
        if self.model.shares_anchors:
            anchor_block = np.searchsorted(anchor, self.anchor_of[trial, place])
        return JointState(
            camera,
            np.asfortranarray(self.P[trial][np.ix_(index, index)]),
            self.model,
            predicted=camera,
            blocks=blocks,
            first_blocks=blocks.copy(),
            ids=self.ids[trial, place],
            parameter_block=parameter_block,
            anchor_block=anchor_block,
        )

    def _correlate(self, trial: IntArray, rows: IntArray, by_pose: FloatArray) -> None:
        """Covariances of rows (N, r) of P that are functions of the pose, by_pose (N, r, 6), with everything."""
        # The columns first: with them in place, the rows get the covariances of the new ones among each other.
        self.P[trial[:, None], :, rows] = by_pose @ self.P[trial, :POSE_SIZE]
        self.P[trial[:, None], rows] = by_pose @ self.P[trial, :POSE_SIZE]

    def _anchors_in_use(self) -> BoolArray:
        """Which of the shared anchors have a landmark, (B, A)."""
        used = np.zeros(self.anchors.shape[:2], dtype=bool)
        if self.model.shares_anchors:
            trial, place = np.nonzero(self.taken)
            used[trial, self.anchor_of[trial, place]] = True
        return used

    def _make_room(self, wanted: IntArray) -> None:
        """See that every trial has a free anchor and as many free places as it wants (B,), and not far too many."""
        needed = int((self.taken.sum(axis=1) + wanted).max())
        anchors = int(self._anchors_in_use().sum(axis=1).max()) + 1 if self.model.shares_anchors else 0
        places = np.array([self.anchors.shape[1], self.taken.shape[1]])
        enough = np.array([anchors, needed])
        if (places < enough).any() or (places > 2 + enough / (1.0 - IDLE_SHARE)).any():
            self._resize(anchors + anchors // 8, needed + needed // 32)

    def _resize(self, anchors: int, landmarks: int) -> None:
        """Make the arrays anew with so many places a trial, those in use first."""
        trials = np.arange(len(self))[:, None]
        kept_anchors = np.argsort(~self._anchors_in_use(), axis=1, kind="stable")[:, :anchors]
        kept = np.argsort(~self.taken, axis=1, kind="stable")[:, :landmarks]
        width = self.own.shape[2]
        camera = np.broadcast_to(np.arange(CAMERA_SIZE), (len(self), CAMERA_SIZE))
        old = [camera, _rows(CAMERA_SIZE, 3, kept_anchors), _rows(self.head, width, kept)]
        moved_to = np.zeros(self.anchors.shape[:2], dtype=np.int64)
        moved_to[trials, kept_anchors] = np.arange(kept_anchors.shape[1])
        anchor_of = (
            np.take_along_axis(moved_to, self.anchor_of, axis=1) if self.model.shares_anchors else self.anchor_of
        )

        def rearranged(values: Any, index: IntArray, places: int) -> Any:
            made = np.zeros((len(self), places, *values.shape[2:]), dtype=values.dtype)
            made[:, : index.shape[1]] = values[trials, index]
            return made

        self.anchors = rearranged(self.anchors, kept_anchors, anchors)
        self.own = rearranged(self.own, kept, landmarks)
        self.taken, self.ids = rearranged(self.taken, kept, landmarks), rearranged(self.ids, kept, landmarks)
        self.anchor_of = rearranged(anchor_of, kept, landmarks)
        before = CAMERA_SIZE + 3 * kept_anchors.shape[1]
        rows_old = np.concatenate([rows.reshape(len(self), -1) for rows in old], axis=1)
        rows_new = np.r_[:before, self.head : self.head + width * kept.shape[1]]
        P = np.zeros((len(self), self.head + width * landmarks, self.head + width * landmarks))
        of_rows = np.take_along_axis(self.P, rows_old[:, :, None], axis=1)
        P[:, rows_new[:, None], rows_new] = np.take_along_axis(of_rows, rows_old[:, None, :], axis=2)
        self.P = P


def _rows(first: int, width: int, place: IntArray) -> IntArray:
    """Rows of the blocks of this width at these places, counted from a first row; (...) -> (..., width)."""
    rows: IntArray = first + width * place[..., None] + np.arange(width)
    return rows
