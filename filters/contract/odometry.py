"""Odometry, as filters take it."""

from __future__ import annotations

from dataclasses import dataclass

from filters.contract.validation import at_most, covariance_matrix, finite_array
from filters.geometry.arrays import FloatArray

FASTEST, LARGEST_VARIANCE = 1e6, 1e12
"""Numbers up to which filters are tested: m/s or rad/s, and their squares."""


@dataclass(frozen=True, eq=False)
class BodyVelocity:
    """Odometry: the mean velocity of the left camera over the step that ends now.

    Parameters
    ----------
    linear : (3,) array_like
        m/s, camera frame.
    angular : (3,) array_like
        rad/s, camera frame.
    covariance : (6, 6) array_like
        Of (linear, angular).

    Raises
    ------
    ValueError
        Wrong shapes, NaN or infinity, a covariance that is not symmetric positive semi-definite; more than 1e6 m/s or
        rad/s, or a variance above 1e12.
    """

    linear: FloatArray
    angular: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "linear", finite_array("odometry.linear", self.linear, (3,)))
        object.__setattr__(self, "angular", finite_array("odometry.angular", self.angular, (3,)))
        covariance = covariance_matrix("odometry.covariance", self.covariance, 6)
        at_most("odometry.linear", self.linear, FASTEST, "m/s")
        at_most("odometry.angular", self.angular, FASTEST, "rad/s")
        at_most("odometry.covariance", covariance, LARGEST_VARIANCE, "m^2/s^2 or rad^2/s^2")
        object.__setattr__(self, "covariance", covariance)
