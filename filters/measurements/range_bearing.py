"""The paper's measurement: bearing and range together, z = (u, v, d) of Eq. 7."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.interface import StereoObservation
from filters.measurements.model import Stage
from filters.validation import FloatArray

_ALL = np.eye(3)


@dataclass(frozen=True)
class RangeBearing:
    """One joint update with (u, v, d). A separately measured right row is not used."""

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """One."""
        return (Stage(observation.uvd, _ALL, R),)
