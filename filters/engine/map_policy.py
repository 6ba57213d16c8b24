"""Map management: the landmarks that leave and enter the map after the correction of a frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from filters.contract.noise import StereoNoise
from filters.contract.observation import StereoObservation
from filters.engine import selection
from filters.engine.options import Options
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from filters.measurements.model import MeasurementModel
from filters.state.joint_state import JointState, NewLandmarks
from filters.validation import BoolArray, FloatArray, IntArray

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
    options : Options
        Options of the filter.
    """

    camera: StereoCamera
    noise: StereoNoise
    options: Options

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
        gone = np.full(len(state), self.options.drop_unseen)
        gone[index] = False
        if self.options.max_landmarks is not None and len(index) + len(new) > self.options.max_landmarks:
            candidates = selection.next_measurements(
                self.options.measurement,
                self.camera,
                state,
                index,
                known.covariances(self.noise),
                new.uvd,
                new.covariances(self.noise),
            )
            kept = selection.most_informative(candidates, self.options.max_landmarks)
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
        new = start_landmarks(
            self.options.measurement, self.camera, state, observation, observation.covariances(self.noise)
        )
        error = self.options.error
        state.augment(new, partial(error.constrained, state=state) if error.constrains else None)

    def _can_start(self, state: JointState, observation: StereoObservation) -> BoolArray:
        """Which measurements a landmark can start from."""
        uvd = observation.uvd
        possible: BoolArray = np.all(np.abs(uvd) < _FARTHEST, axis=1)
        if self.options.min_disparity is not None:
            possible &= uvd[:, 2] >= self.options.min_disparity
        points_c = self.options.measurement.backproject(self.camera, uvd[possible], state.camera.variables)
        h_w = rotations.turned(state.camera.R_wc, points_c[:, :3])
        possible[possible] = self.options.landmark.can_start(h_w, points_c[:, 3]) & np.isfinite(points_c).all(axis=1)
        return possible

    def _change_over(self, state: JointState) -> None:
        """Landmarks that are practically Gaussian in XYZ become XYZ."""
        if self.options.landmark.steady or len(state) == 0:
            return
        own = state.own_rows()
        linear = self.options.landmark.become_points(
            state.camera.position, state.anchors(), state.parameters(), state.P[own, own]
        )
        state.become_points(np.flatnonzero(linear), self.options.error.linearisation_point(state) or state)


def start_landmarks(
    sensor: MeasurementModel, camera: StereoCamera, state: JointState, observation: StereoObservation, R: FloatArray
) -> NewLandmarks:
    """Landmarks at the measurements (M,) of the present pose (Eq. 19-24), with their Jacobians and noise (Eq. 25).

    Parameters
    ----------
    sensor : MeasurementModel
        What is measured.
    camera : StereoCamera
        The rig.
    state : JointState
        Has the pose, the values of the sensor's variables, and the parametrisation.
    observation : StereoObservation
        M measurements.
    R : (M, 3, 3)
        Their covariance.
    """
    variables = state.camera.variables
    points_c = sensor.backproject(camera, observation.uvd, variables)
    jacobians = sensor.backprojection_jacobians(camera, observation.uvd, variables)
    R_wc = state.camera.R_wc
    started = state.model.started(state.camera.position, rotations.turned(R_wc, points_c[:, :3]), points_c[:, 3])
    by_direction_c = started.by_direction @ R_wc
    by_point = np.concatenate([by_direction_c, started.by_scale[:, :, None]], axis=2)
    by_rotation = -by_direction_c @ rotations.skew(points_c[:, :3])
    by_variables = [by_point @ jacobians.by_variable[variable.name] for variable in sensor.variables]
    by_measurement = by_point @ jacobians.by_point
    noise = by_measurement @ R @ by_measurement.transpose(0, 2, 1)
    by_leading = np.concatenate([started.by_position, by_rotation, *by_variables], axis=2)
    return NewLandmarks(observation.ids, started, by_leading, noise)
