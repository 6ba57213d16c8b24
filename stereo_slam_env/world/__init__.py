"""The simulated world: what is in the scene, where the camera drives, and the physics engine behind it."""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
