"""Training a network to look where it learns most: the task, PPO, and what it leaves behind. Needs the extra rl."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
