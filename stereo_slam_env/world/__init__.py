"""The simulated world: what is in the scene, where the camera drives, and the physics engine behind it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
