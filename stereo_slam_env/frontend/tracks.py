"""What the front end remembers of each landmark it follows."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.patches import Patches

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
