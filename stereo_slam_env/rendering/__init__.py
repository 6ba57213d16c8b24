"""Rendering: stereo images of a scene from a pose."""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
