"""Compilation of the kernels of filters made with `compiled=True` (Numba, extra `fast`), once on a machine.

::

    python -m filters.compilation

takes about half a minute, and Numba keeps the result on disk. Afterwards the first such filter of a process takes a
second or two to make, for the import of Numba and what it has kept; without this step the first one ever takes the
half minute. Nothing is ever compiled once a filter exists, and filters without `compiled=True` do not import Numba.
"""

from __future__ import annotations

from filters.engine.arithmetic import arithmetic


def compile_kernels() -> None:
    """Compile what is not yet in the cache on disk.

    Raises
    ------
    ValueError
        Numba is not installed.
    """
    arithmetic(compiled=True)


if __name__ == "__main__":
    compile_kernels()
