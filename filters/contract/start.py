"""Start state of a filter and its covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.contract.validation import covariance_matrix, finite_array, unit_quaternion
from filters.geometry.arrays import FloatArray

# Standard deviations where no covariance is given: a known pose (m, rad), a broad velocity (m/s, rad/s).
KNOWN_POSE = 1e-6
BROAD_LINEAR_VELOCITY = 10.0
BROAD_ANGULAR_VELOCITY = 0.5


@dataclass(frozen=True, eq=False)
class Start:
    """State that a filter is told at `reset`, and how well it is known.

    Parameters
    ----------
    position : (3,) array_like
        r^WC, m.
    orientation : (4,) array_like
        q^WC, unit quaternion xyzw.
    linear_velocity : (3,) array_like
        m/s, in W.
    angular_velocity : (3,) array_like
        rad/s, camera frame.
    covariance : (12, 12) array_like, optional
        Of position (W), rotation (camera frame, rad), linear velocity (W), angular velocity (camera).
        None: a known pose (standard deviation 1e-6) and a broad velocity, see `assumed_covariance`.

    Raises
    ------
    ValueError
        Wrong shapes, NaN or infinity, a quaternion that is not a unit one, a covariance that is not symmetric positive
        semi-definite: the message names the argument.
    """

    position: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]  # an array after __post_init__
    orientation: FloatArray = (0.0, 0.0, 0.0, 1.0)  # type: ignore[assignment]
    linear_velocity: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    angular_velocity: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("position", "linear_velocity", "angular_velocity"):
            object.__setattr__(self, name, finite_array(name, getattr(self, name), (3,)))
        orientation = unit_quaternion("orientation", self.orientation)
        orientation.flags.writeable = False
        object.__setattr__(self, "orientation", orientation)
        if self.covariance is not None:
            object.__setattr__(self, "covariance", covariance_matrix("covariance", self.covariance, 12))

    @property
    def assumed_covariance(self) -> FloatArray:
        """`covariance`, or the one assumed where none is given; (12, 12), read-only."""
        return _UNKNOWN_VELOCITY if self.covariance is None else self.covariance


_UNKNOWN_VELOCITY = np.diag(np.repeat([KNOWN_POSE, KNOWN_POSE, BROAD_LINEAR_VELOCITY, BROAD_ANGULAR_VELOCITY], 3) ** 2)
_UNKNOWN_VELOCITY.flags.writeable = False
