"""The Gymnasium environments, wrappers with a filter in the loop, and tasks with a reward, on one row or many."""

from filters.contract.extras import public_names, require_core

require_core("cv2")

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
