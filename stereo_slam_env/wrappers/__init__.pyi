"""Public names of this room; each is imported when it is first used."""

from .belief_observation import BeliefObservation as BeliefObservation
from .belief_panorama import BeliefPanorama as BeliefPanorama
from .direction_of_gaze import DirectionOfGaze as DirectionOfGaze
from .filter_rows import Belief as Belief
from .information import InformationCriterion as InformationCriterion
from .information import log_det as log_det
from .rewards import InformationGain as InformationGain
from .rewards import TrueError as TrueError
from .selected_keys import SelectedKeys as SelectedKeys
from .snapshots import Snapshot as Snapshot
from .snapshots import restore as restore
from .snapshots import snapshot as snapshot
