"""Figures of merit of a run: errors, consistency, map, alarms and the Cramer-Rao bound."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
