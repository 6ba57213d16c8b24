"""Moving-object rejection from the camera motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from filters import StereoCamera
from filters.checks.consistency import chi_square_quantile
from filters.contract.noise import gate_limit
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.ego_motion import Pairs, Step, chained, squared_distances
from stereo_slam_env.frontend.finding import Found
from stereo_slam_env.frontend.tracks import Outcome, Tracks

STRIKES = 2
"""Pairs in a row in which a landmark must move unlike the scene."""
NEIGHBOURS = 2
"""Others on the same body that must move alike."""
_BODY_SIZE = 3.0
"""Landmarks this near to each other, m, may be on one body."""
_ALIKE = chi_square_quantile(0.99, 3)


def moving_together(
    camera: StereoCamera, before: FloatArray, now: FloatArray, R_before: FloatArray, R_now: FloatArray, step: Step
) -> BoolArray:
    """Which of N landmarks that disagree with the scene move like at least `NEIGHBOURS` others beside them; (N,).

    `before` and `now` are their (u, v, d) (N, 3) px, d > 0, in both pairs, with covariances (N, 3, 3) px^2, and `step`
    is the motion of the camera.
    """
    if len(now) <= NEIGHBOURS:
        return np.zeros(len(now), dtype=bool)
    p_now = camera.backproject(now)
    p_stayed = (camera.backproject(before) - step.t) @ step.R
    displacement = p_now - p_stayed
    covariance = _point_covariances(camera, p_now, R_now) + _point_covariances(camera, p_stayed, R_before)
    beside = np.linalg.norm(p_now[:, None] - p_now[None], axis=2) < _BODY_SIZE + 3.0 * _depth_sigma(covariance)
    difference = displacement[:, None] - displacement[None]
    both = covariance[:, None] + covariance[None]
    distance = np.einsum("ijk,ijk->ij", difference, np.linalg.solve(both, difference[..., None])[..., 0])
    alike = beside & (distance < _ALIKE)
    return np.asarray(alike.sum(axis=1) - 1 >= NEIGHBOURS)


def beside_moving(camera: StereoCamera, uvd: FloatArray, moving_uvd: FloatArray) -> BoolArray:
    """Which measurements (N, 3) may lie on the bodies of moving landmarks (M, 3)."""
    if len(moving_uvd) == 0 or len(uvd) == 0:
        return np.zeros(len(uvd), dtype=bool)
    reach = _BODY_SIZE * camera.fx / camera.disparity_constant * moving_uvd[:, 2]  # px at the depth of the body
    apart = np.linalg.norm(uvd[:, None, :2] - moving_uvd[None, :, :2], axis=2)
    depth = camera.disparity_constant / np.maximum(uvd[:, 2], 1e-3)
    body = camera.disparity_constant / np.maximum(moving_uvd[:, 2], 1e-3)
    as_deep = np.abs(depth[:, None] - body[None]) < _BODY_SIZE + 0.1 * body[None]
    return np.asarray(((apart < reach[None]) & as_deep).any(axis=1))


def _point_covariances(camera: StereoCamera, points_c: FloatArray, R: FloatArray) -> FloatArray:
    """Covariances of points whose images have covariance R: first order; (N, 3, 3) m^2."""
    J = np.linalg.inv(camera.project_jacobian(points_c))
    covariances: FloatArray = J @ R @ J.transpose(0, 2, 1)
    return covariances


def _depth_sigma(covariances: FloatArray) -> FloatArray:
    """Depth sigma of the less certain one of each pair of points; (N, N) m."""
    sigma = np.sqrt(covariances[:, 2, 2])
    return np.maximum(sigma[:, None], sigma[None])


def judged(
    camera: StereoCamera, tracks: Tracks, found: Found, steps: Sequence[Step], gate: float
) -> tuple[Tracks, IntArray]:
    """Enter what was found into the tracks, and judge which landmarks do not stand still: an `Outcome` each (N,).

    A slow body differs from the scene over several pairs only, so each measurement is compared with the remembered ones
    over the `steps` of the camera, newest first. A standing landmark passes with the probability `gate`.
    """
    measured, measured_R = tracks.measured.copy(), tracks.measured_R.copy()
    measured[:, 0], measured_R[:, 0] = found.uvd, found.R
    matched = found.matched
    unlike, together = np.zeros(len(tracks), dtype=bool), np.zeros(len(tracks), dtype=bool)
    limit = gate_limit(gate, 3)
    over: Step | None = None
    for back, step in enumerate(steps, start=1):
        over = step if over is None else chained(step, over)
        known = np.flatnonzero(matched & np.isfinite(measured[:, back, 0]))
        pairs = Pairs(measured[known, back], measured[known, 0], measured_R[known, back], measured_R[known, 0])
        off = squared_distances(camera, pairs, over) > limit
        unlike[known] |= off
        off &= (pairs.first[:, 2] > 0) & (pairs.second[:, 2] > 0)
        moved = pairs.select(off)
        together[known[off]] |= moving_together(camera, moved.first, moved.second, moved.R_first, moved.R_second, over)
    strikes = np.where(matched, np.where(unlike, tracks.strikes + 1, 0), tracks.strikes)
    moving = tracks.moving | (together & (strikes >= STRIKES))
    outcome = found.outcome.copy()
    outcome[matched & unlike] = Outcome.INCONSISTENT
    outcome[matched & moving] = Outcome.MOVING
    entered = replace(
        tracks,
        measured=measured,
        measured_R=measured_R,
        age=tracks.age + matched,
        misses=np.where(matched, 0, tracks.misses + 1),
        strikes=strikes,
        moving=moving,
    )
    return entered, outcome
