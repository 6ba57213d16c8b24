"""Bearing measurements: the pixel of each camera, with u_right = u - d.

The noise is derived from the R of (u, v, d): left T_l R T_l^T, right T_r R T_r^T. Where the right row is not
measured on its own it is the left one, and carries no information: it is not counted twice, unless a
`copied_row_variance` asks for it, as a filter does that takes v_right = v for a measurement (the paper's rival).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.interface import StereoObservation
from filters.measurements.model import Stage
from filters.validation import FloatArray, positive

LEFT = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
RIGHT = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def left_stage(observation: StereoObservation, R: FloatArray) -> Stage:
    """(u, v) of the left eye."""
    return Stage(observation.uvd[:, :2], LEFT, LEFT @ R @ LEFT.T)


def right_stage(observation: StereoObservation, R: FloatArray, copied_row_variance: float | None = None) -> Stage:
    """(u_right, v_right) of the right eye; u_right alone where v_right is not measured and not to be copied."""
    copied = observation.v_right is None
    T = RIGHT[:1] if copied and copied_row_variance is None else RIGHT
    z = observation.uvd @ T.T
    if observation.v_right is not None:
        z[:, 1] = observation.v_right
    noise = T @ R @ T.T
    if copied and copied_row_variance is not None:
        noise[:, 1, 1] *= copied_row_variance
        noise[:, 0, 1] = noise[:, 1, 0] = 0.0
    return Stage(z, T, noise)


def stacked_stage(observation: StereoObservation, R: FloatArray, copied_row_variance: float | None = None) -> Stage:
    """Both eyes in one measurement (u, v, u_right[, v_right]), with the correlation of u and u_right that R implies.

    The error of v_right is taken as independent of the other three.
    """
    right = right_stage(observation, R, copied_row_variance)
    T = np.vstack([LEFT, right.T])
    joint = T @ R @ T.T
    if len(right.T) == 2:
        joint[:, 3, :3] = joint[:, :3, 3] = 0.0
        joint[:, 3, 3] = right.R[:, 1, 1]
    return Stage(np.hstack([observation.uvd[:, :2], right.z]), T, joint)


@dataclass(frozen=True)
class _BothEyes:
    """Measurement models that use the right eye's row.

    Parameters
    ----------
    copied_row_variance : float or None
        Where v_right is not measured on its own, take the left v for it with this many times its variance: 1 counts
        one measurement twice, infinity not at all. None: leave the row out.
    """

    copied_row_variance: float | None = None

    def __post_init__(self) -> None:
        if self.copied_row_variance is not None:
            positive("copied_row_variance", self.copied_row_variance)


@dataclass(frozen=True)
class LeftThenRight(_BothEyes):
    """Two updates in sequence, left then right, the second linearised at the result of the first."""

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """Two."""
        return (left_stage(observation, R), right_stage(observation, R, self.copied_row_variance))


@dataclass(frozen=True)
class Stacked(_BothEyes):
    """One update with both eyes' pixels."""

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """One."""
        return (stacked_stage(observation, R, self.copied_row_variance),)


@dataclass(frozen=True)
class LeftOnly:
    """Monocular updates: the left pixel. The disparity serves for initialisation only."""

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """One."""
        return (left_stage(observation, R),)
