"""Public names of this room; each is imported when it is first used."""

from .camera_motion import needed_motion as needed_motion
from .camera_motion import set_up_for_tracks as set_up_for_tracks
from .camera_motion import with_moving_start as with_moving_start
from .front_ends import FrontEnd as FrontEnd
from .front_ends import available_front_ends as available_front_ends
from .front_ends import check_front_end as check_front_end
from .front_ends import make_front_end as make_front_end
from .settings import TrackerSettings as TrackerSettings
from .track_noise import with_measured_noise as with_measured_noise
from .track_recorder import TYPICAL_NOISE as TYPICAL_NOISE
from .track_recorder import ActiveSearch as ActiveSearch
from .track_recorder import record_tracks as record_tracks
from .tracker import StereoTracker as StereoTracker
from .tracks import TrackedPair as TrackedPair
