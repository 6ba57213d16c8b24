"""Public names of this room; each is imported when it is first used."""

from .belief_observation import Belief as Belief
from .belief_observation import BeliefObservation as BeliefObservation
from .belief_panorama import BeliefPanorama as BeliefPanorama
from .information import InformationCriterion as InformationCriterion
from .information import log_det as log_det
from .information_gain import InformationGain as InformationGain
from .observation_shapes import FlattenUVD as FlattenUVD
from .observation_shapes import SelectedKeys as SelectedKeys
from .observation_shapes import SequenceObservation as SequenceObservation
from .record_consistency import RecordConsistency as RecordConsistency
