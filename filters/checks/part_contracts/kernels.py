"""The compiled functions of a part say what its NumPy form says, and can be compiled."""

from __future__ import annotations

from typing import Any

import numpy as np

from filters.checks.part_contracts.comparison import assert_close
from filters.geometry.arrays import FloatArray
from filters.geometry.machine_code import settings_of
from filters.parts import kernels_of


class Kernels:
    """Kernels of a part, called as Python functions on arrays that are zero, as the engine does.

    Parameters
    ----------
    part : LandmarkModel, MeasurementModel or MotionModel
        A part with kernels.
    """

    def __init__(self, part: Any) -> None:
        self._kernels = kernels_of(part)
        self._settings = settings_of(part, self._kernels)

    def of(self, name: str, *given: Any, **results: Any) -> list[Any]:
        """What a kernel writes into arrays of these shapes (tuples), or into these; it must compile, too."""
        from filters.engine.compiled.units import of_part

        written = [np.zeros(r) if isinstance(r, tuple) else r for r in results.values()]
        arrays = [np.ascontiguousarray(x) if isinstance(x, np.ndarray) else x for x in given]
        with np.errstate(all="ignore"):
            getattr(self._kernels, name)(self._settings, *arrays, *written)
        try:
            of_part(self._kernels, name)
        except ValueError as error:
            raise AssertionError(str(error)) from None
        return written


def assert_same(kernel: str, **pairs: tuple[FloatArray, FloatArray]) -> None:
    """Raise an `AssertionError` where what a kernel has written is not what NumPy says."""
    for what, (written, wanted) in pairs.items():
        assert_close(f"{what} of kernel {kernel}", written, wanted)
