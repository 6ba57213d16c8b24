"""Public names of this room; each is imported when it is first used."""

from .camera_info import calibration_of_infos as calibration_of_infos
from .corrupted_measurements import BiasedDisparity as BiasedDisparity
from .corrupted_measurements import MisscaledNoise as MisscaledNoise
from .corrupted_measurements import MissedDetections as MissedDetections
from .corrupted_measurements import MovingLandmarks as MovingLandmarks
from .corrupted_measurements import OfMeasurements as OfMeasurements
from .corrupted_measurements import Outliers as Outliers
from .corrupted_measurements import WrongCalibration as WrongCalibration
from .corrupted_measurements import WrongIds as WrongIds
from .corrupted_measurements import known_world as known_world
from .corrupted_measurements import moved_on as moved_on
from .corruptions import Blackouts as Blackouts
from .corruptions import Corruption as Corruption
from .corruptions import DroppedFrames as DroppedFrames
from .corruptions import DuplicatedFrames as DuplicatedFrames
from .corruptions import Latency as Latency
from .corruptions import corrupted as corrupted
from .padding import stereo_observation as stereo_observation
from .rigs import RIGS as RIGS
from .rigs import camera_of as camera_of
