"""Joint compatibility test of a frame: one-point RANSAC with all hypotheses at once.

A single landmark is enough to fix the camera, because the filter's prior knows the rest. So each believable
measurement proposes a correction, and the proposal that explains most of the others, up to their measurement noise,
wins. A measurement that agrees with the prediction only because the prediction is vague does not pass this test.

Source: Civera, Grasa, Davison and Montiel, "1-point RANSAC for extended Kalman filtering", J. Field Robotics 27(5),
2010.
"""

from __future__ import annotations

import numpy as np

from filters.engine import kalman
from filters.engine.gating import squared_distances
from filters.state.linearised import LinearisedMeasurements
from filters.validation import BoolArray, FloatArray


def largest_agreement(
    P: FloatArray, measurements: LinearisedMeasurements, noise: FloatArray, limit: float
) -> BoolArray:
    """Which measurements agree with the best one-landmark hypothesis.

    Parameters
    ----------
    P : (n, n)
        Covariance, lower triangle.
    measurements : LinearisedMeasurements
        M measurements of k rows.
    noise : (M, k, k)
        Covariance of what is left of a measurement that agrees: its own noise, and a step of its landmark.
    limit : float
        Squared Mahalanobis distance, by `noise` alone, up to which a residual counts as agreement.

    Returns
    -------
    (M,) bool
        The hypothesis with most support; of equals, the one with the smallest residuals; of these, the first.
    """
    count, size = measurements.innovation.shape
    if count < 2:
        return np.ones(count, dtype=bool)
    cross = kalman.joint_innovation_covariance(P, measurements)
    own = cross[np.arange(count), :, np.arange(count), :]
    proposals = np.linalg.solve(own, measurements.innovation[:, :, None])[:, :, 0]
    # What hypothesis i leaves of the innovation of j: nu_j - S_ji S_ii^-1 nu_i (without the noise of j in S_ji).
    residuals = measurements.innovation[:, None] - np.einsum("jaib,ib->jia", cross, proposals)
    noises = np.broadcast_to(noise[:, None], (count, count, size, size))
    distances = squared_distances(residuals.reshape(-1, size), noises.reshape(-1, size, size)).reshape(count, count)
    np.fill_diagonal(distances, 0.0)  # exactly, or rounding would decide between hypotheses without followers
    agrees = distances <= limit
    support = agrees.sum(axis=0)
    tightness = np.where(agrees, distances, 0.0).sum(axis=0)
    best = np.lexsort((tightness, -support))[0]
    winner: BoolArray = agrees[:, best]
    return winner
