"""Interface of measurement models: how the measurements of a frame enter the update.

Every model here is linear in the stereo triple (u, v, d): z = T (u, v, d). So Eq. 7-10 and its Jacobian are
written once, and the models differ in T, in the noise, and in the order of the updates.

Derivation: docs/derivations/measurements.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from filters.interface import StereoObservation
from filters.validation import FloatArray


@dataclass(frozen=True, eq=False)
class Stage:
    """One update of the frame: all landmarks, k rows each.

    Attributes
    ----------
    z : (M, k)
        Measurements, px.
    T : (k, 3)
        z = T (u, v, d).
    R : (M, k, k)
        Covariance of z, px^2.
    """

    z: FloatArray
    T: FloatArray
    R: FloatArray


@runtime_checkable
class MeasurementModel(Protocol):
    """Turns the measurements of a frame into the stages of its update.

    References
    ----------
    Chen, Lin and Shih, "Using range and bearing observation in stereo-based EKF SLAM", Eq. 7 to 10, section 4.
    """

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """Updates to be made one after the other, each linearised at the state the previous one left.

        Parameters
        ----------
        observation : StereoObservation
            M measurements.
        R : (M, 3, 3)
            Covariance of (u, v, d), px^2.
        """
