"""Whole tasks with an id: an environment, a filter in the loop, and a reward; levels of difficulty."""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
