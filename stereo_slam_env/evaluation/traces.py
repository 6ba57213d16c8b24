"""Depth histories of a near and a far landmark (the paper's section 4.3), the same for every filter."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from filters.interface import StereoObservation
from stereo_slam_env.evaluation.map_scoring import MapView, depths
from stereo_slam_env.evaluation.results import LandmarkTrace
from stereo_slam_env.recording.recording import Frame, Recording

DEPTHS: Mapping[str, float] = {"near": 20.0, "far": 75.0}  # m, the paper's
ENOUGH_FRAMES = 12  # the paper's figures show so many


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
    for label, depth in DEPTHS.items():
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
