"""What the kernels have to know of a filter: its parts as plain numbers."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from filters.camera import StereoCamera
from filters.compiled import prediction, retraction
from filters.compiled.frame import EUCLIDEAN, INVERSE_DEPTH, SHARED_ANCHOR
from filters.compiled.geometry import CALIBRATIONS
from filters.engine.gating import gate_limit
from filters.engine.options import Options
from filters.measurements.rectified_pair import LEFT, RIGHT
from filters.parts import kernel_of
from filters.validation import FloatArray, IntArray
from filters.variables import VELOCITY

_STAGES = {
    "joint": ((np.eye(3), -1),),
    "calibrated-pair": ((np.eye(3), -1),),
    "left": ((LEFT, -1),),
    "sequential": ((LEFT, -1), (RIGHT, 1)),
    "stacked": ((np.vstack([LEFT, RIGHT]), 3),),
}
"""Rows of each stage, and which of them is v_right."""
_ERRORS = {
    "quaternion": retraction.QUATERNION,
    "so3": retraction.SO3,
    "first-estimates": retraction.FIRST_ESTIMATES,
    "right-invariant": retraction.INVARIANT,
    "left-invariant": retraction.INVARIANT,
}
_MOTIONS = {"constant-velocity": prediction.CONSTANT_VELOCITY, "velocity-driven": prediction.VELOCITY_DRIVEN}


@dataclass(frozen=True, eq=False)
class Recipe:
    """Arguments of the kernels that do not change while a filter runs; see `frame.update_range`."""

    choices: IntArray
    numbers: FloatArray
    columns: IntArray
    considered: IntArray
    walk_rates: FloatArray
    stages: FloatArray
    rows_of_stages: IntArray
    limits: FloatArray
    copied: FloatArray

    def __eq__(self, other: object) -> bool:
        """Whether both have the same numbers."""
        if not isinstance(other, Recipe):
            return NotImplemented
        names = [field.name for field in fields(self)]
        return all(np.array_equal(getattr(self, name), getattr(other, name), equal_nan=True) for name in names)

    __hash__ = None  # type: ignore[assignment]

    @classmethod
    def of(cls, camera: StereoCamera, options: Options) -> Recipe:
        """The recipe of a filter all of whose parts have a kernel."""
        layout, motion = options.layout, options.motion
        lead = 3 * -(-layout.size // 3)
        measured = 3 * -(-layout.measured // 3)
        stages = _STAGES[kernel_of(options.measurement) or ""]
        T = np.zeros((len(stages), 4, 3))
        for stage, (rows, _) in enumerate(stages):
            T[stage, : len(rows)] = rows
        limits = np.full((len(stages), 4), np.inf)
        if options.gate is not None:
            limits[:] = [gate_limit(options.gate ** (1 / len(stages)), rows) for rows in (1, 2, 3, 4)]
        copied = getattr(options.measurement, "copied_row_variance", None)
        error = _ERRORS[kernel_of(options.error) or ""]
        if not getattr(options.error, "reset", True):
            error = retraction.RIGHT_INVARIANT
        landmark = EUCLIDEAN
        if options.landmark.anchored:
            landmark = SHARED_ANCHOR if options.landmark.shares_anchors else INVERSE_DEPTH
        columns = np.full(CALIBRATIONS, -1)
        for variable in options.measurement.variables:
            first = layout.places[variable.name].start
            present = options.measurement.present  # type: ignore[attr-defined]
            columns[present] = first + np.arange(variable.size)
        walk_rates = np.zeros(lead)
        if layout.walk_rates is not None:
            walk_rates[: layout.size] = layout.walk_rates
        return cls(
            np.array(
                [
                    landmark,
                    error,
                    options.consensus,
                    options.iterations,
                    options.drop_unseen,
                    lead,
                    measured,
                    layout.places[VELOCITY].start,
                    len(stages),
                    _MOTIONS[kernel_of(motion) or ""],
                ],
                dtype=np.int64,
            ),
            np.array(
                [
                    camera.fx,
                    camera.fy,
                    camera.cx,
                    camera.cy,
                    camera.disparity_constant,
                    np.inf if options.tail_dof is None else options.tail_dof,
                    -np.inf if options.min_disparity is None else options.min_disparity,
                    getattr(motion, "sigma_acceleration", 0.0),
                    getattr(motion, "sigma_angular_acceleration", 0.0),
                ],
                dtype=np.float64,
            ),
            columns,
            layout.considered,
            walk_rates,
            T,
            np.array([(len(rows), right) for rows, right in stages], dtype=np.int64),
            limits,
            np.array([np.nan if copied is None else copied]),
        )
