"""Public names of this room; each is imported when it is first used."""

from .recorder import TYPICAL_NOISE as TYPICAL_NOISE
from .recorder import ActiveSearch as ActiveSearch
from .recorder import record_tracks as record_tracks
from .settings import TrackerSettings as TrackerSettings
from .track_noise import with_measured_noise as with_measured_noise
from .tracker import StereoTracker as StereoTracker
