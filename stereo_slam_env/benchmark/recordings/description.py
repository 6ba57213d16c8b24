"""Description of a recording: digest of what filters are given, and errors of its measurements by range."""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.recording.recording import Recording

RANGES = (0.0, 15.0, 30.0, 45.0, 70.0, 150.0, np.inf)
"""Bounds of the bins, m."""
OUTLIER = 1.5
"""An error beyond this is an outlier, px: the convention of the figures it is compared with."""
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class NoiseOfRange:
    """Errors of the measurements of landmarks in one range of depths; each triple is for u, v, d.

    Attributes
    ----------
    low, high : float
        Depths z, m.
    count : int
        Measurements.
    bias : (3,) tuple
        Median error, px.
    sigma : (3,) tuple
        1.4826 x median absolute deviation, px.
    outliers : (3,) tuple
        Share of errors beyond `OUTLIER` px.
    claimed : (3,) tuple
        Median of the standard deviations that the measurements claim, px.
    """

    low: float
    high: float
    count: int
    bias: tuple[float, float, float]
    sigma: tuple[float, float, float]
    outliers: tuple[float, float, float]
    claimed: tuple[float, float, float]


def description_of(recording: Recording) -> dict[str, Any]:
    """What is kept of a recording beside it; JSON-able."""
    description: dict[str, Any] = {
        "name": recording.name,
        "frames": len(recording),
        "stream_sha256": stream_digest(recording),
        "R": recording.noise.R.tolist(),
        "reference": dataclasses.asdict(recording.reference),
        "source": dict(recording.source),
    }
    from_images = any(frame.observation.R is not None for frame in recording.frames)
    if recording.landmarks is not None and from_images:
        rows = [dataclasses.asdict(row) for row in noise_by_range(recording)]
        # The open end of the last range is null.
        description["sensor_noise"] = [
            {**row, "high": row["high"] if np.isfinite(row["high"]) else None} for row in rows
        ]
    return description


def stream_digest(recording: Recording) -> str:
    """SHA-256 of everything a filter is given: equal digests mean bit-identical input."""
    digest = hashlib.sha256(repr(recording.camera).encode())
    start = recording.start
    parts: list[Any] = [
        recording.noise.R,
        start.position,
        start.orientation,
        start.linear_velocity,
        start.angular_velocity,
        start.covariance,
    ]
    for frame in recording.frames:
        seen, odometry = frame.observation, frame.odometry
        parts += [np.float64(frame.timestamp), seen.ids, seen.uvd, seen.v_right, seen.R]
        parts += [None] if odometry is None else [odometry.linear, odometry.angular, odometry.covariance]
    for part in parts:
        digest.update(b"-" if part is None else np.ascontiguousarray(part).tobytes() + b"|")
    return digest.hexdigest()


def measurement_errors(recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Depths z (n,), m, errors (n, 3) of (u, v, d), px, and claimed R (n, 3, 3), px^2, where the truth is known.

    Raises
    ------
    ValueError
        The recording knows no landmarks.
    """
    truth = recording.landmarks
    if truth is None:
        raise ValueError(f"recording {recording.name!r} has no true landmarks: its errors cannot be known")
    depths, errors, claimed = [np.zeros(0)], [np.zeros((0, 3))], [np.zeros((0, 3, 3))]
    for frame in recording.frames:
        if frame.truth is None:
            continue
        seen = frame.observation
        _, i, j = np.intersect1d(seen.ids, truth.ids, assume_unique=True, return_indices=True)
        p_c = frame.truth.to_camera(truth.positions[j])
        depths.append(p_c[:, 2])
        errors.append(seen.uvd[i] - recording.camera.project(p_c))
        claimed.append(seen.covariances(recording.noise)[i])
    return np.concatenate(depths), np.concatenate(errors), np.concatenate(claimed)


def noise_by_range(recording: Recording) -> tuple[NoiseOfRange, ...]:
    """Bias, spread and outliers in each range that has measurements, then over all; raises as `measurement_errors`."""
    depths, errors, R = measurement_errors(recording)
    rows = []
    for low, high in [*pairwise(RANGES), (RANGES[0], RANGES[-1])]:
        inside = (depths >= low) & (depths < high)
        if not inside.any():
            continue
        error = errors[inside]
        bias = np.median(error, axis=0)
        sigma = _MAD_TO_SIGMA * np.median(np.abs(error - bias), axis=0)
        outliers = (np.abs(error) > OUTLIER).mean(axis=0)
        claimed = np.median(np.sqrt(np.einsum("nii->ni", R[inside])), axis=0)
        triples = (tuple(values.tolist()) for values in (bias, sigma, outliers, claimed))
        rows.append(NoiseOfRange(low, high, int(inside.sum()), *triples))
    return tuple(rows)
