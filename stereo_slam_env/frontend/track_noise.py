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
from scipy.stats import chi2

from filters import ColouredNoise, LandmarkDrift, StereoNoise
from filters.validation import FloatArray, IntArray
from stereo_slam_env.frontend.ego_motion import Pairs, robust_step, squared_distances, transfer
from stereo_slam_env.frontend.settings import DRIFT_SHARE
from stereo_slam_env.recording.recording import Recording

LAGS = 10
"""Frames over which errors are followed: a slide lasts about as long."""
LEAST_FLOW = 0.3
"""Points that move less between two frames, px, do not slide, and are left out."""
OUTLIER = 8.0
"""Robust standard deviations beyond which a residual is a mismatch or a moving object."""
FIRST_GUESS = StereoNoise.independent_pixels(0.4)
"""For the weights of the motion between two frames, where measurements bring no covariance."""
WHITE, GATE = 0.8, 1.2
"""Standard deviations of the white part and of the steps that the gate allows, in those of a residual; chosen on KITTI
07, where the error hardly depends on them."""
USUAL_SLIDE = 0.006
"""Slide of a recording of which nothing is known yet, rad per root of a radian: that of the tracks of KITTI 00, in the
middle of those that were measured (docs/covariances.md)."""
COMMON_FLOOR = 0.00275
"""What lens and calibration of a real camera add to all tracks of a frame, rad per root of a radian, however well they
are followed: the likelihood of windows wants 2 to 3 mrad (docs/covariances.md)."""
SLIDE_IN_COMMON = 0.25
"""Share of the slide that the tracks of a frame have in common."""
TINY = 1e-12
"""Least variance, px^2, and rad^2 per rad."""
MEDIAN = float(chi2.median(3))
"""Of chi-square with 3 degrees of freedom."""
MISALIGNMENT = 0.005
"""Of a camera in a vehicle and the axes of its reference, rad, where nobody has measured it."""
DISPARITY_OFFSET = 0.1
"""What a rectification leaves in all disparities beside a rotation, px: of 0.1 and 0.3 the better log score."""
RIGHT_TURN = 0.00175
"""What it leaves of the rotation of the right camera about its vertical and its optical axis, rad: 0.1 degrees."""
SCALE = 0.01
"""Share by which a stranger's rig makes the world larger than it is: that of a baseline stated to 1 %."""

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
    squared: FloatArray
    """(N,): squared residual by the covariance that the measurements claim for it; chi-square with 3 if they are white
    and right, less if they last."""

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class TrackNoise:
    """How the errors of tracks are distributed over time."""

    step: FloatArray
    """(3,): standard deviation of a residual of (u, v, d), px; zero without residuals."""
    lasting: FloatArray
    """(3,), of the random walk that adds up as the errors do over many frames, px a frame: the residuals' variance plus
    twice their covariances over 1 to `LAGS` frames."""
    correlation: FloatArray
    """(LAGS + 1, 3), of residuals so many frames apart."""
    lasting_share: float
    """Variance of that walk by that of a residual, in u and v: 0 of white errors, 1 of a walk, more of a slide."""
    lasting_share_error: float
    """Its standard error, from track to track; infinite without tracks."""
    slide_variance: float
    """The steady part alone, by how far the points move: twice the covariances over 1 to `LAGS` frames of residuals in
    u and v over the root of the flow, rad squared per radian. White errors take back in the next frame what they gave,
    so that the covariance at one frame is taken to be that at two where it is less. May be below zero by chance."""
    slide_variance_error: float
    """Its standard error, from track to track; infinite without tracks."""
    claimed_too_small: float
    """Factor, at least 1, by which the variances that measurements claim are too small at least: a residual has no more
    than they allow. Of the median; 1 without residuals."""

    @property
    def slide(self) -> float:
        """The slide as the tracks and a prior of `USUAL_SLIDE` give it, rad per root of a radian.

        The variance is the mean of both, weighted by their errors; that of the prior is as large as itself.
        """
        usual = USUAL_SLIDE**2
        trust = usual**2 / (usual**2 + self.slide_variance_error**2)
        return float(np.sqrt(max(trust * self.slide_variance + (1.0 - trust) * usual, 0.0)))

    @property
    def ignorance(self) -> float:
        """Of what can be known of how errors last, the part that is not, 0 to 1: 1 without tracks."""
        return float(np.sqrt(1.0 - 1.0 / (1.0 + self.lasting_share_error**2)))

    @property
    def known_to_last(self) -> float:
        """Of the errors, the share that is known to last, 0 to 1: that of the walk, with a prior of 0 ± 1."""
        return float(np.clip(self.lasting_share / (1.0 + self.lasting_share_error**2), 0.0, 1.0))


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
                squared = squared_distances(recording.camera, pairs, step)
                flow = np.linalg.norm((pairs.second - pairs.first)[:, :2], axis=1)
                rows.append(np.column_stack([ids, np.full(len(ids), number), residuals, flow, squared]))
        before = now
    table = np.vstack([np.zeros((0, 7)), *rows])
    table = table[np.isfinite(table).all(axis=1) & (table[:, 5] >= LEAST_FLOW)]
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    ids, frames = table[:, :2].astype(np.int64).T
    return FlowResiduals(ids, frames, table[:, 2:5], table[:, 5], table[:, 6])


def track_noise(flow: FlowResiduals, focal_length: float) -> TrackNoise:
    """Noise of the tracks whose residuals these are; `focal_length` in px."""
    scale = 1.4826 * np.median(np.abs(flow.residuals), axis=0) if len(flow) else np.zeros(3)
    inlier = np.all(np.abs(flow.residuals) <= OUTLIER * scale, axis=1)
    by_flow = flow.residuals[:, :2] / np.sqrt(flow.flow * focal_length)[:, None]
    key = flow.ids * (int(flow.frames.max(initial=0)) + LAGS + 2) + flow.frames
    tracks, track = np.unique(flow.ids, return_inverse=True)
    covariances, slides = np.zeros((LAGS + 1, 3)), np.zeros(LAGS + 1)
    parts, slide_parts = (np.zeros((LAGS + 1, len(tracks))) for _ in range(2))  # what each track adds to the mean
    unknown = 0
    for lag in range(LAGS + 1):
        later = np.minimum(np.searchsorted(key, key + lag), len(key) - 1)
        pairs = np.flatnonzero((key[later] == key + lag) & inlier & inlier[later])
        unknown += len(pairs) == 0
        if len(pairs):
            products = flow.residuals[pairs] * flow.residuals[later[pairs]]
            slid = np.mean(by_flow[pairs] * by_flow[later[pairs]], axis=1)
            covariances[lag], slides[lag] = products.mean(axis=0), slid.mean()
            parts[lag] = np.bincount(track[pairs], products[:, :2].sum(axis=1) / len(pairs), len(tracks))
            slide_parts[lag] = np.bincount(track[pairs], slid / len(pairs), len(tracks))
    lasting = covariances[0] + 2.0 * covariances[1:].sum(axis=0)
    correlation = covariances / np.where(covariances[0] > 0, covariances[0], 1.0)
    variance = float(covariances[0, :2].sum())
    share = float(lasting[:2].sum()) / variance if variance > 0.0 else 0.0
    of_share, of_slide = np.array([1.0 - share] + [2.0] * LAGS), np.array([0.0] + [2.0] * LAGS)
    if slides[1] < slides[2]:
        of_slide[1:3] = 0.0, 4.0
    # A covariance that nobody has measured may be as large as the variance.
    doubt = 2.0 * np.sqrt(unknown) if variance > 0.0 else np.inf
    return TrackNoise(
        np.sqrt(covariances[0]),
        np.sqrt(np.maximum(lasting, 0.0)),
        correlation,
        share,
        float(np.hypot(np.linalg.norm(of_share @ parts) / max(variance, TINY), doubt)),
        float(of_slide @ slides),
        float(np.hypot(np.linalg.norm(of_slide @ slide_parts), doubt * max(slides[0], TINY))),
        max(1.0, float(np.median(flow.squared)) / MEDIAN) if len(flow) else 1.0,
    )


def with_measured_noise(recording: Recording) -> Recording:
    """The recording with what its tracks say of their noise: `ColouredNoise`, with the R that it had.

    Measurements that bring a covariance of their own keep it as the white part and drift by a share of it. The white
    part of others goes from R, where errors are white or little is known, to what `TrackNoise` says, where they are
    known to last. The rig of a simulation is as stated; that of anybody else has the errors of the constants above, and
    its tracks have a part in common that no residual shows.
    """
    found = track_noise(flow_residuals(recording), recording.camera.fx)
    white, drift = None, LandmarkDrift(share=DRIFT_SHARE)
    if any(frame.observation.R is None for frame in recording.frames):
        share = found.known_to_last
        measured = StereoNoise.independent_pixels(1.0).R * WHITE**2 * float(np.mean(found.step[:2] ** 2))
        white = (1.0 - share) * recording.noise.R + share * measured
        gate = GATE * np.sqrt(share) * found.step
        drift = LandmarkDrift(
            DRIFT_SHARE * found.ignorance,
            tuple(np.maximum(found.lasting, gate).tolist()),
            tuple(gate.tolist()),
        )
    noise = ColouredNoise(recording.noise.R, white, drift)
    if recording.truth_from.kind != "simulation":
        noise = dataclasses.replace(
            noise,
            gauge_walk=float(np.hypot(COMMON_FLOOR, SLIDE_IN_COMMON * found.slide)),
            misalignment=MISALIGNMENT,
            disparity_offset=DISPARITY_OFFSET,
            right_yaw=RIGHT_TURN,
            right_roll=RIGHT_TURN,
            scale=SCALE,
        )
    _log.info("%s: %s", recording.name, noise)
    return dataclasses.replace(_with_claims_raised(recording, found.claimed_too_small), noise=noise)


def _with_claims_raised(recording: Recording, factor: float) -> Recording:
    """The recording with the covariances that its measurements bring times a factor."""
    if factor == 1.0:
        return recording
    observations = [frame.observation for frame in recording.frames]
    return recording.with_observations(
        seen if seen.R is None else dataclasses.replace(seen, R=factor * seen.R) for seen in observations
    )
