"""Recipe of a filter in plain numbers, as kernels read it: parts, options and the leading variables of its state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

from filters.contract.drift import LandmarkDrift
from filters.validation import FloatArray, IntArray

ERRORS = ("quaternion", "so3", "first-estimates", "right-invariant", "invariant")
QUATERNION, SO3, FIRST_ESTIMATES, RIGHT_INVARIANT, INVARIANT = range(5)
CALIBRATION_SIZE = 6
POSE_SIZE = 6
MOST_ROWS, MOST_STAGES = 4, 4  # of a landmark's measurement in one stage, and of these


class Plan(NamedTuple):
    """A recipe as the kernels take it."""

    fx: float
    fy: float
    cx: float
    cy: float
    disparity_constant: float
    anchored: bool
    shares_anchors: bool
    error: int
    by_numbers: bool
    """Whether parts give measurements and new landmarks by numbers, through the doors."""
    moves_by_numbers: bool
    """Whether parts move the state by numbers."""
    changes: bool
    """Whether landmarks may become points after a frame."""
    most_landmarks: int
    """Of the landmarks in view, 0: no limit."""
    joint: bool
    """Whether (u, v, d) is what the first stage has."""
    own_landmarks: bool
    """Whether the landmarks are none that the kernels know."""
    walks_by_numbers: bool
    driven_by_numbers: bool
    consensus: bool
    tail_dof: float
    iterations: int
    drop_unseen: bool
    min_disparity: float
    velocity_driven: bool
    sigma_acceleration: float
    sigma_angular_acceleration: float
    measured: int
    """Leading rows that the measurements depend on: pose and calibration."""
    velocity: int
    """First row of the velocity."""
    leading: int
    """Leading rows in all."""
    calibration: IntArray
    """Row of each error of the calibration, -1 where it is no variable; (6,)."""
    considered: IntArray
    """Rows whose values never move."""
    walk: FloatArray
    """Variance that each leading row gains in a second."""
    stages: IntArray
    """Number of stages without and with a measured right row, (2,)."""
    T: FloatArray
    """(2, stages + 1, 4, 3); the last is (u, v, d)."""
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
class StageRows:
    """One stage of the update: z = T (u, v, d).

    Attributes
    ----------
    T : tuple of (3,) tuples
        One for each row of the measurement.
    right_row : int
        Row that takes the separately measured v_right; -1: none.
    apart_row : int
        Row whose error is independent of the other rows; -1: none.
    apart_scale : float
        Factor of the variance of that row.
    """

    T: tuple[tuple[float, float, float], ...]
    right_row: int = -1
    apart_row: int = -1
    apart_scale: float = 1.0


JOINT = StageRows(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
"""(u, v, d)."""


@dataclass(frozen=True)
class Recipe:
    """What a filter does.

    Attributes
    ----------
    fx, fy, cx, cy, disparity_constant : float
        Of the rectified pair, px and px m.
    anchored, shares_anchors : bool
        Of the landmarks: whether they have anchors, and those of one frame the same.
    value_size : int
        Numbers of a landmark's value.
    own_landmarks : bool
        Whether they are none that the kernels know.
    by_numbers, moves_by_numbers, walks_by_numbers, changes : bool
        Whether parts give measurements and new landmarks, move the state, say what a move of the world does, and make
        points of landmarks, by numbers.
    parts : tuple
        Those that do.
    most_landmarks : int
        Of the landmarks in view, 0: no limit.
    error : {"quaternion", "so3", "first-estimates", "right-invariant", "invariant"}
        Error definition; "invariant" is the right-invariant one with P carried along by the full Jacobian.
    stages, stages_with_right : tuple of StageRows
        Stages of the update where the right row is not measured on its own, and where it is.
    gate : float, optional
        Probability with which a consistent landmark passes all stages.
    consensus, tail_dof, iterations, drop_unseen, min_disparity
        As of `StereoEKF`.
    drift : LandmarkDrift, optional
        Process noise of measured landmarks, with (u, v, d) in one stage.
    gauge_walk : float
        Of camera and map together, rad per root of a radian of image motion.
    motion : {"constant-velocity", "velocity-driven"}, optional
        Motion model; None: by numbers.
    sigma_acceleration, sigma_angular_acceleration : float
        Of constant velocity, m/s^2 and rad/s^2.
    measured_others : int
        Further leading rows that the measurements depend on, by numbers.
    calibration : tuple of int
        Which errors of the pair are variables, ascending: those of disparity (0), focal lengths (1), baseline (2) and
        orientation (3, 4, 5), see `CalibratedPair`.
    others : int
        Further numbers of the state, after the velocity.
    more_values : int
        Numbers of variables whose values have more than their errors; they stand at the end.
    considered : tuple of int
        Leading rows that have covariance and correlations, and whose values never move (Schmidt).
    walk : tuple of float
        Variance that each leading row gains in a second; () for none.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    disparity_constant: float
    anchored: bool = True
    shares_anchors: bool = False
    value_size: int = 3
    by_numbers: bool = False
    moves_by_numbers: bool = False
    own_landmarks: bool = False
    walks_by_numbers: bool = False
    changes: bool = False
    parts: tuple[Any, ...] = ()
    most_landmarks: int = 0
    error: str = "quaternion"
    stages: tuple[StageRows, ...] = (JOINT,)
    stages_with_right: tuple[StageRows, ...] = (JOINT,)
    gate: float | None = 0.99
    consensus: bool = False
    tail_dof: float | None = None
    iterations: int = 1
    drop_unseen: bool = True
    min_disparity: float | None = None
    drift: LandmarkDrift | None = None
    gauge_walk: float = 0.0
    motion: str | None = "constant-velocity"
    sigma_acceleration: float = 3.0
    sigma_angular_acceleration: float = 0.6
    measured_others: int = 0
    calibration: tuple[int, ...] = ()
    others: int = 0
    more_values: int = 0
    considered: tuple[int, ...] = ()
    walk: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.error not in ERRORS:
            raise ValueError(f"error must be one of {', '.join(map(repr, ERRORS))}, got {self.error!r}")
        if list(self.calibration) != [k for k in range(CALIBRATION_SIZE) if k in self.calibration]:
            raise ValueError(f"calibration must be ascending numbers below {CALIBRATION_SIZE}, got {self.calibration}")
        if any(not 0 <= row < self.leading for row in self.considered):
            raise ValueError(f"considered must be rows below {self.leading}, got {self.considered!r}")
        if len(self.walk) not in (0, self.leading):
            raise ValueError(f"walk must have a rate for each of the {self.leading} leading rows, got {len(self.walk)}")
        if self.consensus and self.gate is None:
            raise ValueError("gate must be a probability with consensus=True, got None: it is the limit of agreement")

    @cached_property
    def calibration_rows(self) -> IntArray:
        """Row of each error of the calibration, -1 where it is no variable; (6,)."""
        rows = np.full(CALIBRATION_SIZE, -1)
        rows[[*self.calibration]] = POSE_SIZE + np.arange(len(self.calibration))
        return rows

    @property
    def measured(self) -> int:
        """Leading rows that the measurements depend on."""
        return POSE_SIZE + len(self.calibration) + self.measured_others

    @property
    def velocity(self) -> int:
        """First row of the velocity."""
        return self.measured

    @property
    def leading(self) -> int:
        """Leading rows, a multiple of three: the last ones may be zero."""
        return -(-(self.measured + 6 + self.others) // 3) * 3

    @property
    def asks(self) -> bool:
        """Whether the kernels ask parts for numbers in the middle of a frame."""
        return self.by_numbers or self.moves_by_numbers or self.walks_by_numbers or self.most_landmarks > 0

    @property
    def block_values(self) -> int:
        """Numbers of a block's value: those of an orientation at least."""
        return max(4, self.value_size)

    @property
    def values(self) -> int:
        """Numbers of the leading variables: the orientation has four."""
        return self.leading + 1 + self.more_values

    @cached_property
    def plan(self) -> Plan:
        """The recipe as the kernels take it."""
        variants = (self.stages, self.stages_with_right)
        most = max(map(len, variants)) + 1
        T, rows = np.zeros((2, most, MOST_ROWS, 3)), np.full((2, most, 3), -1)
        scales, limits = np.ones((2, most)), np.full((2, most), np.inf)
        for i, stages in enumerate(variants):
            T[i, most - 1, :3], rows[i, most - 1, 0] = np.eye(3), 3
            for j, stage in enumerate(stages):
                T[i, j, : len(stage.T)] = stage.T
                rows[i, j] = len(stage.T), stage.right_row, stage.apart_row
                scales[i, j] = stage.apart_scale
                if self.gate is not None:
                    limits[i, j] = chdtri(len(stage.T), 1.0 - self.gate ** (1 / len(stages)))
        return Plan(
            fx=float(self.fx),
            fy=float(self.fy),
            cx=float(self.cx),
            cy=float(self.cy),
            disparity_constant=float(self.disparity_constant),
            anchored=self.anchored,
            shares_anchors=self.shares_anchors,
            by_numbers=self.by_numbers,
            moves_by_numbers=self.moves_by_numbers,
            changes=self.changes,
            most_landmarks=self.most_landmarks,
            joint=not self.by_numbers and all(stages[0] == JOINT for stages in variants),
            own_landmarks=self.own_landmarks,
            walks_by_numbers=self.walks_by_numbers,
            driven_by_numbers=self.motion is None,
            error=ERRORS.index(self.error),
            consensus=self.consensus,
            tail_dof=float("inf") if self.tail_dof is None else float(self.tail_dof),
            iterations=self.iterations,
            drop_unseen=self.drop_unseen,
            min_disparity=-float("inf") if self.min_disparity is None else float(self.min_disparity),
            velocity_driven=self.motion == "velocity-driven",
            sigma_acceleration=float(self.sigma_acceleration),
            sigma_angular_acceleration=float(self.sigma_angular_acceleration),
            measured=self.measured,
            velocity=self.velocity,
            leading=self.leading,
            calibration=self.calibration_rows,
            considered=np.array(self.considered, dtype=np.int64),
            walk=np.array(self.walk or np.zeros(self.leading), dtype=np.float64),
            stages=np.array([len(stages) for stages in variants]),
            T=T,
            rows=rows,
            apart_scale=scales,
            gauge_walk=float(self.gauge_walk),
            drift=np.zeros((2, 4)) if self.drift is None else self.drift.parts,
            limits=limits,
        )
