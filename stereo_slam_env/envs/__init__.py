"""The Gymnasium environments."""

from filters.contract.extras import require_core

require_core("cv2", "pybullet")
