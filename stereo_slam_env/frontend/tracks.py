"""Tracked landmarks: what is remembered of each, and the result of one pair."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum

import numpy as np

from filters.interface import StereoObservation
from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.patches import Patches


class Outcome(IntEnum):
    """What became of a landmark that was searched for."""

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
    """Where landmarks were searched for and what was found; N rows, all the landmarks tracked so far.

    Attributes
    ----------
    ids : (N,) int64
        Landmarks.
    predicted : (N, 3)
        Expected (u, v, d), px.
    S : (N, 3, 3)
        Covariance of measured minus expected, px^2: the ellipse that was searched.
    found : (N, 3)
        Where it was found, px; NaN where it was not.
    outcome : (N,) int64
        An `Outcome` each.
    """

    ids: IntArray
    predicted: FloatArray
    S: FloatArray
    found: FloatArray
    outcome: IntArray


@dataclass(frozen=True, eq=False)
class TrackedPair:
    """The front end's result for one pair.

    Attributes
    ----------
    observation : StereoObservation
        The measurements for the filter, ids ascending, each with its own R.
    search : Search
        How the landmarks of earlier pairs were followed.
    corners : StereoObservation
        New corners of this pair; those that stand still will be given to the filter after their probation.
    initialised : (K,) int64
        Ids in `observation` that are new to the filter.
    dropped : (L,) int64
        Ids that will not come again: out of view, missed too often, or moving.
    """

    observation: StereoObservation
    search: Search
    corners: StereoObservation
    initialised: IntArray
    dropped: IntArray


MEMORY = 6
"""Measurements kept of each landmark: of this pair and of the five before."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """N landmarks, one row each in every array.

    Attributes
    ----------
    ids : (N,) int64
        Ascending.
    patches : (N, s, s)
        Cut around the landmark in the left image where it was first seen.
    first_uvd : (N, 3)
        Measured there, px.
    first_R, first_position : (N, 3, 3), (N, 3)
        Pose of the left camera then, in the front end's own world.
    uvd, R : (N, 3), (N, 3, 3)
        Last measured, or carried over by the motion since; px.
    measured : (N, MEMORY, 3)
        The last measurements, newest first; NaN where the landmark was not found. px.
    measured_R : (N, MEMORY, 3, 3)
        Their covariances, px^2.
    age : (N,) int64
        Pairs in which it was found after the first.
    misses : (N,) int64
        Pairs in a row in which it was not found.
    strikes : (N,) int64
        Pairs in a row in which it moved unlike the scene.
    moving : (N,) bool
        On a body that moves.
    released : (N,) bool
        Whether it has been given to the filter.
    """

    ids: IntArray
    patches: Patches
    first_uvd: FloatArray
    first_R: FloatArray
    first_position: FloatArray
    uvd: FloatArray
    R: FloatArray
    measured: FloatArray
    measured_R: FloatArray
    age: IntArray
    misses: IntArray
    strikes: IntArray
    moving: BoolArray
    released: BoolArray

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, index: BoolArray | IntArray | slice) -> Tracks:
        """Those at `index`."""
        return Tracks(*(getattr(self, field.name)[index] for field in fields(self)))

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
    ids: IntArray,
    patches: Patches,
    uvd: FloatArray,
    R: FloatArray,
    R_vc: FloatArray,
    position_v: FloatArray,
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
