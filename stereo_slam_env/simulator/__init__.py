"""The world in motion: B vehicles with stereo cameras as rows of arrays, stepped by compiled kernels."""

from filters.contract.extras import public_names, require_core

require_core("numba")
__getattr__, __dir__, __all__ = public_names(__name__, __file__)
