"""Vision front end: (u, v, d) with ids from stereo images."""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
