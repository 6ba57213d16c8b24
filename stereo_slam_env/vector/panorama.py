"""Panoramas of the beliefs of many environments: `wrappers.BeliefPanorama` in one compiled call."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from filters.contract.noise import StereoNoise
from filters.engine.batch import RelativeLandmarks
from filters.geometry.camera import StereoCamera
from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.world.rays import OPTIONS


def panoramas(
    maps: RelativeLandmarks,
    angles: FloatArray,
    camera: StereoCamera,
    noise: StereoNoise,
    sectors: int,
    most: int,
    reach: float,
) -> FloatArray:
    """`wrappers.belief_panorama.around` of each environment; angles (B, 2) of the heads, rad; (B, sectors, 4)."""
    seen = np.zeros((len(angles), sectors, 4))
    along, across = noise.R[2, 2] / camera.disparity_constant**2, noise.R[0, 0] / camera.fx**2
    _panoramas(maps.offsets, maps.points_c, maps.covariances, maps.located, angles, along, across, most, reach, seen)
    return seen


@njit(**OPTIONS)
def _panoramas(
    offsets: IntArray,
    points_c: FloatArray,
    covariances: FloatArray,
    located: BoolArray,
    angles: FloatArray,
    noise_along: float,
    noise_across: float,
    most: int,
    reach: float,
    seen: FloatArray,
) -> None:
    sectors = seen.shape[1]
    for b in range(len(angles)):
        sin_pan, cos_pan = math.sin(angles[b, 0]), math.cos(angles[b, 0])
        sin_tilt, cos_tilt = math.sin(angles[b, 1]), math.cos(angles[b, 1])
        for m in range(offsets[b], offsets[b + 1]):
            x, y, z = points_c[m, 0], points_c[m, 1], points_c[m, 2]
            distance = math.sqrt(x * x + y * y + z * z)
            if not located[m] or distance > reach:
                continue
            right = cos_pan * x + sin_pan * sin_tilt * y + sin_pan * cos_tilt * z
            down = cos_tilt * y - sin_tilt * z
            ahead = -sin_pan * x + cos_pan * sin_tilt * y + cos_pan * cos_tilt * z
            azimuth = math.atan2(right, ahead)
            sector = math.floor((azimuth + math.pi) * (sectors / (2.0 * math.pi))) % sectors
            along, spread = 0.0, 0.0
            for i in range(3):
                for j in range(3):
                    along += points_c[m, i] * covariances[m, i, j] * points_c[m, j]
                spread += covariances[m, i, i]
            along /= distance * distance
            across = 0.5 * (spread - along)
            square = distance * distance
            gain = 0.5 * math.log1p(along / (square * square * noise_along))
            gain += math.log1p(across / (square * noise_across))
            row = seen[b, sector]
            row[0] += 1.0
            row[1] += gain
            row[2] += math.atan2(-down, math.sqrt(right * right + ahead * ahead))
            row[3] = max(row[3], 1.0 / (1.0 + distance / 10.0))
        for k in range(sectors):
            row = seen[b, k]
            row[2] /= 0.5 * math.pi * max(row[0], 1.0)
            row[0] /= most
            row[1] = 0.1 * math.log1p(row[1])
