"""Training of a network that turns the head: the task, PPO, evaluation, data sets. Needs the extra rl."""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
