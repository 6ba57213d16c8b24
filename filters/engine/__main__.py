"""Compilation of the kernels ahead of their first use: `python -m filters.engine`.

It takes about half a minute, once on a machine: Numba keeps the result on disk, beside the modules where it can write
there, else in the cache of the user. Run it after a change of a kernel: Numba sees that a file has changed, not that
one has that it imports.
"""

from __future__ import annotations

from pathlib import Path

for kept in Path(__file__).with_name("compiled").joinpath("__pycache__").glob("*.nb[ic]"):
    kept.unlink(missing_ok=True)

import filters.engine.row  # noqa: E402, F401  (the kernels are compiled when they are imported)
