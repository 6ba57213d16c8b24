"""Noise of tracks, measured from the tracks themselves: how large their errors are, and how long they last.

Between two frames, all points of a static scene move as one motion of the camera says. What is left of the flow when
the most likely motion is taken out are differences of errors, and their covariance over 0, 1, 2, ... frames says what
kind of errors: white ones take back in the next frame what they gave (negative at one frame, zero beyond), steps of a
random walk leave no trace in later frames (zero from one frame on), and points that slide at a steady rate go on for
many frames (positive). No ground truth is needed.
"""

from __future__ import annotations

import dataclasses
import logging
from dataclasses import dataclass

import numpy as np

from filters import ColouredNoise, LandmarkDrift, StereoNoise
from filters.validation import FloatArray, IntArray
from stereo_slam_env.frontend.ego_motion import Pairs, robust_step, transfer
from stereo_slam_env.frontend.settings import DRIFT_SHARE
from stereo_slam_env.recording.recording import Recording

LAGS = 10
"""Frames over which errors are followed: a slide lasts about as long."""
LEAST_RESIDUALS = 400
"""With fewer, nothing is said of how errors last."""
LEAST_FLOW = 0.3
"""Points that move less between two frames, px, do not slide, and are left out."""
OUTLIER = 8.0
"""Robust standard deviations beyond which a residual is a mismatch or a moving object."""
FIRST_GUESS = StereoNoise.independent_pixels(0.4)
"""For the weights of the motion between two frames, where measurements bring no covariance."""
WHITE, GATE = 0.8, 1.2
"""Standard deviations of the white part and of the steps that the gate allows, in those of a residual; chosen on KITTI
07, where the error hardly depends on them."""
MOST_IN_COMMON = 0.004
"""Largest gauge walk that is stated, rad per root of a radian: with worse tracks, what they add differs from point to
point and is in the drift of the landmarks (docs/covariances.md)."""
MISALIGNMENT = 0.005
"""Of a camera in a vehicle and the axes of its reference, rad, where nobody has measured it."""
DISPARITY_OFFSET = 0.05
"""What a rectification leaves in all disparities, px."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class FlowResiduals:
    """What the most likely motion between two frames leaves of the flow of each track, in order of track and frame."""

    ids: IntArray
    """(N,), of the track."""
    frames: IntArray
    """(N,): number of the second frame."""
    residuals: FloatArray
    """(N, 3): measured minus predicted (u, v, d), px."""
    flow: FloatArray
    """(N,): how far the point moved in the left image, px."""

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class TrackNoise:
    """How the errors of tracks are distributed over time."""

    step: FloatArray
    """(3,): standard deviation of a residual of (u, v, d), px."""
    lasting: FloatArray
    """(3,), of the random walk that adds up as the errors do over many frames, px a frame: the residuals' variance plus
    twice their covariances over 1 to `LAGS` frames."""
    correlation: FloatArray
    """(LAGS + 1, 3), of residuals so many frames apart."""
    slide: float
    """The steady part alone, by how far the points move: root of twice the covariances over 1 to `LAGS` frames of
    residuals in u and v over the root of the flow, rad per root of a radian. 0 where residuals one frame apart are not
    positively correlated: then most of the errors are white or a walk, and a sum of covariances above 0 is chance, or
    the texture's."""

    @property
    def lasts(self) -> bool:
        """Whether errors in u and v add up: the walk's variance is over half of a residual's (white 0, walk 1)."""
        return float(np.sum(self.lasting[:2] ** 2)) > 0.5 * float(np.sum(self.step[:2] ** 2))


def flow_residuals(recording: Recording) -> FlowResiduals:
    """Residuals of the flow between the frames of a recording, with robust motions between them."""
    rows, step, before = [], None, None
    for number, frame in enumerate(recording.frames):
        now = frame.observation
        if before is not None:
            ids, i, j = np.intersect1d(before.ids, now.ids, assume_unique=True, return_indices=True)
            R = [seen.covariances(FIRST_GUESS)[k] for seen, k in ((before, i), (now, j))]
            pairs = Pairs(before.uvd[i], now.uvd[j], *R)
            found = robust_step(recording.camera, pairs, step)
            step = None if found is None else found.step
            if step is not None:
                residuals = pairs.second - transfer(recording.camera, pairs.first, step).uvd
                flow = np.linalg.norm((pairs.second - pairs.first)[:, :2], axis=1)
                rows.append(np.column_stack([ids, np.full(len(ids), number), residuals, flow]))
        before = now
    table = np.vstack([np.zeros((0, 6)), *rows])
    table = table[np.isfinite(table).all(axis=1) & (table[:, 5] >= LEAST_FLOW)]
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    return FlowResiduals(table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2:5], table[:, 5])


def track_noise(flow: FlowResiduals, focal_length: float) -> TrackNoise:
    """Noise of the tracks whose residuals these are; `focal_length` in px.

    Raises
    ------
    ValueError
        There are fewer than `LEAST_RESIDUALS`.
    """
    if len(flow) < LEAST_RESIDUALS:
        raise ValueError(f"flow must have at least {LEAST_RESIDUALS} residuals, got {len(flow)}: record more frames")
    scale = 1.4826 * np.median(np.abs(flow.residuals), axis=0)
    inlier = np.all(np.abs(flow.residuals) <= OUTLIER * scale, axis=1)
    by_flow = flow.residuals[:, :2] / np.sqrt(flow.flow)[:, None]
    key = flow.ids * (int(flow.frames.max()) + LAGS + 2) + flow.frames
    covariances, by_flow_covariances = np.zeros((LAGS + 1, 3)), np.zeros(LAGS + 1)
    for lag in range(LAGS + 1):
        later = np.minimum(np.searchsorted(key, key + lag), len(key) - 1)
        pairs = np.flatnonzero((key[later] == key + lag) & inlier & inlier[later])
        if len(pairs):
            covariances[lag] = np.mean(flow.residuals[pairs] * flow.residuals[later[pairs]], axis=0)
            by_flow_covariances[lag] = np.mean(by_flow[pairs] * by_flow[later[pairs]])
    lasting = covariances[0] + 2.0 * covariances[1:].sum(axis=0)
    correlation = covariances / np.where(covariances[0] > 0, covariances[0], 1.0)
    slide = 2.0 * float(by_flow_covariances[1:].sum()) / focal_length if np.mean(correlation[1, :2]) > 0.0 else 0.0
    return TrackNoise(
        np.sqrt(covariances[0]), np.sqrt(np.maximum(lasting, 0.0)), correlation, float(np.sqrt(max(slide, 0.0)))
    )


def with_measured_noise(recording: Recording) -> Recording:
    """The recording with what its tracks say of their noise: `ColouredNoise`, with the R that it had.

    Measurements that bring a covariance of their own keep it as the white part and drift by a share of it; the others
    have what `TrackNoise` says. Tracks that slide are those of a real camera, which is mounted to `MISALIGNMENT` and
    rectified to `DISPARITY_OFFSET`.
    Where too little can be seen, and where errors are found to be white, the noise stays as it was.
    """
    flow = flow_residuals(recording)
    try:
        found = track_noise(flow, recording.camera.fx)
    except ValueError as reason:
        _log.info("%s: the noise of the tracks is not measured: %s", recording.name, reason)
        return recording
    own = all(frame.observation.R is not None for frame in recording.frames)
    if not own and not found.lasts:
        _log.info("%s: the errors of its tracks are white", recording.name)
        return recording
    white, drift = None, LandmarkDrift(share=DRIFT_SHARE)
    if not own:
        white = StereoNoise.independent_pixels(WHITE * float(np.sqrt(np.mean(found.step[:2] ** 2)))).R
        gate = GATE * found.step
        drift = LandmarkDrift(pixels=tuple(np.maximum(found.lasting, gate).tolist()), gate_pixels=tuple(gate.tolist()))
    gauge_walk = min(found.slide, MOST_IN_COMMON)
    of_the_rig = (MISALIGNMENT, DISPARITY_OFFSET) if gauge_walk else (0.0, 0.0)
    noise = ColouredNoise(recording.noise.R, white, drift, gauge_walk, *of_the_rig)
    _log.info("%s: %s", recording.name, noise)
    return dataclasses.replace(recording, noise=noise)
