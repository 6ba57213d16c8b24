"""Camera motion between two stereo frames, from measurements of the same landmarks in both.

A step is the pose (R, t) of the camera of the second frame in that of the first: p_1 = R p_2 + t. Its error is six
numbers: t (frame of the first camera, m), then the rotation on the right of R (rad).

With w = d / (f b), the point of a measurement is ray(u, v) / w, so its measurement in the second frame is the
projection of R^T (ray - w t) at the scale w: no point is ever formed, and d <= 0 is nothing special.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from filters import StereoCamera, StereoNoise, StereoObservation
from filters.checks.consistency import chi_square_quantile
from filters.contract.noise import gate_limit
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray

MAX_ITERATIONS = 10
CONVERGED = 1e-9  # m and rad
RANSAC_SEED = 0
RANSAC_ROUNDS = 200
RANSAC_CONFIDENCE = 0.999
RANSAC_GATE = 0.99  # probability with which the pixel of an inlier lies within RANSAC's radius


@dataclass(frozen=True, eq=False)
class Step:
    """Pose of the second camera in the first: R (3, 3), t (3,) m."""

    R: FloatArray
    t: FloatArray

    def moved(self, delta: FloatArray) -> Step:
        """Corrected by an error (6,)."""
        return Step(self.R @ rotations.exp(delta[3:]), self.t + delta[:3])


@dataclass(frozen=True, eq=False)
class Transfer:
    """Measurements of the first frame as the second should see them."""

    uvd: FloatArray  # (M, 3): predicted, px
    by_step: FloatArray  # (M, 3, 6): derivatives by the error of the step
    by_first: FloatArray  # (M, 3, 3): derivatives by the measurement in the first frame
    in_front: BoolArray  # (M,): whether the ray points forward in the second camera


def transfer(camera: StereoCamera, uvd: FloatArray, step: Step) -> Transfer:
    """Predict the second frame's measurements from the first's, (M, 3) px."""
    w, h, J, predicted = _carried(camera, uvd, step)
    by_step = np.empty((len(uvd), 3, 6))
    by_step[:, :, :3] = -w[:, None, None] * (J[:, :, :3] @ step.R.T)
    by_step[:, :, 3:] = J[:, :, :3] @ rotations.skew(h)
    return Transfer(predicted, by_step, _by_first(camera, J, step), h[:, 2] > 0)


def _carried(
    camera: StereoCamera, uvd: FloatArray, step: Step
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Scales (M,), directions in the second camera (M, 3), derivatives by both (M, 3, 4), and (u, v, d) there."""
    w = uvd[:, 2] / camera.disparity_constant
    h = (camera.ray(uvd) - w[:, None] * step.t) @ step.R
    return w, h, camera.project_scaled_jacobian(h, w), camera.project_scaled(h, w)


def _by_first(camera: StereoCamera, J: FloatArray, step: Step) -> FloatArray:
    """Derivatives (M, 3, 3) by the measurement in the first frame."""
    by_uvd = np.zeros((4, 3))
    by_uvd[:3, 0] = step.R[0] / camera.fx
    by_uvd[:3, 1] = step.R[1] / camera.fy
    by_uvd[:3, 2] = -step.R.T @ step.t / camera.disparity_constant
    by_uvd[3, 2] = 1.0 / camera.disparity_constant
    return np.asarray(J @ by_uvd)


@dataclass(frozen=True, eq=False)
class Pairs:
    """M landmarks measured in both frames: uvd (M, 3) px and R (M, 3, 3) px^2 of each."""

    first: FloatArray
    second: FloatArray
    R_first: FloatArray
    R_second: FloatArray

    @classmethod
    def between(cls, first: StereoObservation, second: StereoObservation, noise: StereoNoise) -> Pairs:
        """Measurements of points in both observations; `noise` where they bring no R of their own."""
        _, i, j = np.intersect1d(first.ids, second.ids, assume_unique=True, return_indices=True)
        R_first, R_second = first.covariances(noise)[i], second.covariances(noise)[j]
        return cls(first.uvd[i], second.uvd[j], R_first, R_second)

    def select(self, index: IntArray | BoolArray) -> Pairs:
        """Pairs at `index`."""
        return Pairs(self.first[index], self.second[index], self.R_first[index], self.R_second[index])

    def __len__(self) -> int:
        return len(self.first)


@dataclass(frozen=True, eq=False)
class StepEstimate:
    """An estimated step, as a linear function of the noise: its error is -sum K_i (n_second,i - A_i n_first,i)."""

    step: Step  # the estimate
    gain: FloatArray  # (M, 6, 3): K of each pair
    by_first: FloatArray  # (M, 3, 3): A of each pair
    covariance: FloatArray  # (6, 6): of the error, for measurements that are independent of each other
    nis: float = 0.0  # squared normalised residuals, chi-square with `nis_dof`; 0 where the estimator does not say
    nis_dof: int = 0  # 3 M - 6


def squared_distances(camera: StereoCamera, pairs: Pairs, step: Step) -> FloatArray:
    """Squared Mahalanobis distance of each pair from the step, chi-square with 3; infinite behind the camera."""
    _, h, J, predicted = _carried(camera, pairs.first, step)
    S = _innovation_covariances(pairs, _by_first(camera, J, step))
    nu = pairs.second - predicted
    distances = np.einsum("mi,mi->m", nu, _solved(S, nu))
    return np.where((h[:, 2] > 0) & np.isfinite(distances), distances, np.inf)


def most_likely_step(
    camera: StereoCamera, pairs: Pairs, start: Step, *, converged: float = CONVERGED
) -> StepEstimate | None:
    """The step of greatest likelihood, with the noise of both frames (Gauss-Newton on the step and the pairs).

    The true measurements of the first frame are unknowns too, eliminated pair by pair. Jacobians are taken at their
    estimates: at the noisy measurements themselves the step would be biased, and the bias of every step adds up.

    It starts near the motion, with `start`, and ends with a correction smaller than `converged`, m and rad. None where
    the pairs do not determine the step.
    """
    step, true_first = start, pairs.first
    for _ in range(MAX_ITERATIONS):
        predicted = transfer(camera, true_first, step)
        if not predicted.in_front.all():
            return None
        A, H = predicted.by_first, predicted.by_step
        S = _innovation_covariances(pairs, A)
        nu = pairs.second - predicted.uvd - _times(A, pairs.first - true_first)
        weighted = np.linalg.solve(S, H)
        try:
            factor = cho_factor(np.einsum("mij,mik->jk", H, weighted))
        except LinAlgError:
            return None
        delta = cho_solve(factor, np.einsum("mij,mi->j", weighted, nu))
        residuals = nu - H @ delta
        true_first = pairs.first + _times(pairs.R_first, _times(A.transpose(0, 2, 1), _solved(S, residuals)))
        step = step.moved(delta)
        if np.abs(delta).max() < converged:
            break
    covariance = cho_solve(factor, np.eye(6))
    nis = float(np.einsum("mi,mi->", residuals, _solved(S, residuals)))
    gain = covariance @ weighted.transpose(0, 2, 1)
    return StepEstimate(step, gain, A, covariance, nis, 3 * len(pairs) - 6)


def left_pixel_step(camera: StereoCamera, pairs: Pairs, step: Step) -> StepEstimate | None:
    """The covariance of a step that minimises the sum of squared left-pixel distances in the second frame.

    Such an estimator does not weigh its measurements by their noise; to first order its error is still linear in it.
    """
    predicted = transfer(camera, pairs.first, step)
    H = predicted.by_step[:, :2]
    try:
        factor = cho_factor(np.einsum("mij,mik->jk", H, H))
    except LinAlgError:
        return None
    gain = np.zeros((len(pairs), 6, 3))
    gain[:, :, :2] = cho_solve(factor, np.eye(6)) @ H.transpose(0, 2, 1)
    S = _innovation_covariances(pairs, predicted.by_first)
    covariance = np.einsum("mij,mjk,mlk->il", gain, S, gain, optimize=True)
    return StepEstimate(step, gain, predicted.by_first, covariance)


def perspective_n_point(
    camera: StereoCamera, pairs: Pairs, min_points: int, *, polished: bool = False
) -> tuple[Step, IntArray] | None:
    """OpenCV's PnP with RANSAC: points of the first frame, pixels of the second; needs no idea of the step.

    All disparities have to be positive. With `polished`, `cv2.solvePnPRefineLM` refines the step on the inliers.
    Returns the step and the ascending positions (K,) of the inliers, or None with fewer than `min_points` of them.
    """
    K = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    points, pixels = camera.backproject(pairs.first), np.ascontiguousarray(pairs.second[:, :2])
    # The error of a pixel in this frame and, through the point, that of about the same size in the previous one.
    variance = 2.0 * np.median(pairs.R_second[:, [0, 1], [0, 1]].max(axis=1))
    radius = float(np.sqrt(chi_square_quantile(RANSAC_GATE, 2) * variance))
    cv2.setRNGSeed(RANSAC_SEED)
    is_solved, turn, shift, inliers = cv2.solvePnPRansac(
        points,
        pixels,
        K,
        None,
        iterationsCount=RANSAC_ROUNDS,
        reprojectionError=radius,
        confidence=RANSAC_CONFIDENCE,
    )
    if not is_solved or inliers is None or len(inliers) < min_points:
        return None
    inlier_rows = np.sort(inliers.reshape(-1)).astype(np.int64)
    if polished:
        turn, shift = cv2.solvePnPRefineLM(points[inlier_rows], pixels[inlier_rows], K, None, turn, shift)
    if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
        return None
    R = rotations.exp(np.asarray(turn, dtype=np.float64).reshape(3)).T  # OpenCV takes points into the camera
    return Step(R, -R @ np.asarray(shift, dtype=np.float64).reshape(3)), inlier_rows


def _innovation_covariances(pairs: Pairs, by_first: FloatArray) -> FloatArray:
    """R of the second frame plus that of the first, carried over."""
    S: FloatArray = pairs.R_second + by_first @ pairs.R_first @ by_first.transpose(0, 2, 1)
    return S


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    product: FloatArray = (matrices @ vectors[:, :, None])[:, :, 0]
    return product


def _solved(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(matrices, vectors[:, :, None])[:, :, 0], dtype=np.float64)


MIN_POINTS = 8
_ROUNDS = 10
_CONVERGED = 1e-5  # m and rad: a thousandth of a pixel at most
_MEDIAN_FACTOR = 4.0  # the median of chi-square with 3 degrees of freedom is 2.4: a pair beyond 9.5 is none of ours
_TRUSTED_SHARE = 0.85  # with fewer inliers the start may have been wrong, or near to the motion of a slow body


@dataclass(frozen=True, eq=False)
class RobustStep:
    """A step and the pairs that agree with it."""

    estimate: StepEstimate  # from the inliers
    inliers: BoolArray  # (M,): within the gate

    @property
    def step(self) -> Step:
        """Motion between the two observations."""
        return self.estimate.step


def robust_step(camera: StereoCamera, pairs: Pairs, start: Step | None, *, gate: float = 0.99) -> RobustStep | None:
    """The most likely step of the largest consistent part of `pairs`.

    From `start` the gate closes in with the median distance; where that leaves less than 85 % of the pairs, or there
    is no start, PnP with RANSAC gives another one, and the larger consensus wins. A consistent pair is an inlier with
    the probability `gate`. None where fewer than `MIN_POINTS` pairs agree.
    """
    if len(pairs) < MIN_POINTS:
        return None
    fit = None if start is None else _closing_in(camera, pairs, start, gate)
    if fit is None or fit.inliers.sum() < _TRUSTED_SHARE * len(pairs):
        near = np.flatnonzero(pairs.first[:, 2] > 1.0)
        ransac = perspective_n_point(camera, pairs.select(near), MIN_POINTS) if len(near) >= MIN_POINTS else None
        other = None if ransac is None else _closing_in(camera, pairs, ransac[0], gate)
        if other is not None and (fit is None or other.inliers.sum() > fit.inliers.sum()):
            return other
    return fit


def _closing_in(camera: StereoCamera, pairs: Pairs, step: Step, gate: float) -> RobustStep | None:
    limit = gate_limit(gate, 3)
    inliers_chosen: BoolArray | None = None
    estimate: StepEstimate | None = None
    distances = squared_distances(camera, pairs, step)
    for _ in range(_ROUNDS):
        inliers = distances <= max(limit, _MEDIAN_FACTOR * float(np.median(distances)))
        inliers &= np.isfinite(distances)
        if inliers.sum() < MIN_POINTS:
            return None
        if inliers_chosen is not None and np.array_equal(inliers_chosen, inliers):
            break
        inliers_chosen = inliers
        estimate = most_likely_step(camera, pairs.select(inliers_chosen), step, converged=_CONVERGED)
        if estimate is None:
            return None
        step = estimate.step
        distances = squared_distances(camera, pairs, step)
    assert estimate is not None
    return RobustStep(estimate, distances <= limit)


def continued(step: Step, ratio: float) -> Step:
    """The step of constant velocity over `ratio` times the time."""
    return Step(rotations.exp(ratio * rotations.log(step.R)), ratio * step.t)


def chained(first: Step, second: Step) -> Step:
    """The step from before `first` to after `second`."""
    return Step(first.R @ second.R, first.t + first.R @ second.t)


def predicted(
    camera: StereoCamera, uvd: FloatArray, R: FloatArray, step: Step, step_covariance: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Measurements (N, 3) with covariances (N, 3, 3), px, carried over by a step whose error has a covariance (6, 6).

    Returns uvd, their covariances, without the noise of the next measurement, and which are in front of the camera.
    """
    moved = transfer(camera, uvd, step)
    covariances = moved.by_first @ R @ moved.by_first.transpose(0, 2, 1)
    covariances = covariances + moved.by_step @ step_covariance @ moved.by_step.transpose(0, 2, 1)
    return moved.uvd, covariances, moved.in_front
