"""Choice of the implementation of the EKF's steps: NumPy, or compiled kernels that compute the same numbers."""

from __future__ import annotations

from importlib.util import find_spec

from filters.engine import kalman, linearisation, symmetric
from filters.engine.steps import Arithmetic
from filters.extras import install_command

NUMPY = Arithmetic(linearisation.linearise, kalman.squared_distances, kalman.update, symmetric.transform_leading)


def arithmetic(compiled: bool) -> Arithmetic:
    """The steps of a frame, compiled or by NumPy.

    Raises
    ------
    ValueError
        `compiled` is not a boolean, or is True where Numba is not installed.
    """
    if not isinstance(compiled, bool):
        raise ValueError(f"compiled must be True or False, got {compiled!r}")
    if not compiled:
        return NUMPY
    if find_spec("numba") is None:
        raise ValueError(f"compiled must be False without Numba: {install_command('fast')}")
    from filters.engine.compiled import COMPILED

    return COMPILED
