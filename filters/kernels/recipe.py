"""Recipe of a filter in plain numbers, as kernels read it: options, kernels of parts and their settings, places."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from filters.contract.noise import gate_limit
from filters.geometry.arrays import FloatArray, IntArray
from filters.measurements.measurement_model import StageRows
from filters.motions.motion_model import CAMERA_SIZE, POSE_SIZE

MOST_ROWS = 4  # of a landmark's measurement in one stage
Function = Callable[..., None]
_NONE, _NOWHERE = np.zeros(0), np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Functions:
    """Functions of a part for all its landmarks, points or steps at once, made of its plain ones.

    Arrays are C-ordered. The first argument is the settings; results are written into the last ones, zero before. A
    landmark is related to its anchor, or to the origin of W where it has none. Of the k numbers by which it is seen the
    first four are those of a point; n are its error numbers, v those of its value.
    """

    point: Function | None = None
    """(values (M, v), points (M, k), J (M, k, n)): points, and what else is seen, with Jacobians by the errors."""
    start: Function | None = None
    """(points (M, k), values (M, v), J (M, n, k), possible (M,)): the inverse, and where a landmark can start."""
    turn: Function | None = None
    """(values (M, v), theta (3,), correction (M, n), moved (M, v), J (M, n, n), J_theta (M, n, 3)): corrected, and
    turned with the world. None: values are points of W, and numbers behind them that do not turn."""
    rotation: Function | None = None
    """(values (M, v), effect (M, n, 3)): of a rotation of the world on the errors."""
    shift: Function | None = None
    """(values (M, v), effect (M, n, 3)): of a shift of the world on them; only of landmarks without an anchor that are
    no points of W."""
    become: Function | None = None
    """(to_anchor (M, 3), values (M, v), variances (M, n), becomes (M,)): which become points, by the way from the
    camera to the anchor."""
    project: Function | None = None
    """(camera (5,), points (M, k), values of variables, numbers (M, s), J (M, s, k), J by the values, ahead (M,))."""
    backproject: Function | None = None
    """(camera (5,), uvd (M, 3), values of variables, points (M, k), J (M, k, 3), J by the values)."""
    step: Function | None = None
    """(state (v,), dt, odometry (K, w), moved (v,), F (m, m), Q (m, m)): a step of what a motion moves."""
    measure: Function | None = None
    """(moved (v,), dt, odometry (K, w), innovation (6,), H (6, m), R (6, 6)): odometry as a measurement after it."""
    settings: tuple[str, ...] = ()
    """Attributes of the part whose numbers are the first argument."""
    in_python: bool = False
    """Whether they run in Python, because Numba cannot compile what they are made of."""
    made_by: tuple[Any, ...] = ()
    """Function that has made them, and its arguments: by these a copy in another process is made."""

    def __reduce__(self) -> Any:
        """Arguments that make them again."""
        return self.made_by[0], self.made_by[1:]

    def __eq__(self, other: object) -> bool:
        if self is other or not isinstance(other, Functions) or not self.made_by:
            return self is other
        try:
            return bool(self.made_by == other.made_by)
        except ValueError:  # settings that are arrays
            return False

    def __hash__(self) -> int:
        return hash(self.made_by[:1]) if self.made_by else id(self)


class Plan(NamedTuple):
    """A recipe as the kernels take it."""

    camera: FloatArray = _NONE
    """fx, fy, cx, cy, baseline."""
    landmark: FloatArray = _NONE
    """Settings of the parts' kernels."""
    sensor: FloatArray = _NONE
    motion: FloatArray = _NONE
    size: int = 3
    """Rows of a block: error numbers of a landmark."""
    prior: FloatArray = np.zeros((0, 0))
    """Covariance of those behind the third, (size - 3, size - 3)."""
    memory: float = np.inf
    """Time constant with which those go back to zero, s."""
    anchors: int = 1
    """Blocks of an anchor: 0, 1 (a position) or 2 (a pose)."""
    shares_anchors: bool = False
    additive: bool = True
    """Whether a landmark's retraction is addition."""
    points: bool = False
    """Whether landmarks without an anchor are points of W."""
    follows: IntArray = _NOWHERE
    """Numbers of a landmark's value that first-estimates Jacobians take from the present."""
    additive_quaternion: bool = False
    first_estimates: bool = False
    turns: bool = False
    resets: bool = False
    changes: bool = False
    """Whether landmarks may become points after a frame."""
    odometry_rows: int = 0
    """Numbers of odometry as a measurement after the step, 0: it is none."""
    consensus: bool = False
    tail_dof: float = np.inf
    iterations: int = 1
    relinearise_above: float = 0.0
    """Squared miss of a tangent, by the variances of its rows, up to which it is kept in further passes; 0: none is."""
    drop_unseen: bool = True
    sigma_points: FloatArray = _NONE
    """Distance, weights of the centre in mean and covariance, weight of the others; none: by Jacobians."""
    min_disparity: float = -np.inf
    measured: int = POSE_SIZE
    """Leading rows that the measurements depend on: the pose, variables of the sensor, perhaps the velocity."""
    velocity: int = POSE_SIZE
    """First row of the velocity."""
    sees_velocity: bool = False
    leading: int = CAMERA_SIZE
    """Leading rows in all."""
    sensed: IntArray = _NOWHERE
    """Places among the values of the sensor's variables."""
    moved: IntArray = _NOWHERE
    """Places among the values of what the motion moves."""
    moved_rows: IntArray = _NOWHERE
    """Rows of what the motion moves."""
    in_world: IntArray = _NOWHERE
    """First rows of variables that are vectors in W."""
    rotations: IntArray = np.zeros((0, 2), dtype=np.int64)
    """First rows of variables that are orientations, and the places of their values, (K, 2)."""
    considered: IntArray = _NOWHERE
    """Rows whose values never move."""
    walk: FloatArray = _NONE
    """Variance that each leading row gains in a second."""
    stages: IntArray = _NOWHERE
    """Number of stages without and with a measured right row, (2,)."""
    T: FloatArray = np.zeros((0, 0, 0, 0))
    """By the numbers of the sensor, (2, stages + 1, 4, 4); the last stage is (u, v, d)."""
    T_uvd: FloatArray = np.zeros((0, 0, 0, 0))
    """By (u, v, d), (2, stages + 1, 4, 3)."""
    rows: IntArray = np.zeros((0, 0, 0), dtype=np.int64)
    """(2, stages, 3): rows of the stage, the row that `v_right` is for, the row apart from the others (-1: none)."""
    apart_scale: FloatArray = np.zeros((0, 0))
    """Factor of the variance of that row, (2, stages)."""
    drift: FloatArray = np.zeros((2, 4))
    """Steps of measured landmarks, `LandmarkDrift.parts`: (2, 4)."""
    gauge_walk: float = 0.0
    """Of camera and map together, rad per root of a radian of image motion."""
    limits: FloatArray = np.zeros((0, 0))
    """Squared distance up to which a measurement is believed, (2, stages)."""


@dataclass(frozen=True, eq=False)
class Recipe:
    """Recipe of a filter: parts, sizes and options that its kernels need."""

    plan: Plan = Plan()  # noqa: RUF009
    """As the kernels read it."""
    landmark: Functions = Functions()
    sensor: Functions = Functions()
    motion: Functions = Functions()
    """Of the parts."""
    sensor_size: int = 3
    value_size: int = 3
    seen_size: int = 4
    """Numbers of the sensor, of a landmark's value, and by which it is seen."""
    values: int = CAMERA_SIZE + 1
    """Numbers of the leading variables."""

    @property
    def in_python(self) -> bool:
        """Whether functions of a part run in Python, and may fail."""
        return self.landmark.in_python or self.sensor.in_python or self.motion.in_python

    @property
    def block_values(self) -> int:
        """Numbers of a block's value: those of an orientation at least."""
        return max(4, self.value_size)

    def is_that_of(self, other: Recipe) -> bool:
        """Whether it says the same as another one."""
        mine, theirs = vars(self), vars(other)
        plans: Any = self.plan, other.plan
        same = all(mine[name] == theirs[name] for name in mine if name != "plan")
        return same and all(np.array_equal(a, b, equal_nan=True) for a, b in zip(*plans, strict=True))


def stage_tables(variants: tuple[tuple[StageRows, ...], ...], sensor_size: int, gate: float | None) -> dict[str, Any]:
    """Fields of a plan that say what its stages use, where the right row is not measured on its own, and where it is.

    The gate is the probability with which a consistent landmark passes all stages.
    """
    most = max(map(len, variants)) + 1
    T, T_uvd = np.zeros((2, most, MOST_ROWS, MOST_ROWS)), np.zeros((2, most, MOST_ROWS, 3))
    rows, scales, limits = np.full((2, most, 3), -1), np.ones((2, most)), np.full((2, most), np.inf)
    identity_rows = StageRows(tuple(map(tuple, np.eye(3, sensor_size).tolist())))
    for i, stages in enumerate(variants):
        for j, stage in (*enumerate(stages), (most - 1, identity_rows)):
            size = len(stage.T)
            T[i, j, :size, : len(stage.T[0])], T_uvd[i, j, :size] = stage.T, stage.of_uvd()
            rows[i, j] = size, stage.right_row, stage.apart_row
            scales[i, j] = stage.apart_scale
            if gate is not None:
                limits[i, j] = gate_limit(gate ** (1 / max(1, len(stages))), size)
    counts = np.array([len(stages) for stages in variants])
    return {"stages": counts, "T": T, "T_uvd": T_uvd, "rows": rows, "apart_scale": scales, "limits": limits}
