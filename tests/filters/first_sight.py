"""Landmarks as the filter starts them, seen from one pose by a rectified pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from filters import Start, StereoCamera, StereoEKF, StereoNoise, StereoObservation
from filters.geometry import symmetric
from filters.geometry.arrays import FloatArray
from filters.landmarks.landmark_model import LandmarkModel


@dataclass(frozen=True)
class FirstSight:
    """M landmarks as they start."""

    parameters: FloatArray
    """(M, v)."""
    by_leading: FloatArray
    """(M, size, 12): Jacobian by the errors of pose and velocity."""
    noise: FloatArray
    """(M, size, size): what the measurement adds."""


def first_sight(
    model: LandmarkModel,
    camera: StereoCamera,
    position: FloatArray,
    R_wc: FloatArray,
    uvd: FloatArray,
    R: FloatArray | None = None,
) -> FirstSight:
    """Landmarks at the measurements (M, 3), with the noise that R (3, 3) of a measurement adds; unit noise for None."""
    slam = StereoEKF(camera, StereoNoise(np.eye(3) if R is None else R), landmark=model, error="so3")
    start = Start(position, Rotation.from_matrix(R_wc).as_quat())
    seen, P0, blocks = StereoObservation(np.arange(len(uvd)), uvd), 1e-2, []
    for covariance in (P0, 0.0):
        slam.reset(Start(start.position, start.orientation, covariance=covariance * np.eye(12)))
        slam.update(seen)
        state = slam.state
        P, rows = symmetric.full(state.P), state.own_rows()
        blocks.append((P[rows][:, :, :12], P[rows[:, :, None], rows[:, None, :]]))
    (cross, _), (_, noise) = blocks
    return FirstSight(state.parameters(), cross / P0, noise)
