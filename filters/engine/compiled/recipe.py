"""Recipe of a filter in plain numbers, as kernels read it: options, kernels of parts and their settings, places."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

from filters.contract.drift import LandmarkDrift
from filters.errors.model import ErrorKernels
from filters.landmarks.model import LandmarkKernels
from filters.measurements.model import MeasurementKernels, StageRows
from filters.motions.model import CAMERA_SIZE, POSE_SIZE, MotionKernels
from filters.validation import FloatArray, IntArray

MOST_ROWS, MOST_STAGES = 4, 4  # of a landmark's measurement in one stage, and of these


class Plan(NamedTuple):
    """A recipe as the kernels take it."""

    camera: FloatArray
    """fx, fy, cx, cy, baseline."""
    landmark: FloatArray
    """Settings of the parts' kernels."""
    sensor: FloatArray
    motion: FloatArray
    size: int
    """Rows of a block: error numbers of a landmark."""
    prior: FloatArray
    """Covariance of those behind the third, (size - 3, size - 3)."""
    anchors: int
    """Blocks of an anchor: 0, 1 (a position) or 2 (a pose)."""
    shares_anchors: bool
    additive: bool
    """Whether a landmark's retraction is addition."""
    points: bool
    """Whether landmarks without an anchor are points of W."""
    follows: IntArray
    """Numbers of a landmark's value that first-estimates Jacobians take from the present."""
    additive_quaternion: bool
    first_estimates: bool
    turns: bool
    resets: bool
    by_numbers: bool
    """Whether parts give measurements and new landmarks by numbers, through the doors."""
    moves_by_numbers: bool
    """Whether parts move the state by numbers."""
    changes: bool
    """Whether landmarks may become points after a frame."""
    carries: bool
    """Whether a step moves landmarks, which are in the frame of the camera."""
    most_landmarks: int
    """Of the landmarks in view, 0: no limit."""
    walks_by_numbers: bool
    driven_by_numbers: bool
    odometry_rows: int
    """Numbers of odometry as a measurement after the step, 0: it is none."""
    consensus: bool
    tail_dof: float
    iterations: int
    drop_unseen: bool
    sigma_points: FloatArray
    """Distance, weights of the centre in mean and covariance, weight of the others; none: by Jacobians."""
    min_disparity: float
    measured: int
    """Leading rows that the measurements depend on: the pose, variables of the sensor, perhaps the velocity."""
    velocity: int
    """First row of the velocity."""
    sees_velocity: bool
    leading: int
    """Leading rows in all."""
    sensed: IntArray
    """Places among the values of the sensor's variables."""
    moved: IntArray
    """Places among the values of what the motion moves."""
    moved_rows: IntArray
    """Rows of what the motion moves."""
    in_world: IntArray
    """First rows of variables that are vectors in W."""
    considered: IntArray
    """Rows whose values never move."""
    walk: FloatArray
    """Variance that each leading row gains in a second."""
    stages: IntArray
    """Number of stages without and with a measured right row, (2,)."""
    T: FloatArray
    """By the numbers of the sensor, (2, stages + 1, 4, 4); the last stage is (u, v, d)."""
    T_uvd: FloatArray
    """By (u, v, d), (2, stages + 1, 4, 3)."""
    rows: IntArray
    """(2, stages, 3): rows of the stage, the row that `v_right` is for, the row apart from the others (-1: none)."""
    apart_scale: FloatArray
    """Factor of the variance of that row, (2, stages)."""
    drift: FloatArray
    """Steps of measured landmarks, `LandmarkDrift.parts`: (2, 4)."""
    gauge_walk: float
    """Of camera and map together, rad per root of a radian of image motion."""
    limits: FloatArray
    """Squared distance up to which a measurement is believed, (2, stages)."""


@dataclass(frozen=True)
class Recipe:
    """What a filter does."""

    camera: tuple[float, ...]
    """fx, fy, cx, cy, px, and the baseline, m."""
    landmark: LandmarkKernels | None
    sensor: MeasurementKernels | None
    motion: MotionKernels | None
    error: ErrorKernels | None
    """Of the parts; None: they go by numbers."""
    stages: tuple[StageRows, ...]
    stages_with_right: tuple[StageRows, ...]
    """Stages of the update where the right row is not measured on its own, and where it is."""
    landmark_settings: tuple[float, ...] = ()
    sensor_settings: tuple[float, ...] = ()
    motion_settings: tuple[float, ...] = ()
    """First argument of these kernels."""
    sensor_size: int = 3
    size: int = 3
    value_size: int = 3
    seen_size: int = 4
    """Numbers of the sensor, of a landmark's error, of its value, and by which it is seen."""
    prior: tuple[tuple[float, ...], ...] = ()
    """Covariance of the error numbers behind the third."""
    anchors: int = 1
    """Blocks of an anchor: 0, 1 (a position) or 2 (a pose)."""
    shares_anchors: bool = False
    additive: bool = True
    follows: tuple[int, ...] = ()
    """As of `LandmarkModel`."""
    resets: bool = False
    """Whether P is carried along by the full Jacobian where the map turns with the camera."""
    by_numbers: bool = False
    """Whether parts give measurements and new landmarks by numbers,"""
    moves_by_numbers: bool = False
    """move the state,"""
    walks_by_numbers: bool = False
    """say what a move of the world does,"""
    changes: bool = False
    """make points of landmarks,"""
    carries: bool = False
    """and move landmarks with the camera."""
    parts: tuple[Any, ...] = ()
    """Those that do."""
    most_landmarks: int = 0
    """Of the landmarks in view, 0: no limit."""
    gate: float | None = 0.99
    """Probability with which a consistent landmark passes all stages."""
    consensus: bool = False
    tail_dof: float | None = None
    iterations: int = 1
    drop_unseen: bool = True
    sigma_points: tuple[float, ...] = ()
    min_disparity: float | None = None
    """As of `StereoEKF`."""
    drift: LandmarkDrift | None = None
    """Process noise of measured landmarks, with (u, v, d) in one stage."""
    gauge_walk: float = 0.0
    """Of camera and map together, rad per root of a radian of image motion."""
    measured: int = POSE_SIZE
    """Leading rows that the measurements depend on."""
    velocity: int = POSE_SIZE
    """First row of the velocity."""
    leading: int = CAMERA_SIZE
    values: int = CAMERA_SIZE + 1
    """Leading rows, a multiple of three, and numbers of the leading variables."""
    sensed: tuple[int, ...] = ()
    moved: tuple[int, ...] = ()
    moved_rows: tuple[int, ...] = ()
    """Places of the values of the sensor's variables, and of the values and errors of what the motion moves."""
    in_world: tuple[int, ...] = ()
    """First rows of variables that are vectors in W."""
    considered: tuple[int, ...] = ()
    """Leading rows that have covariance and correlations, and whose values never move (Schmidt)."""
    walk: tuple[float, ...] = ()
    """Variance that each leading row gains in a second; () for none."""

    @property
    def asks(self) -> bool:
        """Whether the kernels ask parts for numbers in the middle of a frame."""
        numbers = self.by_numbers or self.moves_by_numbers or self.walks_by_numbers
        changes = self.changes and (self.landmark is None or self.landmark.become is None)
        return numbers or changes or self.carries or self.most_landmarks > 0

    @property
    def block_values(self) -> int:
        """Numbers of a block's value: those of an orientation at least."""
        return max(4, self.value_size)

    @cached_property
    def plan(self) -> Plan:
        """The recipe as the kernels take it."""
        variants = (self.stages, self.stages_with_right)
        most = max(map(len, variants)) + 1
        T, T_uvd = np.zeros((2, most, MOST_ROWS, MOST_ROWS)), np.zeros((2, most, MOST_ROWS, 3))
        rows, scales, limits = np.full((2, most, 3), -1), np.ones((2, most)), np.full((2, most), np.inf)
        whole = StageRows(tuple(map(tuple, np.eye(3, self.sensor_size).tolist())))
        for i, stages in enumerate(variants):
            for j, stage in (*enumerate(stages), (most - 1, whole)):
                size = len(stage.T)
                T[i, j, :size, : len(stage.T[0])], T_uvd[i, j, :size] = stage.T, stage.of_uvd()
                rows[i, j] = size, stage.right_row, stage.apart_row
                scales[i, j] = stage.apart_scale
                if self.gate is not None:
                    limits[i, j] = chdtri(size, 1.0 - self.gate ** (1 / max(1, len(stages))))
        error = self.error or ErrorKernels()

        def floats(numbers: tuple[float, ...]) -> FloatArray:
            return np.array(numbers, dtype=np.float64)

        def integers(numbers: tuple[int, ...]) -> IntArray:
            return np.array(numbers, dtype=np.int64)

        return Plan(
            camera=floats(self.camera),
            landmark=floats(self.landmark_settings),
            sensor=floats(self.sensor_settings),
            motion=floats(self.motion_settings),
            size=self.size,
            prior=np.array(self.prior, dtype=np.float64).reshape(len(self.prior), len(self.prior)),
            anchors=self.anchors,
            shares_anchors=self.shares_anchors,
            additive=self.additive,
            points=self.landmark is not None and self.landmark.turn is None,
            follows=integers(self.follows),
            additive_quaternion=error.additive_quaternion,
            first_estimates=error.first_estimates,
            turns=error.turns,
            resets=error.turns and self.resets,
            by_numbers=self.by_numbers,
            moves_by_numbers=self.moves_by_numbers,
            changes=self.changes,
            carries=self.carries,
            most_landmarks=self.most_landmarks,
            walks_by_numbers=self.walks_by_numbers,
            driven_by_numbers=self.motion is None,
            odometry_rows=0 if self.motion is None else self.motion.rows,
            consensus=self.consensus,
            tail_dof=float("inf") if self.tail_dof is None else float(self.tail_dof),
            iterations=self.iterations,
            drop_unseen=self.drop_unseen,
            sigma_points=floats(self.sigma_points),
            min_disparity=-float("inf") if self.min_disparity is None else float(self.min_disparity),
            measured=self.measured,
            velocity=self.velocity,
            sees_velocity=self.measured > self.velocity,
            leading=self.leading,
            sensed=integers(self.sensed),
            moved=integers(self.moved),
            moved_rows=integers(self.moved_rows),
            in_world=integers(self.in_world),
            considered=integers(self.considered),
            walk=floats(self.walk or (0.0,) * self.leading),
            stages=np.array([len(stages) for stages in variants]),
            T=T,
            T_uvd=T_uvd,
            rows=rows,
            apart_scale=scales,
            drift=np.zeros((2, 4)) if self.drift is None else self.drift.parts,
            gauge_walk=float(self.gauge_walk),
            limits=limits,
        )
