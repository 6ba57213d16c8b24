"""Whole tasks with an id: an environment, a filter in the loop, and a reward; levels of difficulty, a curriculum."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
