"""Gymnasium wrappers: a filter in the loop, information as reward, and shapes of the observation for learners."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
