"""Landmarks as the filter starts them, seen from one pose by a rectified pair."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from filters import RangeBearing, Start, StereoCamera, StereoObservation
from filters.engine.new_landmarks import start_landmarks
from filters.geometry.arrays import FloatArray
from filters.landmarks.landmark_model import LandmarkModel
from filters.state.joint_state import JointState, NewLandmarks
from filters.state.layout import StateLayout


def first_sight(
    model: LandmarkModel,
    camera: StereoCamera,
    position: FloatArray,
    R_wc: FloatArray,
    uvd: FloatArray,
    R: FloatArray | None = None,
) -> NewLandmarks:
    """Landmarks at the measurements (M, 3), with the noise that R (3, 3) of a measurement adds; unit noise for None."""
    start = Start(position, Rotation.from_matrix(R_wc).as_quat())
    noise = np.broadcast_to(np.eye(3) if R is None else R, (len(uvd), 3, 3))
    observation = StereoObservation(np.arange(len(uvd)), uvd)
    return start_landmarks(RangeBearing(), camera, JointState.at(start, StateLayout(), model), observation, noise)
