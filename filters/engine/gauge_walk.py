"""Gauge walk: camera and map together make a random walk in the six directions that vision cannot see.

It stands for errors that all tracks of a frame have in common: they show in no innovation, and turn and shift the whole
estimate. They grow with the motion of the image, as the errors of the single tracks do. A measurement says nothing
about these directions, so the walk costs it nothing, provided that the Jacobians know them: those of first-estimates
and right-invariant errors do, other ones take a large variance there for information.
"""

from __future__ import annotations

import numpy as np

from filters.geometry import rotations
from filters.validation import FloatArray

TURN_WEIGHT = 5.0
"""Of the flow that a turn makes. It moves all points in the same direction, and so do the errors that it brings; ahead,
points move away from each other and their errors cancel in part. Measured: docs/covariances.md."""
FARTHEST = 1000.0
"""Mean distance of landmarks, m, beyond which the walk of the position grows no further."""


def image_motion(turn: float, step: FloatArray, seen: FloatArray) -> tuple[float, float]:
    """How far the landmarks move on the sphere of bearings while the camera moves, weighted, and their distance.

    Parameters
    ----------
    turn : float
        Angle by which the camera turns, rad.
    step : (3,)
        By which it moves, m.
    seen : (M, 4)
        Homogeneous points of the landmarks from the camera: direction, in the axes of `step`, and scale.

    Returns
    -------
    motion : float
        `TURN_WEIGHT` turn + mean |step x p| / |p|^2, rad; zero without landmarks.
    distance : float
        1 / mean (1 / |p|), at most `FARTHEST`, m.
    """
    if len(seen) == 0:
        return 0.0, FARTHEST
    direction, squared = seen[:, :3], np.einsum("mi,mi->m", seen[:, :3], seen[:, :3])
    scale = np.maximum(seen[:, 3], 0.0)
    by_step = scale * np.linalg.norm(np.cross(step, direction), axis=1) / squared
    inverse = float(np.mean(scale / np.sqrt(squared)))
    return TURN_WEIGHT * turn + float(np.mean(by_step)), 1.0 / max(inverse, 1.0 / FARTHEST)


def directions(
    rotation: FloatArray, translation: FloatArray, position: FloatArray, sigma: float, distance: float
) -> FloatArray:
    """B with P += B B^T for a step.

    Parameters
    ----------
    rotation, translation : (n, 3)
        Effects of a rotation of the world about its origin and of a shift of the world on the error state.
    position : (3,)
        Of the camera, W.
    sigma : float
        Of the rotation about the camera, rad.
    distance : float
        Of the landmarks, m: the shift of sigma times this moves them in the image as far as the rotation does.

    Returns
    -------
    (n, 6)
        Rotation about the camera, then translation.
    """
    about_camera = rotation + translation @ rotations.skew(position)
    return np.hstack([sigma * about_camera, sigma * distance * translation])
