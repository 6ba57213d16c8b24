"""Errors of the measurements of a recording against its truth: their bias, spread and outliers, how long they last."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.recording.recording import Recording

RANGES = (0.0, 15.0, 30.0, 45.0, 70.0, 150.0, np.inf)
"""Bounds of the bins, m."""
OUTLIER = 1.5
"""An error beyond this is an outlier, px: the convention of the figures it is compared with."""
LAGS = (1, 5, 10)
"""Frames between two errors of a landmark whose correlation is stated."""
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, eq=False)
class MeasurementErrors:
    """Errors of all measurements whose truth is known."""

    ids: IntArray  # (N,): of the landmarks
    frames: IntArray  # (N,): number of the frame
    depths: FloatArray  # (N,): z, m
    errors: FloatArray  # (N, 3): of (u, v, d), px
    R: FloatArray  # (N, 3, 3): claimed covariances, px^2

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class NoiseOfRange:
    """Errors of the measurements of landmarks in one range of depths; each triple is for u, v, d."""

    # Depths z, m.
    low: float
    high: float
    count: int
    bias: tuple[float, float, float]  # median error, px
    sigma: tuple[float, float, float]  # 1.4826 x median absolute deviation, px
    outliers: tuple[float, float, float]  # share of errors beyond `OUTLIER` px
    claimed: tuple[float, float, float]  # median of the standard deviations that the measurements claim, px


def measurement_errors(recording: Recording) -> MeasurementErrors:
    """Errors of a recording with known landmarks; a `ValueError` for one without."""
    truth = recording.landmarks
    if truth is None:
        raise ValueError(f"recording {recording.name!r} has no true landmarks: its errors cannot be known")
    none = np.zeros(0, dtype=np.int64)
    parts = [(none, none, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))]
    for number, frame in enumerate(recording.frames):
        if frame.truth is None:
            continue
        seen = frame.observation
        ids, i, j = np.intersect1d(seen.ids, truth.ids, assume_unique=True, return_indices=True)
        p_c = frame.truth.to_camera(truth.positions[j])
        errors = seen.uvd[i] - recording.camera.project(p_c)
        R = seen.covariances(recording.noise)[i]
        parts.append((ids, np.full(len(ids), number), p_c[:, 2], errors, R))
    return MeasurementErrors(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def noise_by_range(found: MeasurementErrors) -> tuple[NoiseOfRange, ...]:
    """Bias, spread and outliers in each range that has measurements, then over all."""
    rows = []
    for low, high in [*pairwise(RANGES), (RANGES[0], RANGES[-1])]:
        inside = (found.depths >= low) & (found.depths < high)
        if not inside.any():
            continue
        error = found.errors[inside]
        bias = np.median(error, axis=0)
        sigma = _MAD_TO_SIGMA * np.median(np.abs(error - bias), axis=0)
        outliers = (np.abs(error) > OUTLIER).mean(axis=0)
        claimed = np.median(np.sqrt(np.einsum("nii->ni", found.R[inside])), axis=0)
        triples = (tuple(values.tolist()) for values in (bias, sigma, outliers, claimed))
        rows.append(NoiseOfRange(low, high, int(inside.sum()), *triples))
    return tuple(rows)


def error_correlation(found: MeasurementErrors, lag: int) -> FloatArray:
    """Correlation of two errors of a landmark, `lag` frames apart, of u, v and d (3,); NaN where there are none.

    Errors of `OUTLIER` px and more are left out. White noise has 0; errors that last have up to 1.
    """
    span = int(found.frames.max(initial=0)) + lag + 1
    inlier = (np.abs(found.errors) < OUTLIER).all(axis=1)
    key = (found.ids * span + found.frames)[inlier]
    _, first, later = np.intersect1d(key + lag, key, assume_unique=True, return_indices=True)
    if len(first) == 0:
        return np.full(3, np.nan)
    a, b = found.errors[inlier][first], found.errors[inlier][later]
    energy = np.sqrt((a**2).mean(axis=0) * (b**2).mean(axis=0))
    return np.asarray((a * b).mean(axis=0) / np.where(energy > 0.0, energy, np.nan))
