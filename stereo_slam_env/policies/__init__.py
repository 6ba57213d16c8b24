"""Policies decide where to look: rules, planning on the belief of a filter, a trained network."""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
