"""Console tables and HTML pages of runs, studies and comparisons."""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
