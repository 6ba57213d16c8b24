"""Figures of merit of a run: errors, consistency, map, alarms and the Cramer-Rao bound."""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
