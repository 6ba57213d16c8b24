"""Where the landmarks are expected in the next pair, and how surely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.camera import StereoCamera
from filters.engine.gating import gate_limit
from filters.interface import Forecast
from filters.validation import BoolArray, FloatArray, IntArray, covariance_matrix, finite_array, unique_ids
from stereo_slam_env.frontend.ego_motion import MIN_POINTS, Pairs, Step, predicted, robust_step
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import Tracks

Rows = tuple[IntArray, IntArray]
"""Positions of the same landmarks in the tracks and in a forecast."""


@dataclass(frozen=True, eq=False)
class Expectation:
    """Of N tracks.

    Attributes
    ----------
    uvd : (N, 3)
        Expected (u, v, d), px.
    S : (N, 3, 3)
        Covariance of measured minus expected, px^2.
    in_view : (N,) bool
        In front of the camera and inside both images.
    step : Step
        The motion of the camera that goes with it.
    """

    uvd: FloatArray
    S: FloatArray
    in_view: BoolArray
    step: Step

    def merged(self, other: Expectation, rows: BoolArray) -> Expectation:
        """This one, with `rows` (N,) from the other."""
        return Expectation(
            np.where(rows[:, None], other.uvd, self.uvd),
            np.where(rows[:, None, None], other.S, self.S),
            np.where(rows, other.in_view, self.in_view),
            other.step,
        )


def require_legal(forecast: Forecast) -> None:
    """Refuse what no filter may forecast.

    Parameters
    ----------
    forecast : Forecast
        As a filter returns it.

    Raises
    ------
    ValueError
        It is no `Forecast`; wrong shapes, NaN or infinity, repeated ids, an S that is no covariance.
    """
    if not isinstance(forecast, Forecast):
        raise ValueError(f"forecast must be a Forecast or None, got {type(forecast).__name__}")
    count = len(unique_ids("forecast.ids", forecast.ids))
    finite_array("forecast.uvd", forecast.uvd, (count, 3))
    covariance_matrix("forecast.S", forecast.S, 3, batch=count)
    in_view = np.asarray(forecast.in_view)
    if in_view.shape != (count,) or in_view.dtype != np.bool_:
        raise ValueError(f"forecast.in_view must be bool of shape ({count},), got {in_view.dtype} {in_view.shape}")


def constant_velocity_covariance(settings: TrackerSettings, dt: float) -> FloatArray:
    """Covariance (6, 6) of a step that is expected to be like the one before: t (m), then rotation (rad)."""
    sigmas = np.repeat([settings.sigma_acceleration, settings.sigma_angular_acceleration], 3) * dt**2
    return np.diag(sigmas**2)


def by_motion(
    camera: StereoCamera, tracks: Tracks, step: Step, step_covariance: FloatArray, last: Step | None, margin: float
) -> Expectation:
    """Where standing landmarks come to by the motion of the camera, and moving ones by going on as before.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    tracks : Tracks
        With the memory moved on: nothing measured yet in this pair.
    step, step_covariance : Step, (6, 6)
        Motion since the previous pair, and covariance of its error.
    last : Step or None
        Motion between the two previous pairs.
    margin : float
        Of the view, px.
    """
    uvd, covariance, in_front = predicted(camera, tracks.uvd, tracks.R, step, step_covariance)
    twice = tracks.moving & np.isfinite(tracks.measured[:, 1:3]).all(axis=(1, 2))
    if last is not None and twice.any():
        stayed, _, _ = predicted(camera, tracks.measured[twice, 2], tracks.measured_R[twice, 2], last, np.zeros((6, 6)))
        uvd[twice] += tracks.measured[twice, 1] - stayed
    return Expectation(uvd, covariance + tracks.R, in_front & camera.in_view(uvd, margin), step)


def by_forecast(
    camera: StereoCamera, tracks: Tracks, expected: Expectation, forecast: Forecast, rows: Rows, margin: float
) -> Expectation:
    """The filter's word for the landmarks of `rows`, see `sure_rows`, in place of what else is `expected`."""
    i, j = rows
    standing = ~tracks.moving[i]
    i, j = i[standing], j[standing]
    uvd, S, in_view = expected.uvd.copy(), expected.S.copy(), expected.in_view.copy()
    uvd[i], S[i] = forecast.uvd[j], forecast.S[j]
    in_view[i] = forecast.in_view[j] & camera.in_view(uvd[i], margin)
    return Expectation(uvd, S, in_view, expected.step)


def step_of_forecast(camera: StereoCamera, tracks: Tracks, forecast: Forecast, rows: Rows) -> Step | None:
    """The motion of the camera that a forecast means: from where the landmarks were to where they are expected."""
    i, j = rows
    seen = tracks.misses[i] == 0
    i, j = i[seen], j[seen]
    if len(i) < MIN_POINTS:
        return None
    found = robust_step(camera, Pairs(tracks.uvd[i], forecast.uvd[j], tracks.R[i], forecast.S[j]), None)
    return None if found is None else found.step


def searchable(S: FloatArray, settings: TrackerSettings) -> BoolArray:
    """Whether the ellipses in the left image are small enough to be searched; (N, 3, 3) -> (N,)."""
    largest = np.linalg.eigvalsh(S[:, :2, :2])[:, 1]
    return np.asarray(gate_limit(settings.search_gate, 2) * largest <= settings.max_radius**2)


def sure_rows(tracks: Tracks, forecast: Forecast, settings: TrackerSettings) -> Rows:
    """Rows of the same landmarks in the tracks and in the forecast, where that is sure enough to search there."""
    _, i, j = np.intersect1d(tracks.ids, forecast.ids, assume_unique=True, return_indices=True)
    sure = searchable(forecast.S[j], settings)
    return i[sure], j[sure]
