"""Robust re-weighting of measurements by Student's t distribution (iteratively re-weighted least squares).

If the noise is Student's t with a few degrees of freedom instead of Gaussian, the expected precision of a
measurement given its innovation is w R^-1 with w = (dof + k) / (dof + d^2), d the Mahalanobis distance. Weights above
one are not given: a measurement never counts more than its R says.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from filters.engine.kalman import squared_distances
from filters.state.linearised import LinearisedMeasurements
from filters.validation import FloatArray


def reweighted(
    P: FloatArray, measurements: LinearisedMeasurements, degrees_of_freedom: float
) -> LinearisedMeasurements:
    """The measurements with R divided by their weights.

    Parameters
    ----------
    P : (n, n)
        Covariance, lower triangle.
    measurements : LinearisedMeasurements
        M measurements of k rows.
    degrees_of_freedom : float
        Of Student's t; small means heavy tails, infinity is Gaussian.
    """
    if len(measurements) == 0:
        return measurements
    distances = squared_distances(P, measurements)
    weights = (degrees_of_freedom + measurements.innovation.shape[1]) / (degrees_of_freedom + distances)
    return replace(measurements, R=measurements.R / np.minimum(weights, 1.0)[:, None, None])
