"""Public names of this room; each is imported when it is first used."""

from .corruptions import corrupted as corrupted
from .padding import stereo_observation as stereo_observation
from .rigs import RIGS as RIGS
from .rigs import camera_of as camera_of
