"""Watching a filter drive: Rerun, stills and films, the search in images."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
