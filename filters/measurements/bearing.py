"""Bearing only: each eye as a pixel observer, u_right = u - d.

The noise is derived from the R of (u, v, d): left T_l R T_l^T, right T_r R T_r^T. Where the right row is not
measured on its own it is the left one, and carries no information: it is not counted twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.interface import StereoObservation
from filters.measurements.model import Stage
from filters.validation import FloatArray

LEFT = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
RIGHT = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def left_stage(observation: StereoObservation, R: FloatArray) -> Stage:
    """(u, v) of the left eye."""
    return Stage(observation.uvd[:, :2], LEFT, LEFT @ R @ LEFT.T)


def right_stage(observation: StereoObservation, R: FloatArray) -> Stage:
    """(u_right, v_right) of the right eye; u_right alone where v_right is not measured."""
    T = RIGHT if observation.v_right is not None else RIGHT[:1]
    z = observation.uvd @ T.T
    if observation.v_right is not None:
        z[:, 1] = observation.v_right
    return Stage(z, T, T @ R @ T.T)


def stacked_stage(observation: StereoObservation, R: FloatArray) -> Stage:
    """Both eyes in one measurement (u, v, u_right[, v_right]), with the correlation of u and u_right that R implies.

    The error of a measured v_right is taken as independent of the other three.
    """
    right = right_stage(observation, R)
    T = np.vstack([LEFT, right.T])
    joint = T @ R @ T.T
    if observation.v_right is not None:
        joint[:, 3, :3] = joint[:, :3, 3] = 0.0
    return Stage(np.hstack([observation.uvd[:, :2], right.z]), T, joint)


@dataclass(frozen=True)
class LeftThenRight:
    """Two updates in sequence, left then right, the second linearised at the result of the first."""

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """Two."""
        return (left_stage(observation, R), right_stage(observation, R))


@dataclass(frozen=True)
class Stacked:
    """One update with both eyes' pixels."""

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """One."""
        return (stacked_stage(observation, R),)


@dataclass(frozen=True)
class LeftOnly:
    """Monocular updates: the left pixel. The disparity serves for initialisation only."""

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """One."""
        return (left_stage(observation, R),)
