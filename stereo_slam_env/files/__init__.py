"""Files and folders: atomic writes, locked folders, readers that bound what they read."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
