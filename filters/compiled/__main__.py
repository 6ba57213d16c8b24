"""Compilation of the kernels ahead of their first use: `python -m filters.compiled`.

It takes about half a minute, once on a machine: Numba keeps the result on disk, beside the modules where it can write
there, else in the cache of the user.
"""

from __future__ import annotations

import filters.compiled.stereo_ekf  # noqa: F401  (the kernels are compiled when they are imported)
