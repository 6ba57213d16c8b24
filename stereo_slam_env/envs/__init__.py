"""The Gymnasium environments."""

from filters.extras import require_core

require_core("cv2", "pybullet")
