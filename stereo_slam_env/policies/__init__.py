"""Policies decide where to look: rules, planning on the belief of a filter, a trained network."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
