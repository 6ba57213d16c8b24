"""Errors of a filter's map as seen from its current pose, and depth histories of two landmarks.

Everything is judged in the camera: depth, point and uncertainty follow from the forecast (u, v, d) and its covariance,
which holds the correlation of landmark and pose and means the same for every parametrisation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from filters.checks.consistency import nees
from filters.contract.outputs import Forecast
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from stereo_slam_env.loop import Moment
from stereo_slam_env.recording.recording import Frame, LandmarkTruth, Recording

TRACED_DEPTHS: Mapping[str, float] = {"near": 20.0, "far": 75.0}  # m, the paper's
ENOUGH_FRAMES = 12  # the paper's figures show so many
SCORED_RANGE = 40.0  # m; farther landmarks have no useful position error, and not every filter maps them


@dataclass(frozen=True, eq=False)
class FrameMap:
    """The map of a filter in one frame, as the filter forecasts it."""

    number: int  # of the frame
    frame: Frame  # with the measurements that were used
    forecast: Forecast
    noise: FloatArray  # (3, 3): R in the forecast, px^2

    @classmethod
    def of(cls, moment: Moment) -> FrameMap:
        """The map of a moment; a copy, for what a filter gives may change when it goes on."""
        forecast = moment.slam.forecast()
        copy = Forecast(
            np.array(forecast.ids), np.array(forecast.uvd), np.array(forecast.S), np.array(forecast.in_view)
        )
        count = len(copy.ids)
        if copy.uvd.shape != (count, 3) or copy.S.shape != (count, 3, 3):
            raise ValueError(f"forecast of {count} ids must have uvd ({count}, 3) and S ({count}, 3, 3)")
        return cls(moment.number, moment.frame, copy, moment.slam.noise.R)


@dataclass(frozen=True, eq=False)
class MapView:
    """The maps of some frames in their cameras, one row for each landmark of each frame, by frame."""

    frames: IntArray  # (N,) int64: number of the frame
    ids: IntArray  # (N,) int64
    uvd: FloatArray  # (N, 3): predicted measurement, px
    covariance: FloatArray  # (N, 3, 3): of the prediction: H P H^T, without the measurement noise, px^2
    true_points: FloatArray  # (N, 3): true positions in the true camera frame, m; NaN where unknown

    def __getitem__(self, rows: IntArray | BoolArray) -> MapView:
        points = self.true_points[rows]
        return MapView(self.frames[rows], self.ids[rows], self.uvd[rows], self.covariance[rows], points)


def view_maps(maps: Sequence[FrameMap], landmarks: LandmarkTruth | None) -> MapView:
    """The maps of at least one frame, next to the truth where it is known."""
    counts = [len(one.forecast.ids) for one in maps]
    row = np.repeat(np.arange(len(maps)), counts)
    numbers = np.array([one.number for one in maps])
    ids, uvd, S = (np.concatenate([getattr(one.forecast, name) for one in maps]) for name in ("ids", "uvd", "S"))
    covariance = S - np.array([one.noise for one in maps])[row]
    true_points = np.full((len(ids), 3), np.nan)
    poses = [one.frame.truth for one in maps]
    if landmarks is not None and len(landmarks.ids):
        place = np.minimum(np.searchsorted(landmarks.ids, ids), len(landmarks.ids) - 1)
        has_truth = (landmarks.ids[place] == ids) & np.array([pose is not None for pose in poses])[row]
        positions = np.array([np.zeros(3) if pose is None else pose.position for pose in poses])
        R_wc = rotations.matrix(np.array([_NO_TURN if pose is None else pose.orientation for pose in poses]))
        shifts = landmarks.positions[place[has_truth]] - positions[row[has_truth]]
        true_points[has_truth] = np.einsum("ni,nij->nj", shifts, R_wc[row[has_truth]])
    return MapView(numbers[row], ids, uvd, covariance, true_points)


_NO_TURN = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class MapScore:
    """Errors of the landmarks of a `MapView`; NaN where it is not truly in both images."""

    frames: IntArray  # (N,) int64
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

    def mean_nees(self, frames: range) -> FloatArray:
        """Mean NEES of the landmarks in view in each of these frames; NaN without truth."""
        return self._means(frames, self.nees, np.isfinite(self.nees))

    def position_rmse(self, frames: range) -> FloatArray:
        """Root mean square error of positions relative to the camera in each of these frames, m; NaN without truth.

        Over landmarks truly in view and within `SCORED_RANGE`, and estimated in front of the camera.
        """
        squared = np.sum((self.points - self.true_points) ** 2, axis=1)
        return np.sqrt(self._means(frames, squared, np.isfinite(squared) & (self.distance <= SCORED_RANGE)))

    def _means(self, frames: range, values: FloatArray, which: BoolArray) -> FloatArray:
        row = self.frames[which] - frames.start
        with np.errstate(invalid="ignore"):
            means: FloatArray = np.bincount(row, values[which], len(frames)) / np.bincount(row, minlength=len(frames))
        return means


def score_maps(view: MapView, camera: StereoCamera) -> MapScore:
    """Compare the maps with the truth."""
    true_points = view.true_points
    with np.errstate(invalid="ignore", divide="ignore"):
        true_uvd = camera.project(true_points)
        in_view = (true_points[:, 2] > 0) & camera.in_view(true_uvd)
    errors = np.where(in_view[:, None], true_uvd - view.uvd, np.nan)
    points = np.full_like(view.uvd, np.nan)
    located = in_view & (view.uvd[:, 2] > 0) & np.isfinite(view.uvd).all(axis=1)
    points[located] = camera.backproject(view.uvd[located])
    return MapScore(
        view.frames,
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
    """Depth of one landmark as a filter saw it, frame by frame (the paper's section 4.3)."""

    landmark_id: int
    """Identity of the landmark."""
    label: str
    """Either "near" or "far"."""
    frames: IntArray
    """(L,): indices of the frames in which the landmark was in the map."""
    depth: FloatArray
    """(L,): estimated depth z in the current camera, m."""
    sigma: FloatArray
    """(L,): its standard deviation, m."""
    true_depth: FloatArray
    """(L,), m; NaN where unknown."""
    measured_depth: FloatArray
    """(L,), from the frame's own disparity alone, m; NaN where not seen or d <= 0."""


def choose_landmarks(recording: Recording) -> dict[str, int]:
    """The landmarks to trace: label -> id, chosen from the recording alone.

    Of the tracks of at least `ENOUGH_FRAMES` frames (of the longest ones, if none is so long) the one whose
    disparity at first sight is nearest to the disparity of the wanted depth; ties to the earlier, then smaller id.
    The disparity is the true one where truth is known: chosen by a measured one, a landmark would be one whose first
    error makes it look as far as it was wanted.
    """
    ids = np.concatenate([frame.observation.ids for frame in recording.frames])
    if not len(ids):
        return {}
    landmarks, first, lengths = np.unique(ids, return_index=True, return_counts=True)
    disparities = _disparities_at(first, recording)
    long = lengths >= min(ENOUGH_FRAMES, int(lengths.max()))
    landmarks, first, disparities = landmarks[long], first[long], disparities[long]
    landmark_ids: dict[str, int] = {}
    for label, depth in TRACED_DEPTHS.items():
        miss = np.abs(disparities - recording.camera.disparity_constant / depth)
        miss[np.isin(landmarks, list(landmark_ids.values()))] = np.inf
        best = np.lexsort((landmarks, first, miss))[0]
        if np.isfinite(miss[best]):
            landmark_ids[label] = int(landmarks[best])
    return landmark_ids


def _disparities_at(sightings: IntArray, recording: Recording) -> FloatArray:
    """Disparities of some sightings, by their numbers in the whole recording; true ones as far as truth is known."""
    landmarks, camera = recording.landmarks, recording.camera
    ends = np.cumsum([len(frame.observation) for frame in recording.frames])
    numbers = np.searchsorted(ends, sightings, side="right")
    disparities = np.empty(len(sightings))
    for number in np.unique(numbers).tolist():
        frame, here = recording.frames[number], numbers == number
        seen, rows = frame.observation, sightings[here] - ends[number]
        disparities[here] = seen.uvd[rows, 2]
        if frame.truth is not None and landmarks is not None and np.isin(seen.ids, landmarks.ids).all():
            points_w = landmarks.positions[np.searchsorted(landmarks.ids, seen.ids[rows])]
            disparities[here] = camera.project(frame.truth.to_camera(points_w))[:, 2]
    return disparities


class TraceRecorder:
    """Collects the traces of a run, some frames at a time."""

    def __init__(self, recording: Recording) -> None:
        self._camera = recording.camera
        self._chosen = choose_landmarks(recording)
        self._rows: dict[str, list[tuple[float, ...]]] = {label: [] for label in self._chosen}

    def add(self, view: MapView, maps: Sequence[FrameMap]) -> None:
        """Note the traced landmarks in the maps of the next frames."""
        observations = {one.number: one.frame.observation for one in maps}
        for label, landmark in self._chosen.items():
            views = view[view.ids == landmark]
            for number, depth, sigma, point in zip(
                views.frames.tolist(), *depths(views, self._camera), views.true_points, strict=True
            ):
                d = observations[number].uvd[observations[number].ids == landmark, 2]
                measured = self._camera.disparity_constant / d[0] if d.size and d[0] > 0 else np.nan
                self._rows[label].append((number, depth, sigma, point[2], measured))

    def traces(self) -> tuple[LandmarkTrace, ...]:
        """The traces so far; landmarks that were never in the map have empty ones."""
        collected = []
        for label, landmark in self._chosen.items():
            rows = np.array(self._rows[label], dtype=np.float64).reshape(-1, 5)
            collected.append(LandmarkTrace(landmark, label, rows[:, 0].astype(np.int64), *rows[:, 1:].T))
        return tuple(collected)
