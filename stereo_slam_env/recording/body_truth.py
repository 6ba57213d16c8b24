"""Truth about moving bodies, and its form in files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray

BODY_KINDS = ("car", "pedestrian", "bus")
"""Kinds of moving bodies, in the order of their codes in files and in `info`, which begin at 1."""

BODY_COLUMNS: Mapping[str, str] = {"positions": "position", "orientations": "orientation"} | {
    name: name for name in ("linear", "angular")
}
"""Attributes of `BodyTruth` that are numbers of each body, and their names in the file."""


@dataclass(frozen=True, eq=False)
class BodyTruth:
    """Moving bodies in one frame, and the body of each measurement; for scores only.

    Bodies that come or go in a step are left out of its last frame, and none of their points is measured in it.
    """

    ids: IntArray
    """(K,): number of each body in the scene, the same in all frames, ascending."""
    kinds: tuple[str, ...]
    """(K,): each one of `BODY_KINDS`."""
    positions: FloatArray
    """(K, 3): origin of each body in W, m: on the ground, in the middle."""
    orientations: FloatArray
    """(K, 4): unit quaternions xyzw that take vectors of a body (x forward, y left, z up) into W."""
    linear: FloatArray
    """(K, 3): velocity of the origin in W over the step from the previous frame to this one, m/s."""
    angular: FloatArray
    """(K, 3): angular velocity in W over that step, rad/s."""
    of_measurements: IntArray
    """(M,): number of the body that each measurement of the frame is of, -1 where it stands."""

    @property
    def codes(self) -> IntArray:
        """(K,): codes of the kinds."""
        return np.array([BODY_KINDS.index(kind) + 1 for kind in self.kinds], dtype=np.int64)
