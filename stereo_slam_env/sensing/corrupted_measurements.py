"""Corruptions of single measurements; `sensing.corruptions` lists them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np

from filters import StereoCamera, StereoNoise, StereoObservation
from filters.contract.validation import finite_number, positive, probability
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.recording.recording import LandmarkTruth, Recording


def checked(check: Callable[[str, Any], object], **default: Any) -> Any:
    """A field of a corruption whose value `check` refuses with a `ValueError`."""
    return field(metadata={"check": check}, **default)


class Checked:
    """Base of corruptions: their fields are checked when one is made."""

    def __post_init__(self) -> None:
        for one in fields(self):  # type: ignore[arg-type]
            if check := one.metadata.get("check"):
                check(one.name, getattr(self, one.name))


class OfMeasurements(Checked):
    """Base of corruptions that change the measurements of each frame by themselves."""

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        return recording.with_observations(
            self.changed(frame.observation, recording.camera, rng) for frame in recording.frames
        )

    def changed(self, seen: StereoObservation, camera: StereoCamera, rng: np.random.Generator) -> StereoObservation:
        """Measurements of a frame instead of `seen`, everything random from `rng`."""
        raise NotImplementedError


def _positive_if_given(name: str, value: float | None) -> None:
    if value is not None:
        positive(name, value)


def _more_than_nothing(name: str, value: float) -> None:
    if finite_number(name, value) <= -100.0:
        raise ValueError(f"{name} must be more than -100, got {value!r}")


@dataclass(frozen=True)
class Outliers(OfMeasurements):
    """Measurements that are grossly wrong.

    Parameters
    ----------
    share : float
        Probability of each measurement to be one.
    sigma : float, optional
        Standard deviation of the error added to u, v and d, px. None: uniform over the images, whatever was there.
    """

    share: float = checked(probability)
    sigma: float | None = checked(_positive_if_given, default=None)

    def changed(self, seen: StereoObservation, camera: StereoCamera, rng: np.random.Generator) -> StereoObservation:
        """The row of the right image, where measured, moves along."""
        hit, drawn = rng.random(len(seen)) < self.share, rng.random((len(seen), 3))
        errors = rng.standard_normal((len(seen), 3))
        if self.sigma is None:
            u, v = drawn[:, 0] * (camera.width - 1), drawn[:, 1] * (camera.height - 1)
            elsewhere = np.stack([u, v, drawn[:, 2] * u], axis=1)
        else:
            elsewhere = seen.uvd + self.sigma * errors
        return _moved(seen, np.where(hit[:, None], elsewhere, seen.uvd))


@dataclass(frozen=True)
class WrongIds(OfMeasurements):
    """Landmarks that are taken for each other: one exchanges its id with the nearest in the left image.

    Parameters
    ----------
    probability : float
        Of each measurement to start an exchange, in which two get a wrong id; none takes part in two.
    """

    probability: float = checked(probability)

    def changed(self, seen: StereoObservation, camera: StereoCamera, rng: np.random.Generator) -> StereoObservation:
        starting = np.flatnonzero(rng.random(len(seen)) < self.probability)
        if len(seen) < 2 or not len(starting):
            return seen
        pixels = seen.uvd[:, :2]
        distances = np.linalg.norm(pixels[starting, None] - pixels, axis=2)
        distances[np.arange(len(starting)), starting] = np.inf
        ids, taken = seen.ids.copy(), np.zeros(len(seen), dtype=np.bool_)
        for i, j in zip(starting, distances.argmin(axis=1), strict=True):  # a few at most
            if not (taken[i] or taken[j]):
                ids[i], ids[j] = ids[j], ids[i]
                taken[i] = taken[j] = True
        return StereoObservation(ids, seen.uvd, seen.v_right, seen.R).ordered()


@dataclass(frozen=True)
class MissedDetections(OfMeasurements):
    """Landmarks in view that are not measured.

    Parameters
    ----------
    probability : float
        Of each measurement to be missing.
    """

    probability: float = checked(probability)

    def changed(self, seen: StereoObservation, camera: StereoCamera, rng: np.random.Generator) -> StereoObservation:
        return seen.select(rng.random(len(seen)) >= self.probability)


@dataclass(frozen=True)
class BiasedDisparity(OfMeasurements):
    """All disparities off by the same amount, as an imperfect rectification leaves them.

    Parameters
    ----------
    bias : float
        Added to d, px.
    """

    bias: float = checked(finite_number)

    def changed(self, seen: StereoObservation, camera: StereoCamera, rng: np.random.Generator) -> StereoObservation:
        return _moved(seen, seen.uvd + np.array([0.0, 0.0, self.bias]))


@dataclass(frozen=True)
class WrongCalibration(OfMeasurements):
    """The camera that measures is not quite the one the filter is told.

    Parameters
    ----------
    focal_percent, baseline_percent, principal_point_percent : float
        By how much the focal lengths, the baseline and (cx, cy) of the camera that measures are larger than told, %.
    """

    focal_percent: float = checked(_more_than_nothing, default=0.0)
    baseline_percent: float = checked(_more_than_nothing, default=0.0)
    principal_point_percent: float = checked(finite_number, default=0.0)

    def changed(self, seen: StereoObservation, camera: StereoCamera, rng: np.random.Generator) -> StereoObservation:
        """Rays and depths stay, so noise scales with the focal length."""
        longer, wider = 1.0 + self.focal_percent / 100.0, 1.0 + self.baseline_percent / 100.0
        centre = np.array([camera.cx, camera.cy])
        moved_centre = centre * (1.0 + self.principal_point_percent / 100.0)
        pixels = longer * (seen.uvd[:, :2] - centre) + moved_centre
        v_right = None if seen.v_right is None else longer * (seen.v_right - centre[1]) + moved_centre[1]
        return StereoObservation(seen.ids, np.column_stack([pixels, longer * wider * seen.uvd[:, 2]]), v_right, seen.R)


@dataclass(frozen=True)
class MisscaledNoise(OfMeasurements):
    """The filter is told a wrong accuracy of the measurements, which stay as they are.

    Parameters
    ----------
    factor : float
        Standard deviations told over those that are right.
    """

    factor: float = checked(positive)

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Nothing is random."""
        noise = StereoNoise(self.factor**2 * recording.noise.R)
        return replace(super().applied_to(recording, rng), noise=noise)

    def changed(self, seen: StereoObservation, camera: StereoCamera, rng: np.random.Generator) -> StereoObservation:
        return seen if seen.R is None else replace(seen, R=self.factor**2 * seen.R)


@dataclass(frozen=True)
class MovingLandmarks(Checked):
    """Some landmarks are not part of the static world: they move on from where they are first seen.

    Parameters
    ----------
    share : float
        Probability of each landmark to move.
    speed : float
        Constant, in a direction of its own parallel to the x-z plane of W, m/s.
    """

    share: float = checked(probability)
    speed: float = checked(partial(positive, allow_zero=True))

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """The noise of a measurement stays, and a landmark that leaves the images is not measured.

        Those that move have no truth any more: the truth is that of the static world.
        """
        landmarks = known_world(recording)
        moving = rng.random(len(landmarks.ids)) < self.share
        heading = rng.uniform(0.0, 2.0 * np.pi, len(landmarks.ids))
        velocities = self.speed * np.stack([np.sin(heading), np.zeros_like(heading), np.cos(heading)], axis=1)

        def driven(time: float, first_seen: FloatArray, index: IntArray) -> FloatArray:
            return np.asarray(velocities[index] * (time - first_seen)[:, None])

        static = LandmarkTruth(landmarks.ids[~moving], landmarks.positions[~moving])
        return replace(moved_on(recording, moving, driven), landmarks=static)


def known_world(recording: Recording) -> LandmarkTruth:
    """The true landmarks; a `ValueError` where there are none, or a frame has no true pose."""
    landmarks = recording.landmarks
    if landmarks is None or not len(landmarks.ids) or any(frame.truth is None for frame in recording.frames):
        raise ValueError("needs the true landmarks and the true pose of every frame: give a simulated drive")
    return landmarks


def moved_on(
    recording: Recording, moving: BoolArray, displacement: Callable[[float, FloatArray, IntArray], FloatArray]
) -> Recording:
    """The drive past landmarks of which some move on from where they are first seen.

    Parameters
    ----------
    recording : Recording
        With N true landmarks and the true pose of every frame.
    moving : (N,) bool
        Which of the landmarks move.
    displacement : callable
        Time, s, times of first sight (K,), s, and indices (K,) of landmarks -> their displacements (K, 3), m in W.
    """
    landmarks, camera = known_world(recording), recording.camera
    first_seen, observations = np.full(len(moving), np.nan), []
    for frame in recording.frames:
        assert frame.truth is not None
        place = np.minimum(np.searchsorted(landmarks.ids, frame.observation.ids), len(moving) - 1)
        concerned = (landmarks.ids[place] == frame.observation.ids) & moving[place]
        those = place[concerned]
        first_seen[those] = np.fmin(first_seen[those], frame.timestamp)
        static_w = landmarks.positions[those]
        moved_w = static_w + displacement(frame.timestamp, first_seen[those], those)
        points_c = frame.truth.to_camera(moved_w)
        uvd_expected, uvd = camera.project(points_c), frame.observation.uvd.copy()
        uvd[concerned] += uvd_expected - camera.project(frame.truth.to_camera(static_w))
        visible = np.ones(len(uvd), dtype=np.bool_)
        visible[concerned] = (points_c[:, 2] > 0) & camera.in_view(uvd_expected)
        uvd[~visible] = 0.0
        observations.append(_moved(frame.observation, uvd).select(visible))
    return recording.with_observations(observations)


def _moved(seen: StereoObservation, uvd: FloatArray) -> StereoObservation:
    """The same landmarks measured at `uvd`; the right image shifts by as many rows as the left one."""
    v_right = None if seen.v_right is None else seen.v_right + (uvd[:, 1] - seen.uvd[:, 1])
    return StereoObservation(seen.ids, uvd, v_right, seen.R)
