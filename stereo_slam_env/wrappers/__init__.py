"""Gymnasium wrappers: a filter in the loop, information as reward, and shapes of the observation for learners."""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
