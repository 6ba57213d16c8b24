"""Public names of this room; each is imported when it is first used."""

from .belief_observation import BeliefObservation as BeliefObservation
from .belief_panorama import BeliefPanorama as BeliefPanorama
from .flatten_uvd import FlattenUVD as FlattenUVD
from .information import InformationCriterion as InformationCriterion
from .information import log_det as log_det
from .information_gain import InformationGain as InformationGain
from .record_consistency import RecordConsistency as RecordConsistency
from .sequence_observation import SequenceObservation as SequenceObservation
