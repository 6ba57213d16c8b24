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
from itertools import pairwise

import numpy as np

from filters import ColouredNoise, LandmarkDrift, StereoCamera, StereoNoise, StereoObservation
from filters.checks.consistency import chi_square_quantile
from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.frontend.camera_motion import camera_steps
from stereo_slam_env.frontend.ego_motion import MIN_POINTS, Pairs, Step, squared_distances, transfer
from stereo_slam_env.frontend.settings import DRIFT_SHARE
from stereo_slam_env.recording.recording import Recording

LAGS = 10
"""Frames over which errors are followed: a slide lasts about as long."""
_LAGS = LAGS + 1
LEAST_FLOW = 0.3
"""Points that move less between two frames, px, do not slide, and are left out."""
OUTLIER = 8.0
"""Robust standard deviations beyond which a residual is a mismatch or a moving object."""
WHITE, GATE, LASTING = 0.8, 1.2, 1.6
"""Standard deviations of the part that cannot be told from white, of the steps that the gate of a walk allows, and of
the errors that last, in those of the part of a residual that is not white; chosen on KITTI 07, where the error hardly
depends on them."""
LASTING_TIME = 2.0
"""Time constant of errors that last, s: 1 to 4 s have the same log score (docs/covariances.md)."""
COMMON_WALK = 0.0043
"""Gauge walk of tracks that bring no covariance, rad per root of a radian: what lens, calibration and the habits of a
tracker add to all tracks of a frame. The log score of windows chose it (docs/covariances.md)."""
COMMON_WALK_WITH_R = 0.0014
"""That of measurements which bring one, as the project's own front end does."""
ROUGH = 2.0
"""Step of a residual in u or v, px, beyond which no covariance was right (KITTI 00 with noise and outliers added)."""
MISMATCHED = 0.12
"""Share of residuals beyond `OUTLIER` that is worth a warning: between those of KITTI 00 with 2 and 10 % of its matches
made wrong, 0.06 and 0.20."""
TINY = 1e-12
"""Least variance, px^2."""
_PASSES, _CHOOSING, _CONVERGED = 6, 2, 0.01
"""Of least squares for a step; those that choose the tracks near it; and m and rad whose squares are no pixels."""
MEDIAN = chi_square_quantile(0.5, 3)
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
class TrackNoise:
    """Distribution of the errors of tracks over time."""

    step: FloatArray
    """(3,): standard deviation of a residual of (u, v, d), px; zero without residuals."""
    white: FloatArray
    """(3,), of the part of a measurement that is independent from frame to frame, px: by covariances of residuals 0, 1
    and 2 frames apart, of which what lasts has about as much in each, c, and white noise w has 2 w, -w and 0."""
    lasting: FloatArray
    """(3,), of the random walk that adds up as the errors do over many frames, px a frame: the residuals' variance plus
    twice their covariances over 1 to `LAGS` frames."""
    correlation: FloatArray
    """(LAGS + 1, 3), of residuals so many frames apart."""
    lasting_share: float
    """Variance of that walk by that of a residual, in u and v: 0 of white errors, 1 of a walk, more of a slide."""
    lasting_share_error: float
    """Its standard error, from track to track; infinite without tracks."""
    claimed_too_small: float
    """Factor, at least 1, by which the variances that measurements claim are too small at least: a residual has no more
    than they allow. Of the median; 1 without residuals."""
    mismatched: float
    """Share of the residuals beyond `OUTLIER`, 0 to 1: those of a wrong match are two, there and back."""

    @property
    def is_rough(self) -> bool:
        """Whether tracks jump so far from frame to frame that no covariance was right."""
        return bool(np.max(self.step[:2]) > ROUGH)

    @property
    def ignorance(self) -> float:
        """Uncertainty of how errors last, 0 to 1: 1 without tracks."""
        return float(np.sqrt(1.0 - 1.0 / (1.0 + self.lasting_share_error**2)))

    @property
    def known_to_last(self) -> float:
        """Share of the errors that is known to last, 0 to 1: that of the walk, with a prior of 0 ± 1."""
        return float(np.clip(self.lasting_share / (1.0 + self.lasting_share_error**2), 0.0, 1.0))


class TrackStatistics:
    """Running sums of what the motion between frames leaves of the flow of each track, and of what lasts of it.

    Sums of products of residuals 0, 1, ... `LAGS` frames apart, and the squares of what each track adds to them, for
    standard errors; the rest is forgotten when a track ends. It needs no future: see `noise` at any time.
    """

    def __init__(self, camera: StereoCamera) -> None:
        self._camera = camera
        self._ids = np.zeros(0, dtype=np.int64)
        self._tracks = _Tracks.none(0)
        self._absolute = np.zeros(3)  # sum over frames of the median size of a residual, px
        self._squared = 0.0  # of the median squared one
        self.frames = 0
        """Those with residuals."""
        self._moved = self._matched = 0  # residuals, and those within `OUTLIER`
        self._counts = np.zeros(_LAGS)
        self._products = np.zeros((_LAGS, 3))
        self._scatter = np.zeros((_LAGS, _LAGS))  # of the sums of tracks that have ended

    def add(self, before: StereoObservation, now: StereoObservation, step: Step | None, *, fits: bool = True) -> None:
        """Take in a frame, its camera at `step` from that of the frame before, which came in before.

        A step that is not the one that fits these tracks best, as that of a filter, is corrected by least squares.
        Where none is known, or too few tracks tell, tracks go on without residuals.
        """
        ids, i, j = np.intersect1d(before.ids, now.ids, assume_unique=True, return_indices=True)
        tracks = self._followed(ids)
        if step is None:
            return
        first, second = before.uvd[i], now.uvd[j]
        if not fits:
            step = _fitted(self._camera, first, second, step)
            if step is None:
                return
        expected = transfer(self._camera, first, step)
        residuals = second - expected.uvd
        flow = np.sqrt(np.sum((second - first)[:, :2] ** 2, axis=1))
        usable = np.isfinite(residuals).all(axis=1) & (flow >= LEAST_FLOW)
        if usable.any():
            if before.R is not None and now.R is not None:
                pairs = Pairs(first[usable], second[usable], before.R[i[usable]], now.R[j[usable]])
                self._squared += float(np.median(squared_distances(self._camera, pairs, step)))
            self._absolute += 1.4826 * np.median(np.abs(residuals[usable]), axis=0)
            self.frames += 1
        self._moved += int(usable.sum())
        usable &= np.all(np.abs(residuals) <= OUTLIER * self._absolute / max(self.frames, 1), axis=1)
        self._matched += int(usable.sum())
        tracks.residuals[:, 0] = np.where(usable[:, None], residuals, np.nan)
        products = tracks.residuals * tracks.residuals[:, :1]
        products[:, 1] = _at_one_frame(tracks.residuals, expected.by_first)
        finite = np.isfinite(products).all(axis=2)
        products[~finite] = 0.0
        self._counts += finite.sum(axis=0)
        self._products += products.sum(axis=0)
        tracks.sums[:] += products[:, :, 0] + products[:, :, 1]

    def pause(self) -> None:
        """All tracks end here: the next frame to come in is a later one."""
        self._followed(np.zeros(0, dtype=np.int64))

    def _followed(self, ids: IntArray) -> _Tracks:
        """Tracks with these ids, one frame later; those that have ended leave their scatter."""
        goes_on, old, new = np.intersect1d(self._ids, ids, assume_unique=True, return_indices=True)
        if len(goes_on) < len(self._ids):
            ended = np.delete(self._tracks.sums, old, axis=0)
            self._scatter += ended.T @ ended
        tracks = _Tracks.none(len(ids))
        tracks.residuals[new, 1:] = self._tracks.residuals[old, :-1]
        tracks.sums[new] = self._tracks.sums[old]
        self._ids, self._tracks = ids, tracks
        return tracks

    @property
    def noise(self) -> TrackNoise:
        """Noise of the tracks so far."""
        counts, sums = np.maximum(self._counts, 1.0), self._tracks.sums
        covariances = self._products / counts[:, None]
        scatter = (self._scatter + sums.T @ sums) / np.outer(counts, counts)
        lasting = covariances[0] + 2.0 * covariances[1:].sum(axis=0)
        correlation = covariances / np.where(covariances[0] > 0, covariances[0], 1.0)
        white = np.clip(0.25 * (covariances[0] - 2.0 * covariances[1] + covariances[2]), 0.0, 0.5 * covariances[0])
        variance = float(covariances[0, :2].sum())
        share = float(lasting[:2].sum()) / variance if variance > 0.0 else 0.0
        weights = np.array([1.0 - share] + [2.0] * LAGS)
        # A covariance that nobody has measured may be as large as the variance.
        doubt = 2.0 * np.sqrt(np.sum(self._counts == 0)) if variance > 0.0 else np.inf
        share_error = float(np.sqrt(weights @ scatter @ weights)) / max(variance, TINY)
        return TrackNoise(
            np.sqrt(covariances[0]),
            np.sqrt(white),
            np.sqrt(np.maximum(lasting, 0.0)),
            correlation,
            share,
            float(np.hypot(share_error, doubt)),
            max(1.0, self._squared / max(self.frames, 1) / MEDIAN),
            1.0 - self._matched / self._moved if self._moved else 0.0,
        )


@dataclass(frozen=True, eq=False)
class _Tracks:
    """Recent residuals of M tracks, the newest first, NaN where there is none, and what each has added to the sums."""

    residuals: FloatArray  # (M, LAGS + 1, 3), px
    sums: FloatArray  # (M, LAGS + 1): products of residuals, u and v together

    @classmethod
    def none(cls, count: int) -> _Tracks:
        return cls(np.full((count, _LAGS, 3), np.nan), np.zeros((count, _LAGS)))


def _at_one_frame(residuals: FloatArray, by_first: FloatArray) -> FloatArray:
    """Products (M, 3) of the two newest residuals, the mean of both taken to the image of one of the two frames.

    A disparity that is off moves the pixel where the point is expected next. Taken to one image, white noise takes back
    in a frame exactly what it gave in the one before, however the camera moves.
    """
    products = np.full((len(residuals), 3), np.nan)
    both = np.isfinite(residuals[:, :2]).all(axis=(1, 2))
    (now, before), A = residuals[both, :2].transpose(1, 0, 2), by_first[both]
    taken_on = np.einsum("mij,mj->mi", A, before)
    taken_back = np.linalg.solve(A, now[:, :, None])[:, :, 0]
    products[both] = 0.5 * (now * taken_on + taken_back * before)
    return products


def _fitted(camera: StereoCamera, first: FloatArray, second: FloatArray, step: Step) -> Step | None:
    """The step that fits the tracks near it best, by least squares with equal weights; None where none is found."""
    near = np.ones(len(first), dtype=np.bool_)
    for k in range(_PASSES):
        expected = transfer(camera, first, step)
        residuals = second - expected.uvd
        if k < _CHOOSING:
            near[:] = np.isfinite(residuals).all(axis=1)
            if near.any():
                size = np.abs(residuals)
                near[:] = (size <= OUTLIER / 2.0 * (1.4826 * np.median(size[near], axis=0) + TINY)).all(axis=1)
        if near.sum() < MIN_POINTS:
            return None
        H = expected.by_step[near].reshape(-1, 6)
        delta = np.asarray(np.linalg.lstsq(H.T @ H, H.T @ residuals[near].ravel(), rcond=None)[0], dtype=np.float64)
        step = step.moved(delta)
        if np.abs(delta).max() < _CONVERGED:
            return step
    return None


def track_noise(recording: Recording) -> TrackNoise:
    """Noise of the tracks of a recording, by robust motions between its frames."""
    statistics = TrackStatistics(recording.camera)
    steps = camera_steps(recording.camera, recording.frames)
    for (before, now), step_found in zip(pairwise(recording.frames), steps, strict=True):
        statistics.add(before.observation, now.observation, None if step_found is None else step_found.step)
    return statistics.noise


def with_measured_noise(recording: Recording, offset_sigma: float = 0.0) -> Recording:
    """The recording with what its tracks say of their noise: `ColouredNoise`, with the R that it had.

    Measurements that bring a covariance of their own keep it as the white part and drift by a share of it. The white
    part of others goes from R, or what residuals show where that is more, where errors are white or little is known, to
    what `TrackNoise` says, where they are known to last. What lasts is an error of each landmark, as large as the part
    of the residuals that is not white makes it, and as R where nothing is known. The rig of a simulation is as stated;
    that of anybody else has the errors of the constants above, and its tracks have a part in common that no residual
    shows. A roll of the right camera is looked for only where measurements bring a covariance: tracks that slide over
    the ground ahead look like one. `offset_sigma`, px, is that of a disparity offset that is already corrected, where
    it is less known than usual.
    """
    found = track_noise(recording)
    if found.is_rough:
        _log.warning(
            "%s: its tracks jump by %.1f px from frame to frame beside the camera's motion; with more than %.0f px "
            "covariances were too small up to a hundredfold: look at its matches",
            recording.name,
            np.max(found.step[:2]),
            ROUGH,
        )
    elif found.mismatched > MISMATCHED:
        _log.warning(
            "%s: %.0f %% of the steps of its tracks are far from what the camera's motion says: wrong matches, or "
            "things that move; look at its matches",
            recording.name,
            100.0 * found.mismatched,
        )
    stranger = recording.truth_from.kind != "simulation"
    noise = stated_noise(found, recording.noise, bring_R(recording), stranger)
    noise = dataclasses.replace(noise, disparity_offset=max(noise.disparity_offset, offset_sigma))
    _log.info("%s: %s", recording.name, noise)
    return dataclasses.replace(_with_claims_raised(recording, found.claimed_too_small), noise=noise)


def bring_R(recording: Recording) -> bool:
    """Whether all measurements bring a covariance of their own."""
    return all(frame.observation.R is not None for frame in recording.frames)


def stated_noise(found: TrackNoise, R: StereoNoise, brings_R: bool, stranger: bool) -> ColouredNoise:
    """Measure the noise of tracks, where `R` was assumed for white noise; see `with_measured_noise`."""
    if brings_R:
        noise = ColouredNoise(R.R, drift=LandmarkDrift(share=DRIFT_SHARE))
    else:
        of_pixels = StereoNoise.independent_pixels(1.0).R
        step, white = (float(np.mean(sigma[:2] ** 2)) for sigma in (found.step, found.white))
        slid = max(step - 2.0 * white, 0.0)  # white errors leave nothing but rounding
        # By what lasts over many frames alone, tracks that slide a little were put down to the right camera, with a
        # white part that small; by the part of a step that is not white alone, white noise on top cost 0.8 nats.
        known_share = float(np.sqrt(found.known_to_last * slid / max(step, TINY)))
        raised = max(1.0, 0.5 * step / float(np.mean(np.diag(R.R)[:2])))  # a residual has the errors of two frames
        gate = np.minimum(GATE * np.sqrt(known_share) * found.step, found.lasting)
        noise = ColouredNoise(
            R.R,
            (1.0 - known_share) * raised * R.R + known_share * (white + WHITE**2 * slid) * of_pixels,
            LandmarkDrift(DRIFT_SHARE * found.ignorance, tuple(found.lasting.tolist()), tuple(gate.tolist())),
            lasting_time=LASTING_TIME,
            lasting=LASTING**2 * slid * of_pixels + (DRIFT_SHARE * found.ignorance) ** 2 * R.R,
        )
    if not stranger:
        return noise
    return dataclasses.replace(
        noise,
        gauge_walk=COMMON_WALK_WITH_R if brings_R else COMMON_WALK,
        misalignment=MISALIGNMENT,
        disparity_offset=DISPARITY_OFFSET,
        right_yaw=RIGHT_TURN,
        right_roll=RIGHT_TURN if brings_R else 0.0,
        scale=SCALE,
    )


def _with_claims_raised(recording: Recording, factor: float) -> Recording:
    """The recording with the covariances that its measurements bring times a factor."""
    if factor == 1.0:
        return recording
    observations = [frame.observation for frame in recording.frames]
    return recording.with_observations(
        observation if observation.R is None else dataclasses.replace(observation, R=factor * observation.R)
        for observation in observations
    )
