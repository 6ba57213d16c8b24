"""Choice between NumPy and machine code for a filter."""

from __future__ import annotations

import logging
from functools import lru_cache
from typing import TYPE_CHECKING

from filters.engine.options import Options
from filters.geometry.camera import StereoCamera
from filters.parts import SLOTS, kernel_of

if TYPE_CHECKING:
    from filters.engine.compiled.stereo_ekf import CompiledFilter

_log = logging.getLogger(__name__)


def without_kernel(options: Options) -> str | None:
    """What of a filter has no compiled counterpart, in words; None: it has one for everything."""
    for slot in SLOTS:
        part = getattr(options, slot)
        if kernel_of(part) is None:
            return f"{slot}={type(part).__name__}"
    if options.drift is not None and kernel_of(options.measurement) not in ("joint", "calibrated-pair"):
        return f"drift with measurement={type(options.measurement).__name__}"
    return None if options.max_landmarks is None else f"max_landmarks={options.max_landmarks}"


def compiled_filter(camera: StereoCamera, options: Options) -> CompiledFilter | None:
    """The filter in machine code, if that is asked for and can be had; None: by NumPy.

    Raises
    ------
    ValueError
        `compiled=True`, and a part has no kernel or Numba does not work here.
    """
    if options.compiled is False:
        return None
    missing = without_kernel(options)
    broken = None if missing else trouble()
    if missing is None and broken is None:
        from filters.engine.compiled.stereo_ekf import CompiledFilter

        return CompiledFilter.of(camera, options)
    if options.compiled:
        why = f"{missing} has no compiled form" if missing else f"Numba does not work here ({broken})"
        raise ValueError(f"compiled must be False or None where {why}")
    return None


@lru_cache
def trouble() -> str | None:
    """Why the kernels cannot be had on this machine, told once in the log; None: they can."""
    try:
        import filters.engine.compiled.stereo_ekf  # noqa: F401
    except Exception as error:  # Numba and LLVM fail in many ways where they do not fit the machine
        _log.warning("filters run by NumPy, slower: Numba does not work here (%s: %s)", type(error).__name__, error)
        return f"{type(error).__name__}: {error}"
    return None
