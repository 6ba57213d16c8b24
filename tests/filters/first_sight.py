"""Landmarks as the filter starts them, seen from one pose by a rectified pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

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
    noise: FloatArray
    """(M, size, size): what the measurement adds."""


def first_sight(
    model: LandmarkModel, camera: StereoCamera, position: FloatArray, R_wc: FloatArray, uvd: FloatArray, R: Any = None
) -> FirstSight:
    """Landmarks at the measurements (M, 3), with the noise that R (3, 3) of a measurement adds; unit noise for None."""
    slam = StereoEKF(camera, StereoNoise(np.eye(3) if R is None else R), landmark=model, error="so3")
    slam.reset(Start(position, Rotation.from_matrix(R_wc).as_quat(), covariance=np.zeros((12, 12))))
    slam.update(StereoObservation(np.arange(len(uvd)), uvd))
    P, rows = symmetric.full(slam.state.P), slam.state.own_rows()
    return FirstSight(slam.state.parameters(), P[rows[:, :, None], rows[:, None, :]])
