"""Poses of a GPS/IMU unit of OXTS type, in a local frame with x east, y north, z up.

The unit's own frame is x forward, y left, z up. The formulas are those of the development kit of the KITTI raw data
(`readme.txt` and `convertOxtsToPose.m`): Mercator projection at the latitude of the first packet, yaw counted from east
counter-clockwise, and R = Rz(yaw) Ry(pitch) Rx(roll).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from filters.validation import FloatArray

EARTH_RADIUS = 6378137.0
"""m, as in the development kit."""


def mercator_positions(latitude: FloatArray, longitude: FloatArray, altitude: FloatArray) -> FloatArray:
    """Positions (K, 3), m, of (K,) degrees, degrees and m; true to scale at the first finite latitude."""
    finite = latitude[np.isfinite(latitude)]
    scale = np.cos(np.deg2rad(finite[0])) if finite.size else 1.0
    x = scale * EARTH_RADIUS * np.deg2rad(longitude)
    y = scale * EARTH_RADIUS * np.log(np.tan(np.deg2rad(90.0 + latitude) / 2.0))
    return np.column_stack([x, y, altitude])


def attitudes(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> Rotation:
    """Rotations of (K,) rad each; they take vectors from the unit's frame to the local one."""
    return Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))


def levelled_to_body(vectors: FloatArray, roll: FloatArray, pitch: FloatArray) -> FloatArray:
    """Vectors (K, 3) along forward, left and up of the level earth's surface, in the unit's tilted frame."""
    tilt = Rotation.from_euler("YX", np.column_stack([pitch, roll]))
    body: FloatArray = tilt.inv().apply(vectors)
    return body
