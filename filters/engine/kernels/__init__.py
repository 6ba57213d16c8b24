"""Kernels of the EKF for Numba: loops over landmarks and rows of P without copies.

One module for each of the engine's that it stands for. Each function says the same as the NumPy code named in its
docstring and is tested against it. All that are called from outside have fixed signatures, so that they are compiled
when their module is imported, or read from Numba's cache on disk, and never later. `filters.compilation` imports them,
nobody else does.

Landmarks and camera occupy blocks of three rows, and only the lower triangle of P (column-major) is read. Loops are
written out because Numba compiles them in a fraction of the time it takes for assignments of slices.
"""
