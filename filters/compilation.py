"""Optional machine code for the hot loops: Numba, extra `fast`.

Filters made with `compiled=True` run it, and compute the same numbers (to 1e-10). Numba compiles once on a machine and
keeps the result on disk; it takes half a minute, best spent beforehand::

    python -m filters.compilation

Afterwards the first such filter of a process takes about two seconds to make, for the import of Numba and its cache.
Nothing is ever compiled once a filter exists, and filters without `compiled=True` do not even import Numba.
"""

from __future__ import annotations

from importlib.util import find_spec

from filters.engine.arithmetic import NUMPY, Arithmetic


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
        raise ValueError("compiled must be False without Numba: pip install 'stereo-slam-env[fast]'")
    from filters.engine.compiled import COMPILED

    return COMPILED


def compile_kernels() -> None:
    """Compile what is not yet in the cache on disk."""
    arithmetic(compiled=True)


if __name__ == "__main__":
    compile_kernels()
