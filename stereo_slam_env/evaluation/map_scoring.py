"""The filter's map seen from its current pose, and how wrong it is.

Everything is judged in the camera: depth, point and uncertainty follow from the forecast (u, v, d) and its covariance,
which holds the correlation of landmark and pose and means the same for every parametrisation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import rotations
from filters.camera import StereoCamera
from filters.interface import StereoFilter
from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.evaluation.consistency import nees
from stereo_slam_env.recording.recording import LandmarkTruth, Pose

SCORED_RANGE = 40.0  # m; farther landmarks have no useful position error, and not every filter maps them


@dataclass(frozen=True, eq=False)
class MapView:
    """The map in the current camera.

    Attributes
    ----------
    ids : (N,) int64
        Landmarks.
    uvd : (N, 3)
        Predicted measurement, px.
    covariance : (N, 3, 3)
        Of the prediction: H P H^T, without the measurement noise, px^2.
    true_points : (N, 3)
        True positions in the true camera frame, m; NaN where unknown.
    """

    ids: IntArray
    uvd: FloatArray
    covariance: FloatArray
    true_points: FloatArray


def view_map(estimator: StereoFilter, pose: Pose | None, landmarks: LandmarkTruth | None) -> MapView:
    """The map of `estimator` in its camera, next to the truth where it is known."""
    forecast = estimator.forecast()
    true_points = np.full((len(forecast.ids), 3), np.nan)
    if pose is not None and landmarks is not None and len(landmarks.ids):
        place = np.minimum(np.searchsorted(landmarks.ids, forecast.ids), len(landmarks.ids) - 1)
        known = landmarks.ids[place] == forecast.ids
        R_wc = rotations.matrix(pose.orientation)
        true_points[known] = (landmarks.positions[place[known]] - pose.position) @ R_wc
    return MapView(forecast.ids, forecast.uvd, forecast.S - estimator.noise.R, true_points)


@dataclass(frozen=True, eq=False)
class MapScore:
    """How wrong each landmark of a `MapView` is; NaN where it is not truly in both images.

    Attributes
    ----------
    ids : (N,) int64
        Landmarks.
    in_view : (N,) bool
        Truly in both images: what any filter has, whether or not it keeps what it has passed.
    true_points, points : (N, 3)
        True and estimated positions in the camera frame, m; estimated ones are NaN where d <= 0.
    distance : (N,)
        True distance from the camera, m.
    nees : (N,)
        In (u, v, d) space, 3 degrees of freedom.
    disparity_error, disparity_variance : (N,)
        True minus predicted d, px, and the variance claimed for it, px^2.
    """

    ids: IntArray
    in_view: BoolArray
    true_points: FloatArray
    points: FloatArray
    distance: FloatArray
    nees: FloatArray
    disparity_error: FloatArray
    disparity_variance: FloatArray


def score_map(view: MapView, camera: StereoCamera) -> MapScore:
    """Compare the map with the truth."""
    true_points = view.true_points
    with np.errstate(invalid="ignore", divide="ignore"):
        true_uvd = camera.project(true_points)
        in_view = (true_points[:, 2] > 0) & camera.in_view(true_uvd)
    errors = np.where(in_view[:, None], true_uvd - view.uvd, np.nan)
    points = np.full_like(view.uvd, np.nan)
    located = in_view & (view.uvd[:, 2] > 0) & np.isfinite(view.uvd).all(axis=1)
    points[located] = camera.backproject(view.uvd[located])
    return MapScore(
        view.ids,
        in_view,
        true_points,
        points,
        np.linalg.norm(true_points, axis=1),
        nees(errors, view.covariance),
        errors[:, 2],
        view.covariance[:, 2, 2],
    )


def mean_nees(score: MapScore) -> float:
    """Mean NEES of the landmarks in view, in (u, v, d) space, 3 degrees of freedom each; NaN without truth."""
    return _mean(score.nees)


def position_rmse(score: MapScore) -> float:
    """Root mean square error of landmark positions relative to the camera, m; NaN without truth.

    Over landmarks truly in view and within `SCORED_RANGE`, and estimated in front of the camera.
    """
    errors = score.points - score.true_points
    return float(np.sqrt(_mean(np.sum(errors**2, axis=1)[score.distance <= SCORED_RANGE])))


def depths(view: MapView, camera: StereoCamera) -> tuple[FloatArray, FloatArray]:
    """Depth of each landmark and its standard deviation to first order, m; NaN where d <= 0."""
    d = np.where(view.uvd[:, 2] > 0, view.uvd[:, 2], np.nan)
    depth = camera.disparity_constant / d
    return depth, depth / d * np.sqrt(np.maximum(view.covariance[:, 2, 2], 0.0))


def _mean(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else float("nan")
