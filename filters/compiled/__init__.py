"""The engine in machine code (Numba), for one filter or for many at once: the estimates of `filters.engine`."""
