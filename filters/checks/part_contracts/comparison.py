"""Comparison of arrays, and of the compiled functions of a part with its NumPy form."""

from __future__ import annotations

import numpy as np

from filters.checks.conformance import require
from filters.contract.variables import Variable
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.motions.motion_model import CameraState

TOLERANCE = 1e-6
"""Largest error of a Jacobian, as a share of the largest entry of its row; that of differences is about 1e-9."""

SCALES = np.tile([0.3, 0.1, 0.02, 0.0, -1e-9, -0.05], 2)
"""Inverse distances of landmarks and points: near, far, at infinity and beyond."""

TURN, SHIFT = rotations.exp(np.array([0.4, -0.7, 0.2])), np.array([3.0, -1.0, 2.0])
"""A motion of the world."""


def assert_close(what: str, got: FloatArray, wanted: FloatArray, tolerance: float = TOLERANCE) -> None:
    """Raise an `AssertionError` where they differ by more than a share of the largest entry of the row."""
    got, wanted = np.asarray(got), np.asarray(wanted)
    require(got.shape == wanted.shape, f"{what} has shape {got.shape}, not {wanted.shape}")
    size = np.abs(wanted).max(axis=-1, keepdims=True, initial=0.0)
    off = np.max(np.abs(got - wanted) / np.maximum(size, 1e-3 * size.max(initial=0.0) + 1e-9), initial=0.0)
    require(off < tolerance, f"{what} is off by {off:.2g} of its size")


def assert_refusal(error: ValueError, word: str) -> None:
    """Raise an `AssertionError` where a refusal is not one line, or does not have the word."""
    require(word in str(error), f"a wrong {word} is refused without its name: {error}")
    require("\n" not in str(error), f"a wrong {word} is refused in more than one line: {error}")


def unit_directions(homogeneous: FloatArray) -> FloatArray:
    """Homogeneous points with a unit direction; (M, 4)."""
    unit: FloatArray = homogeneous / np.linalg.norm(homogeneous[:, :3], axis=1, keepdims=True)
    return unit


def moved_world(camera: CameraState, shift: FloatArray = SHIFT, variables: tuple[Variable, ...] = ()) -> CameraState:
    """The same camera and variables in a world that is turned and shifted."""
    return CameraState(
        TURN @ camera.position + shift,
        rotations.from_matrix(TURN @ camera.R_wc),
        TURN @ camera.linear_velocity,
        camera.angular_velocity,
        {**camera.variables, **{x.name: x.turned(camera.variables[x.name], TURN) for x in variables}},
    )
