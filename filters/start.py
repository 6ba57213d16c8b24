"""What a filter believes at `reset`: the checked start state and its covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from filters.motion import CAMERA_SIZE, CameraState
from filters.validation import FloatArray, covariance_matrix, finite_array, unit_quaternion

# Standard deviations when the caller gives no covariance: a known pose (m, rad), a broad velocity (m/s, rad/s).
KNOWN_POSE = 1e-6
BROAD_LINEAR_VELOCITY = 10.0
BROAD_ANGULAR_VELOCITY = 0.5


def start_belief(
    position: ArrayLike = (0.0, 0.0, 0.0),
    orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
    linear_velocity: ArrayLike = (0.0, 0.0, 0.0),
    angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
    covariance: ArrayLike | None = None,
) -> tuple[CameraState, FloatArray]:
    """The arguments of `StereoFilter.reset` as a camera state and its covariance (12, 12).

    Raises
    ------
    ValueError
        An argument is not what `reset` asks for; the message names it.
    """
    camera = CameraState(
        finite_array("position", position, (3,)),
        unit_quaternion("orientation", orientation),
        finite_array("linear_velocity", linear_velocity, (3,)),
        finite_array("angular_velocity", angular_velocity, (3,)),
    )
    if covariance is not None:
        return camera, covariance_matrix("covariance", covariance, CAMERA_SIZE)
    sigmas = np.repeat([KNOWN_POSE, KNOWN_POSE, BROAD_LINEAR_VELOCITY, BROAD_ANGULAR_VELOCITY], 3)
    return camera, np.diag(sigmas**2)
