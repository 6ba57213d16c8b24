"""Tracked landmarks: what is remembered of each, where it is expected, and the result of one pair."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np

from filters import Forecast, StereoCamera, StereoObservation
from filters.contract.noise import gate_limit
from filters.contract.validation import covariance_matrix, finite_array, unique_ids
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.ego_motion import MIN_POINTS, Pairs, Step, predicted, robust_step
from stereo_slam_env.frontend.patches import Patches
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.recording.recording import GreyImage


class Outcome(IntEnum):
    """Outcome of the search for a landmark."""

    MATCHED = 0
    """Found in both images."""
    NO_MATCH = 1
    """The best correlation inside the ellipse was too low or not unique."""
    NO_DISPARITY = 2
    """Found in the left image, but not along the row of the right one."""
    INCONSISTENT = 3
    """Found, but moved unlike the rest of the scene."""
    MOVING = 4
    """Found, on a body that moves: kept out of the map."""
    OUT_OF_VIEW = 5
    """Expected outside one of the images."""


@dataclass(frozen=True, eq=False)
class Search:
    """Search for the N landmarks tracked so far: where, and what was found."""

    ids: IntArray  # (N,): landmarks
    predicted: FloatArray  # (N, 3): expected (u, v, d), px
    S: FloatArray  # (N, 3, 3): covariance of measured minus expected, px^2: the ellipse that was searched
    found: FloatArray  # (N, 3): where it was found, px; NaN where it was not
    outcome: IntArray  # (N,): an `Outcome` each


def nothing_searched() -> Search:
    """The search where there was none, or where a front end does not tell."""
    none, nowhere = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    return Search(none, nowhere, np.zeros((0, 3, 3)), nowhere, none)


def _no_ids() -> IntArray:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class TrackedPair:
    """A front end's result for one pair: M measurements for the filter, and what else it tells of them."""

    ids: IntArray
    """(M,): landmark identities, ascending, never reused."""
    uvd: FloatArray
    """(M, 3): left pixel and disparity, px."""
    R: FloatArray
    """(M, 3, 3): covariances that are claimed for them, px^2."""
    search: Search = field(default_factory=nothing_searched)
    """How the landmarks of earlier pairs were followed; empty where that is not told."""
    corners: StereoObservation | None = None
    """New corners of this pair, of which the filter gets as many as it may have; None: those new in `ids`."""
    initialised: IntArray = field(default_factory=_no_ids)
    """(K,): which of `ids` are new to the filter."""
    dropped: IntArray = field(default_factory=_no_ids)
    """(L,): ids that will not come again: out of view, missed too often, or moving."""

    @cached_property
    def observation(self) -> StereoObservation:
        """The measurements, each with its own R."""
        return StereoObservation(self.ids, self.uvd, R=self.R)


BODY_SIZE = 3.0
"""Landmarks this near to each other, m, may be on one body."""
MEMORY = 6
"""Measurements kept of each landmark: of this pair and of the five before."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """N landmarks, one row each in every array."""

    ids: IntArray  # (N,): ascending
    patches: Patches  # (N, s, s): cut around the landmark in the left image where it was first seen
    first_uvd: FloatArray  # (N, 3): measured there, px
    first_R: FloatArray  # (N, 3, 3): orientation of the left camera then, in the front end's own world
    first_position: FloatArray  # (N, 3): and its position, m
    uvd: FloatArray  # (N, 3): last measured, or carried over by the motion since; px
    R: FloatArray  # (N, 3, 3): its covariance, px^2
    measured: FloatArray  # (N, MEMORY, 3): the last measurements, px, newest first; NaN where it was not found
    measured_R: FloatArray  # (N, MEMORY, 3, 3): their covariances, px^2
    age: IntArray  # (N,): pairs in which it was found after the first
    misses: IntArray  # (N,): pairs in a row in which it was not found
    strikes: IntArray  # (N,): pairs in a row in which it moved unlike the scene
    moving: BoolArray  # (N,): on a body that moves
    released: BoolArray  # (N,): whether it has been given to the filter

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, index: BoolArray | IntArray | slice) -> Tracks:
        """Tracks at `index`."""
        return Tracks(*(getattr(self, about.name)[index] for about in fields(self)))

    def joined(self, other: Tracks) -> Tracks:
        """These, then the others."""
        if len(other) == 0:
            return self
        return Tracks(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))

    def next_pair(self) -> Tracks:
        """The memory moved on by one, with nothing measured yet in the newest place."""
        measured, measured_R = np.roll(self.measured, 1, axis=1), np.roll(self.measured_R, 1, axis=1)
        measured[:, 0], measured_R[:, 0] = np.nan, np.nan
        return replace(self, measured=measured, measured_R=measured_R)


def new_tracks(
    ids: IntArray, patches: Patches, uvd: FloatArray, R: FloatArray, R_vc: FloatArray, position_v: FloatArray
) -> Tracks:
    """Landmarks measured for the first time, from one camera pose."""
    count = len(ids)
    measured, measured_R = np.full((count, MEMORY, 3), np.nan), np.full((count, MEMORY, 3, 3), np.nan)
    measured[:, 0], measured_R[:, 0] = uvd, R
    none = np.zeros(count, dtype=np.int64)
    return Tracks(
        ids,
        patches,
        uvd,
        np.tile(R_vc, (count, 1, 1)),
        np.tile(position_v, (count, 1)),
        uvd,
        R,
        measured,
        measured_R,
        age=none,
        misses=none,
        strikes=none,
        moving=none.astype(bool),
        released=none.astype(bool),
    )


Rows = tuple[IntArray, IntArray]
"""Positions of the same landmarks in the tracks and in a forecast."""


def rows_from(other: object, own: object, rows: BoolArray, *names: str) -> Iterator[Any]:
    """Arrays of those names, N rows each: `rows` (N,) of them from `other`, the rest from `own`."""
    for name in names:
        values = getattr(own, name)
        yield np.where(rows.reshape(-1, *[1] * (values.ndim - 1)), getattr(other, name), values)


@dataclass(frozen=True, eq=False)
class Expectation:
    """Expected measurements of N tracks."""

    uvd: FloatArray  # (N, 3): expected (u, v, d), px
    S: FloatArray  # (N, 3, 3): covariance of measured minus expected, px^2
    in_view: BoolArray  # (N,): in front of the camera and inside both images
    step: Step  # the motion of the camera that goes with it

    def merged(self, other: Expectation, rows: BoolArray) -> Expectation:
        """This one, with `rows` (N,) from the other."""
        uvd, S, in_view = rows_from(other, self, rows, "uvd", "S", "in_view")
        return Expectation(uvd, S, in_view, other.step)


def require_pair(camera: StereoCamera, left: GreyImage, right: GreyImage) -> None:
    """Refuse with a `ValueError` images that are not grey, uint8 and of the camera's size."""
    shape = (camera.height, camera.width)
    for name, image in (("left", left), ("right", right)):
        if not isinstance(image, np.ndarray) or image.shape != shape or image.dtype != np.uint8:
            what = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
            raise ValueError(f"{name} must be a grey uint8 image of shape {shape}, got {what}")


def require_legal(forecast: Forecast) -> None:
    """Refuse with a `ValueError` what is no `Forecast` of right shapes, finite, with unique ids and covariances S."""
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
    """Standing landmarks moved by the camera's `step` since the previous pair; moving ones go on as before.

    `last` is the step before that one; `margin` is kept to the edges of the view, px.
    """
    uvd, covariance, in_front = predicted(camera, tracks.uvd, tracks.R, step, step_covariance)
    twice = tracks.moving & np.isfinite(tracks.measured[:, 1:3]).all(axis=(1, 2))
    if last is not None and twice.any():
        stayed, _, _ = predicted(camera, tracks.measured[twice, 2], tracks.measured_R[twice, 2], last, np.zeros((6, 6)))
        uvd[twice] += tracks.measured[twice, 1] - stayed
    return Expectation(uvd, covariance + tracks.R, in_front & camera.in_view(uvd, margin), step)


def by_forecast(
    camera: StereoCamera,
    tracks: Tracks,
    expected: Expectation,
    forecast: Forecast,
    rows: Rows,
    settings: TrackerSettings,
) -> Expectation:
    """The filter's forecast for the landmarks of `rows`, see `sure_rows`, in place of what else is `expected`."""
    i, j = rows
    foreseen = ~tracks.moving[i] | settings.movers
    i, j = i[foreseen], j[foreseen]
    uvd, S, in_view = expected.uvd.copy(), expected.S.copy(), expected.in_view.copy()
    uvd[i], S[i] = forecast.uvd[j], forecast.S[j]
    in_view[i] = forecast.in_view[j] & camera.in_view(uvd[i], settings.margin)
    return Expectation(uvd, S, in_view, expected.step)


def step_of_forecast(camera: StereoCamera, tracks: Tracks, forecast: Forecast, rows: Rows) -> Step | None:
    """The motion of the camera that a forecast means: from where the landmarks were to where they are expected."""
    i, j = rows
    visible = tracks.misses[i] == 0
    i, j = i[visible], j[visible]
    if len(i) < MIN_POINTS:
        return None
    step_found = robust_step(camera, Pairs(tracks.uvd[i], forecast.uvd[j], tracks.R[i], forecast.S[j]), None)
    return None if step_found is None else step_found.step


def beside_moving(camera: StereoCamera, uvd: FloatArray, moving_uvd: FloatArray) -> BoolArray:
    """Mask of measurements (N, 3) that may lie on the bodies of moving landmarks (M, 3)."""
    if len(moving_uvd) == 0 or len(uvd) == 0:
        return np.zeros(len(uvd), dtype=bool)
    reach = BODY_SIZE * camera.fx / camera.disparity_constant * moving_uvd[:, 2]  # px at the depth of the body
    apart = np.linalg.norm(uvd[:, None, :2] - moving_uvd[None, :, :2], axis=2)
    depth = camera.disparity_constant / np.maximum(uvd[:, 2], 1e-3)
    body = camera.disparity_constant / np.maximum(moving_uvd[:, 2], 1e-3)
    as_deep = np.abs(depth[:, None] - body[None]) < BODY_SIZE + 0.1 * body[None]
    return np.asarray(((apart < reach[None]) & as_deep).any(axis=1))


def searchable(S: FloatArray, settings: TrackerSettings) -> BoolArray:
    """Whether the ellipses in the left image are small enough to be searched; (N, 3, 3) -> (N,)."""
    largest = np.linalg.eigvalsh(S[:, :2, :2])[:, 1]
    return np.asarray(gate_limit(settings.search_gate, 2) * largest <= settings.max_radius**2)


def sure_rows(tracks: Tracks, forecast: Forecast, settings: TrackerSettings) -> Rows:
    """Rows of the same landmarks in the tracks and in the forecast, where that is sure enough to search there."""
    _, i, j = np.intersect1d(tracks.ids, forecast.ids, assume_unique=True, return_indices=True)
    sure = searchable(forecast.S[j], settings)
    return i[sure], j[sure]
