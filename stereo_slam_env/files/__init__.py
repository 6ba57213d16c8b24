"""Files and folders: atomic writes, locked folders, readers that bound what they read."""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
