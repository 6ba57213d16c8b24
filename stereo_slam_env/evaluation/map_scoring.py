"""Errors of a filter's map as seen from its current pose, and depth histories of two landmarks.

Everything is judged in the camera: depth, point and uncertainty follow from the forecast (u, v, d) and its covariance,
which holds the correlation of landmark and pose and means the same for every parametrisation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from filters.consistency import nees
from filters.contract.observation import StereoObservation
from filters.contract.stereo_filter import StereoFilter
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.evaluation.trajectory_metrics import mean
from stereo_slam_env.recording.recording import Frame, LandmarkTruth, Recording

TRACED_DEPTHS: Mapping[str, float] = {"near": 20.0, "far": 75.0}  # m, the paper's
ENOUGH_FRAMES = 12  # the paper's figures show so many
SCORED_RANGE = 40.0  # m; farther landmarks have no useful position error, and not every filter maps them


@dataclass(frozen=True, eq=False)
class MapView:
    """The map in the current camera."""

    ids: IntArray  # (N,) int64
    uvd: FloatArray  # (N, 3): predicted measurement, px
    covariance: FloatArray  # (N, 3, 3): of the prediction: H P H^T, without the measurement noise, px^2
    true_points: FloatArray  # (N, 3): true positions in the true camera frame, m; NaN where unknown


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
    """Errors of the landmarks of a `MapView`; NaN where it is not truly in both images."""

    ids: IntArray  # (N,) int64
    # (N,) bool: truly in both images: what any filter has, whether or not it keeps what it has passed.
    in_view: BoolArray
    # (N, 3): true and estimated positions in the camera frame, m; estimated ones are NaN where d <= 0.
    true_points: FloatArray
    points: FloatArray
    distance: FloatArray  # (N,): true distance from the camera, m
    nees: FloatArray  # (N,): in (u, v, d) space, 3 degrees of freedom
    # (N,): true minus predicted d, px, and the variance claimed for it, px^2.
    disparity_error: FloatArray
    disparity_variance: FloatArray

    @property
    def mean_nees(self) -> float:
        """Mean NEES of the landmarks in view; NaN without truth."""
        return mean(self.nees[np.isfinite(self.nees)])

    @property
    def position_rmse(self) -> float:
        """Root mean square error of positions relative to the camera, m; NaN without truth.

        Over landmarks truly in view and within `SCORED_RANGE`, and estimated in front of the camera.
        """
        squared = np.sum((self.points - self.true_points) ** 2, axis=1)[self.distance <= SCORED_RANGE]
        return float(np.sqrt(mean(squared[np.isfinite(squared)])))


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


def depths(view: MapView, camera: StereoCamera) -> tuple[FloatArray, FloatArray]:
    """Depth of each landmark and its standard deviation to first order, m; NaN where d <= 0."""
    d = np.where(view.uvd[:, 2] > 0, view.uvd[:, 2], np.nan)
    depth = camera.disparity_constant / d
    return depth, depth / d * np.sqrt(np.maximum(view.covariance[:, 2, 2], 0.0))


@dataclass(frozen=True, eq=False)
class LandmarkTrace:
    """Depth of one landmark as a filter saw it, frame by frame (the paper's section 4.3).

    Attributes
    ----------
    landmark_id : int
        Identity.
    label : str
        "near" or "far".
    frames : (L,) int64
        Indices of the frames in which the landmark was in the map.
    depth, sigma : (L,)
        Estimated depth z in the current camera and its standard deviation, m.
    true_depth : (L,)
        m; NaN where unknown.
    measured_depth : (L,)
        From the frame's own disparity alone, m; NaN where not seen or d <= 0.
    """

    landmark_id: int
    label: str
    frames: IntArray
    depth: FloatArray
    sigma: FloatArray
    true_depth: FloatArray
    measured_depth: FloatArray


def choose_landmarks(recording: Recording) -> dict[str, int]:
    """The landmarks to trace: label -> id, chosen from the recording alone.

    Of the tracks of at least `ENOUGH_FRAMES` frames (of the longest ones, if none is so long) the one whose
    disparity at first sight is nearest to the disparity of the wanted depth; ties to the earlier, then smaller id.
    The disparity is the true one where truth is known: chosen by a measured one, a landmark would be one whose first
    error makes it look as far as it was wanted.
    """
    seen = [_noise_free(frame, recording) for frame in recording.frames]
    if not any(len(observation) for observation in seen):
        return {}
    ids = np.concatenate([observation.ids for observation in seen])
    disparities = np.concatenate([observation.uvd[:, 2] for observation in seen])
    landmarks, first, lengths = np.unique(ids, return_index=True, return_counts=True)
    long = lengths >= min(ENOUGH_FRAMES, int(lengths.max()))
    landmarks, first = landmarks[long], first[long]
    chosen: dict[str, int] = {}
    for label, depth in TRACED_DEPTHS.items():
        miss = np.abs(disparities[first] - recording.camera.disparity_constant / depth)
        miss[np.isin(landmarks, list(chosen.values()))] = np.inf
        best = np.lexsort((landmarks, first, miss))[0]
        if np.isfinite(miss[best]):
            chosen[label] = int(landmarks[best])
    return chosen


def _noise_free(frame: Frame, recording: Recording) -> StereoObservation:
    """The observation of `frame` with true (u, v, d), as far as truth is known."""
    seen, landmarks = frame.observation, recording.landmarks
    if frame.truth is None or landmarks is None or not np.isin(seen.ids, landmarks.ids).all():
        return seen
    points_w = landmarks.positions[np.searchsorted(landmarks.ids, seen.ids)]
    points_c = frame.truth.to_camera(points_w)
    return StereoObservation(seen.ids, recording.camera.project(points_c))


class TraceRecorder:
    """Collects the traces of a run, a frame at a time."""

    def __init__(self, recording: Recording) -> None:
        self._camera = recording.camera
        self._chosen = choose_landmarks(recording)
        self._rows: dict[str, list[tuple[float, ...]]] = {label: [] for label in self._chosen}

    def add(self, frame: int, view: MapView, observation: StereoObservation) -> None:
        """Note the traced landmarks that are in the map in `frame`."""
        for label, landmark in self._chosen.items():
            at = view.ids == landmark
            if not at.any():
                continue
            one = MapView(view.ids[at], view.uvd[at], view.covariance[at], view.true_points[at])
            depth, sigma = depths(one, self._camera)
            seen = observation.uvd[observation.ids == landmark, 2]
            measured = self._camera.disparity_constant / seen[0] if seen.size and seen[0] > 0 else np.nan
            self._rows[label].append((frame, depth[0], sigma[0], one.true_points[0, 2], measured))

    def traces(self) -> tuple[LandmarkTrace, ...]:
        """The traces so far; landmarks that were never in the map have empty ones."""
        collected = []
        for label, landmark in self._chosen.items():
            rows = np.array(self._rows[label], dtype=np.float64).reshape(-1, 5)
            collected.append(LandmarkTrace(landmark, label, rows[:, 0].astype(np.int64), *rows[:, 1:].T))
        return tuple(collected)
