"""Many environments at once: scenes, cars, sensors and filters in arrays, stepped by compiled kernels."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
