"""Training of a network that turns the head: the task, PPO, evaluation, data sets. Needs the extra rl."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
