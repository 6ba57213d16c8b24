"""Map management: the landmarks that leave and enter the map after the correction of a frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from filters.camera import StereoCamera
from filters.engine import selection
from filters.engine.joint_state import JointState
from filters.engine.options import Parts
from filters.interface import StereoObservation
from filters.landmarks.hybrid import Hybrid
from filters.motion import CAMERA_SIZE
from filters.noise import StereoNoise
from filters.validation import BoolArray, IntArray

_FARTHEST = 1e6
"""No camera measures a pixel or a disparity as large, px; squares of what would come of 1e300 overflow."""


@dataclass(frozen=True, eq=False)
class MapChange:
    """Ids that left, entered, and were refused; (K,) int64 each."""

    dropped: IntArray
    initialised: IntArray
    rejected: IntArray


@dataclass(frozen=True)
class MapPolicy:
    """Map management of a `JointState`.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        R of measurements that bring none of their own.
    parts : Parts
        Options of the filter.
    """

    camera: StereoCamera
    noise: StereoNoise
    parts: Parts

    def renew(
        self, state: JointState, known: StereoObservation, index: IntArray, unknown: StereoObservation
    ) -> MapChange:
        """Landmarks leave, change over and enter.

        Parameters
        ----------
        state : JointState
            Changed in place.
        known : StereoObservation
            Measurements of landmarks in the map.
        index : (M,) int64
            Those landmarks.
        unknown : StereoObservation
            Measurements of others.
        """
        new = unknown if len(unknown) == 0 else unknown.select(self._can_start(state, unknown))
        gone = np.full(len(state), self.parts.drop_unseen)
        gone[index] = False
        if self.parts.max_landmarks is not None and len(index) + len(new) > self.parts.max_landmarks:
            candidates = selection.next_measurements(
                self.camera, state, index, known.covariances(self.noise), new.uvd, new.covariances(self.noise)
            )
            kept = selection.most_informative(candidates, self.parts.max_landmarks)
            gone[index] = ~kept[: len(index)]
            new = new.select(kept[len(index) :])
        dropped = state.ids[gone]
        state.remove(gone)
        self._change_over(state)
        self.start(state, new)
        refused = unknown.ids[~np.isin(unknown.ids, new.ids)] if len(new) < len(unknown) else unknown.ids[:0]
        return MapChange(dropped, new.ids, refused)

    def start(self, state: JointState, observation: StereoObservation) -> None:
        """Add landmarks from the corrected pose (Eq. 19-25)."""
        if len(observation) == 0:
            return
        landmark, pose, at_once = self.parts.landmark, state.camera, self.parts.arithmetic.initialise
        new = at_once and at_once(landmark, self.camera, pose, observation.uvd)
        new = new or landmark.initialise(self.camera, pose.position, pose.R_wc, observation.uvd)
        adjust = partial(self.parts.error.constrained, state=state) if self.parts.error.constrains else None
        state.augment(observation.ids, new, observation.covariances(self.noise), adjust)

    def _can_start(self, state: JointState, observation: StereoObservation) -> BoolArray:
        """Which measurements a landmark can start from."""
        possible = self.parts.landmark.can_initialise(self.camera, state.camera.R_wc, observation.uvd)
        possible &= (np.abs(observation.uvd) < _FARTHEST).all(axis=1)
        if self.parts.min_disparity is not None:
            possible &= observation.uvd[:, 2] >= self.parts.min_disparity
        return possible

    def _change_over(self, state: JointState) -> None:
        """Hybrid landmarks that are practically Gaussian in XYZ become XYZ."""
        if not isinstance(self.parts.landmark, Hybrid):
            return
        anchors, parameters = state.anchors(), state.parameters()
        assert anchors is not None
        rho_rows = CAMERA_SIZE + 3 * state.parameter_block + 2
        linear = self.parts.landmark.become_points(
            state.camera.position, anchors, parameters, state.P[rho_rows, rho_rows]
        )
        state.become_points(np.flatnonzero(linear), self.parts.error.linearisation_point(state) or state)
