"""How good any filter could be: the posterior Cramer-Rao bound along the true trajectory.

It is the recursion of `ReferenceBelief` over a recording:

- start covariance of the recording; motion of Eq. 6 with the impulses of `ConstantVelocity`;
- every sighting of the recording with the noise it really has (of the observation, or else of the recording), and
  with the row of the right image where that was measured: a second measurement of v, which not every filter uses;
- a landmark leaves after its last sighting; marginalising what is never measured again loses nothing. One that comes
  back is kept until then, so the bound also holds for filters that recognise places.

**What it bounds.** The mean square error of filters that know this motion model and this noise, on average over noise
and drives drawn from the model. A car accelerates less than the white 3 m/s^2 assumed of it: given such a drive, the
part of the bound that comes from the motion is too large, and an estimator may come out a little better than the bound
(by up to 1 % in position and 8 % in rotation on the reference drive, where landmarks say nearly all there is to say,
see docs/metrics.md). A filter that assumes a smaller acceleration and is right knows more, and has a bound of its own.
Jacobians at one true drive stand for their expectation over drives. With heavy-tailed noise of covariance R it bounds
estimators that know only R.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from filters.landmarks.parametrisation import LandmarkModel
from filters.motion import POSE_SIZE, ConstantVelocity
from filters.validation import BoolArray, FloatArray
from stereo_slam_env.evaluation.reference_belief import ReferenceBelief
from stereo_slam_env.recording.recording import Recording

RESAMPLES = 10_000


@dataclass(frozen=True, eq=False)
class Bound:
    """Lower bound of the error covariance of any unbiased filter, frame by frame.

    Attributes
    ----------
    pose : (K, 6, 6)
        Of position in W, m, and rotation in the camera frame, rad, after the frame's update.
    """

    pose: FloatArray


def efficiency_interval(bounds: FloatArray, errors: FloatArray, confidence: float = 0.95) -> tuple[float, float]:
    """Bootstrap interval of the efficiency over runs, the ratio of both root mean squares, in percent.

    By percentiles, seeded: a ratio of means of squares, which are far from Gaussian, has no useful standard error. With
    ten runs it is a rough one.

    Parameters
    ----------
    bounds, errors : (N,) ndarray
        Bound and root mean square error of each run, in one unit.
    confidence : float
        Of the interval.
    """
    drawn = np.random.default_rng(0).integers(len(bounds), size=(RESAMPLES, len(bounds)))
    ratios = np.sqrt(np.square(bounds)[drawn].sum(axis=1) / np.square(errors)[drawn].sum(axis=1))
    low, high = 100.0 * np.quantile(ratios, [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence])
    return float(low), float(high)


def cramer_rao_bound(
    recording: Recording,
    motion: ConstantVelocity,
    *,
    use_odometry: bool = False,
    right_row: bool = True,
    landmark: LandmarkModel | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Bound | None:
    """Posterior Cramer-Rao bound along the true trajectory of a recording.

    Costs about as much as a filter run.

    Parameters
    ----------
    recording : Recording
        With the true pose in every frame and the true position of every landmark seen.
    motion : ConstantVelocity
        The motion model the estimator knows.
    use_odometry : bool
        Whether the estimator is given the odometry of the recording.
    right_row : bool
        Whether the estimator is given the row of the right image, where it was measured.
    landmark : LandmarkModel, optional
        Parametrisation to calculate in; the result does not depend on it. None: XYZ.
    progress : callable, optional
        Called with (frames done, frames) after each frame.

    Returns
    -------
    Bound or None
        None where the truth is not complete.
    """
    poses = [frame.truth for frame in recording.frames if frame.truth is not None]
    if len(poses) < len(recording) or not poses or not _every_landmark_is_known(recording):
        return None
    start, truth = recording.start, recording.landmarks
    assert truth is not None
    best = ReferenceBelief(
        recording.camera,
        recording.noise,
        motion,
        start,
        poses[0],
        landmark=landmark,
        right_row=right_row,
        use_odometry=use_odometry,
    )
    last_seen = np.full(len(truth.ids), -1)
    for k, frame in enumerate(recording.frames):
        last_seen[np.searchsorted(truth.ids, frame.observation.ids)] = k
    covariances = np.empty((len(recording), POSE_SIZE, POSE_SIZE))
    with threadpool_limits(limits=1):
        for k, frame in enumerate(recording.frames):
            best.step(frame, truth)
            best.keep(truth.ids[last_seen > k])
            covariances[k] = best.pose_covariance
            if progress is not None:
                progress(k + 1, len(recording))
    return Bound(covariances)


def _every_landmark_is_known(recording: Recording) -> bool:
    if recording.landmarks is None:
        return False
    seen = [frame.observation.ids for frame in recording.frames]
    known: BoolArray = np.isin(np.concatenate(seen), recording.landmarks.ids)
    return bool(known.all())
