"""Smoothing guided by a filter: an EKF goes ahead, and a graph of GTSAM takes the measurements that it believes."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from filters import (
    BodyVelocity,
    CameraState,
    Forecast,
    InertialSamples,
    LandmarkBelief,
    MotionModel,
    Start,
    StereoCamera,
    StereoEKF,
    StereoNoise,
    StereoObservation,
    UpdateReport,
    VelocityDriven,
)
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.parts import Named
from stereo_slam_env.baselines.camera_alone import CameraFilter
from stereo_slam_env.baselines.smoothing_graph import Sightings, SmoothingGraph, load_gtsam

# A landmark enters the graph once its inverse distance is so many standard deviations from zero, and then with all its
# measurements: a point that may lie at infinity has no XYZ to linearise at.
SIGMAS_TO_ENTER = 3.0


@dataclass(frozen=True, eq=False)
class _Step:
    """One `predict` that is not in the graph yet, with the guide's pose (R_wc, position) after it."""

    dt: float
    odometry: BodyVelocity | None
    R: FloatArray
    position: FloatArray


class GuidedSmoother(CameraFilter):
    """A smoother whose measurements, first values and map come from an EKF with shared anchors.

    The guide says which measurements to believe and where a landmark lies when it enters the graph. After each
    solution its world is moved so that its camera is where the last pose of the graph came out. The map (`landmarks`,
    `forecast`) is the guide's. A subclass says what the graph is, when it is solved, and what is believed between
    solutions. Needs the extra `gtsam`.

    Parameters
    ----------
    camera, noise, motion
        See `CameraFilter`; odometry, where given, is a further factor beside `motion`.
    gate, consensus, tail_dof
        Defences of the guide, see `StereoEKF`: what it does not believe is not used here either, and the track goes on
        as a new landmark. With `tail_dof` the factors count by Cauchy's loss, with Student's weight dof / (dof + d^2),
        d now that of the whole track.
    right_row : bool
        Whether a row measured in the right image (`v_right`) is used, as a second measurement of v.

    Raises
    ------
    ValueError
        gtsam is not installed, or an option has an impossible value.
    """

    open_options = frozenset({"motion", "gate", "consensus", "tail_dof"})
    _graph: SmoothingGraph

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        motion: Named | MotionModel | None = None,
        gate: float | None = 0.99,
        consensus: bool = False,
        tail_dof: float | None = None,
        right_row: bool = True,
    ) -> None:
        if not isinstance(right_row, bool):
            raise ValueError(f"right_row must be True or False, got {right_row!r}")
        load_gtsam()
        self._right_row = right_row
        self._tail_dof = tail_dof
        self._guide = StereoEKF(
            camera,
            noise,
            motion=motion,
            gate=gate,
            consensus=consensus,
            tail_dof=tail_dof,
            landmark="shared-anchor",
            measurement="stacked" if right_row else "joint",
        )
        super().__init__(camera, noise, motion=motion)

    @abstractmethod
    def _new_graph(self, start: CameraState, P: FloatArray) -> SmoothingGraph:
        """The graph of a drive that begins at `start`."""

    @abstractmethod
    def _finish(self, believed: bool) -> None:
        """Solve where it is time and set the belief, after a frame of which the guide believes something or nothing."""

    def _restart(self) -> None:
        start, P = self._belief.state, self._belief.P
        self._guide.reset(Start(start.position, start.orientation, start.linear_velocity, start.angular_velocity, P))
        self._graph = self._new_graph(start, P)
        self._turn, self._shift = np.eye(3), np.zeros(3)  # p_w = turn p_guide + shift
        self._steps: list[_Step] = []
        self._known_to_graph = start.R_wc, start.position  # the guide's pose at the last pose of the graph
        self._sightings: list[Sightings] = []
        self._tracks: dict[int, int] = {}  # number of the current track of each id
        self._started = 0
        self._located: dict[int, tuple[int, FloatArray]] = {}  # by track: pose number and p_c there

    def predict(self, dt: float, odometry: BodyVelocity | None = None, inertial: InertialSamples | None = None) -> None:
        """Move the guide forward; the step enters the graph with the next frame."""
        super().predict(dt, odometry, inertial)
        self._guide.predict(dt, odometry)
        self._steps.append(_Step(float(dt), odometry, *self._pose_of_guide()))

    def _use(self, observation: StereoObservation) -> UpdateReport:
        """Let the guide judge the frame, keep what it believes, and solve when it is time."""
        report = self._guide.update(observation)
        if self._steps:
            self._steps[-1] = _Step(self._steps[-1].dt, self._steps[-1].odometry, *self._pose_of_guide())
        self._add_steps()
        uvd, R = self._measurements(observation)
        believed = np.isin(observation.ids, np.concatenate([report.updated, report.initialised]))
        for lost in observation.ids[~believed].tolist():
            self._tracks.pop(lost, None)
        tracks = np.array([self._track_of(i) for i in observation.ids[believed].tolist()], dtype=np.int64)
        now = np.full(len(tracks), self._graph.last)
        self._sightings.append(Sightings(now, tracks, uvd[believed], R[believed]))
        self._locate()
        self._finish(bool(believed.any()))
        return report

    def _track_of(self, i: int) -> int:
        """Number of the track of a landmark; a new one where it has none."""
        if i not in self._tracks:
            self._tracks[i] = self._started
            self._started += 1
        return self._tracks[i]

    def _add_steps(self) -> None:
        """Poses for the steps since the last frame, started where the guide has moved."""
        for step in self._steps:
            R, position = self._known_to_graph
            models = [self._motion] if step.odometry is None else [self._motion, VelocityDriven()]
            self._graph.add_move(step.dt, step.odometry, models, R.T @ step.R, R.T @ (step.position - position))
            self._known_to_graph = step.R, step.position
        self._steps = []

    def _locate(self) -> None:
        """Note where the guide sees the landmarks whose depth it knows."""
        beliefs = self._guide.landmarks
        certain = beliefs.inverse_distance >= SIGMAS_TO_ENTER * np.sqrt(beliefs.inverse_distance_variance)
        R, position = self._pose_of_guide()
        p_c = (beliefs.positions[certain] - position) @ R
        for i, seen in zip(beliefs.ids[certain].tolist(), p_c, strict=True):
            if i in self._tracks and seen[2] > 0.0:
                self._located[self._tracks[i]] = self._graph.last, seen

    def _solve(self) -> None:
        """Give the graph what it can use, solve it, and move the guide's world to its last pose."""
        self._add_steps()
        if self._sightings:
            self._sightings = [self._graph.add_sightings(Sightings.joined(self._sightings), self._located)]
        self._graph.solve()
        solved, (R, position) = self._graph.state(), self._known_to_graph
        self._turn = solved.R_wc @ R.T
        self._shift = solved.position - self._turn @ position

    def _pose_of_guide(self) -> tuple[FloatArray, FloatArray]:
        pose = self._guide.pose
        return rotations.matrix(pose.orientation), pose.position

    def _measurements(self, observation: StereoObservation) -> tuple[FloatArray, FloatArray]:
        """(u, v, d) and R, with v the mean of both eyes' rows where the right one was measured too."""
        uvd, R = observation.uvd, observation.covariances(self.noise)
        if observation.v_right is None or not self._right_row:
            return uvd, R
        averaged = uvd.copy()
        averaged[:, 1] = 0.5 * (uvd[:, 1] + observation.v_right)
        half = np.diag([1.0, 0.5, 1.0])
        R_averaged = half @ R @ half
        R_averaged[:, 1, 1] += 0.25 * R[:, 1, 1]
        return averaged, R_averaged

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Let the guide forget them; what they have told the graph stays."""
        self._guide.forget(ids)
        for i in np.asarray(ids).tolist():
            self._tracks.pop(i, None)

    def forecast(self, ids: Sequence[int] | IntArray | None = None) -> Forecast:
        """The guide's forecast: it does not depend on where the world is."""
        return self._guide.forecast(ids)

    @property
    def landmarks(self) -> LandmarkBelief:
        """The guide's map, in the world of the graph."""
        beliefs = self._guide.landmarks
        with np.errstate(invalid="ignore"):  # landmarks at infinity
            positions = beliefs.positions @ self._turn.T + self._shift
            covariances = self._turn @ beliefs.covariances @ self._turn.T
        inverse, variance = beliefs.inverse_distance, beliefs.inverse_distance_variance
        return LandmarkBelief(beliefs.ids, positions, covariances, inverse, variance)
