"""Tracker of landmarks through stereo pairs by active search (section 4.2 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from filters import Forecast, StereoCamera, StereoObservation
from filters.checks.consistency import chi_square_quantile
from filters.contract.noise import gate_limit
from filters.contract.validation import positive
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.ego_motion import (
    MIN_POINTS,
    Pairs,
    RobustStep,
    Step,
    chained,
    continued,
    predicted,
    robust_step,
    squared_distances,
)
from stereo_slam_env.frontend.finding import Found, PairFinder
from stereo_slam_env.frontend.patches import SUPPORT, cut_patches
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import (
    BODY_SIZE,
    MEMORY,
    Expectation,
    Outcome,
    Search,
    TrackedPair,
    Tracks,
    beside_moving,
    by_forecast,
    by_motion,
    constant_velocity_covariance,
    new_tracks,
    nothing_searched,
    require_legal,
    require_pair,
    step_of_forecast,
    sure_rows,
)
from stereo_slam_env.recording.recording import GreyImage

STRIKES = 2
"""Pairs in a row in which a landmark must move unlike the scene."""
NEIGHBOURS = 2
"""Others on the same body that must move alike."""
_ALIKE = chi_square_quantile(0.99, 3)


def moving_together(
    camera: StereoCamera, before: FloatArray, now: FloatArray, R_before: FloatArray, R_now: FloatArray, step: Step
) -> BoolArray:
    """Mask (N,) of landmarks which disagree with the scene and move like at least `NEIGHBOURS` others beside them.

    `before` and `now` are their (u, v, d) (N, 3) px, d > 0, in both pairs, with covariances (N, 3, 3) px^2, and `step`
    is the motion of the camera.
    """
    if len(now) <= NEIGHBOURS:
        return np.zeros(len(now), dtype=bool)
    p_now = camera.backproject(now)
    p_stayed = (camera.backproject(before) - step.t) @ step.R
    displacement = p_now - p_stayed
    covariance = _point_covariances(camera, p_now, R_now) + _point_covariances(camera, p_stayed, R_before)
    beside = np.linalg.norm(p_now[:, None] - p_now[None], axis=2) < BODY_SIZE + 3.0 * _depth_sigma(covariance)
    difference = displacement[:, None] - displacement[None]
    both = covariance[:, None] + covariance[None]
    distance = np.einsum("ijk,ijk->ij", difference, np.linalg.solve(both, difference[..., None])[..., 0])
    alike = beside & (distance < _ALIKE)
    return np.asarray(alike.sum(axis=1) - 1 >= NEIGHBOURS)


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
        rows = np.flatnonzero(matched & np.isfinite(measured[:, back, 0]))
        pairs = Pairs(measured[rows, back], measured[rows, 0], measured_R[rows, back], measured_R[rows, 0])
        off = squared_distances(camera, pairs, over) > limit
        unlike[rows] |= off
        off &= (pairs.first[:, 2] > 0) & (pairs.second[:, 2] > 0)
        moved = pairs.select(off)
        together[rows[off]] |= moving_together(camera, moved.first, moved.second, moved.R_first, moved.R_second, over)
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


Measured = tuple[IntArray, FloatArray, FloatArray]
_REST = Step(np.eye(3), np.zeros(3))
_SCOUTS = 24
"""So many landmarks are searched for first; what they tell about the motion makes the other ellipses small."""
_SCOUTED = np.diag(np.repeat([0.02, 0.0007], 3) ** 2)
"""What the motion found by the scouts may still be off by, m and rad: covariance."""
_CARRIED = np.diag(np.repeat([0.02, 0.002], 3) ** 2)
"""The same for the motion that a missed landmark is carried over by."""
_LOST_SHARE = 0.3
"""With fewer of the expected landmarks found, the expectation was wrong: optical flow gives another one."""
_JUDGED = 3
"""So many pairs back a measurement is compared with the motion: slow bodies need some time to be told."""
_GIVE_UP_STRIKES = 4
_MODELLED = (1e-3, 10.0)
"""The model of the motion is asked about times within this, s: velocities from shorter ones are all noise, and it says
nothing about longer ones."""
_SPARE = 1.4
"""Landmarks followed for each one that the filter may have: some are not found in a pair."""


class StereoTracker:
    """Active search for patches, each measurement with a covariance of its own (section 4.2 of the paper).

    New landmarks are corners, matched along the row. In later pairs each is searched for where the filter (or, without
    one, the motion so far) expects it: its patch is warped to the expected view and correlated inside the innovation
    ellipse of the left image, then what was found is matched along the row of the right one. A few landmarks go
    first; what they tell about the motion narrows the ellipses of the others. A landmark outside either image, or
    missed too often, is dropped; so is one that moves unlike the scene.

    Parameters
    ----------
    camera : StereoCamera
        The rectified rig.
    settings : TrackerSettings, optional
        See there.
    """

    def __init__(self, camera: StereoCamera, settings: TrackerSettings | None = None) -> None:
        self.camera = camera
        self.settings = TrackerSettings() if settings is None else settings
        self.reset()

    def reset(self) -> None:
        """Forget everything; ids begin at 0 again."""
        none, nowhere = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        patches = np.zeros((0, SUPPORT, SUPPORT), dtype=np.float32)
        self._R_vc, self._position_v = np.eye(3), np.zeros(3)
        self._tracks = new_tracks(none, patches, nowhere, np.zeros((0, 3, 3)), self._R_vc, self._position_v)
        self._next_id = 0
        self._steps: list[Step] = []  # newest first
        self._dt = 0.0
        self._left: GreyImage | None = None

    @property
    def last_step(self) -> tuple[Step, float] | None:
        """Motion of the camera between the last two pairs, and the time between them, s; None before."""
        return (self._steps[0], self._dt) if self._steps else None

    def longest_pairs(self) -> tuple[Pairs, Step] | None:
        """Standing landmarks measured now and `MEMORY` - 1 pairs ago, and the motion in between; None before."""
        tracks = self._tracks
        both = np.isfinite(tracks.measured[:, [0, -1], 0]).all(axis=1) & ~tracks.moving
        if len(self._steps) < MEMORY - 1:
            return None
        over = _REST
        for step in self._steps:
            over = chained(step, over)
        measured, R = tracks.measured[both], tracks.measured_R[both]
        return Pairs(measured[:, -1], measured[:, 0], R[:, -1], R[:, 0]), over

    def track(
        self, left: GreyImage, right: GreyImage, dt: float | None = None, forecast: Forecast | None = None
    ) -> TrackedPair:
        """Follow the landmarks to the next pair and find new ones.

        Parameters
        ----------
        left, right : (H, W) uint8
            The pair, rectified, grey.
        dt : float, optional
            Time since the previous pair, s; needed from the second pair on.
        forecast : Forecast, optional
            Where a filter expects its landmarks after `predict`; None: where the motion so far leads.

        Raises
        ------
        ValueError
            An image has the wrong size or type, `dt` is missing or not positive, or `forecast` is none that a filter
            may give; nothing has changed then.
        """
        require_pair(self.camera, left, right)
        if forecast is not None:
            require_legal(forecast)
        first = self._left is None
        finder = PairFinder(self.camera, self.settings, left, right)
        if first:
            followed, searched, dropped = self._tracks, nothing_searched(), np.zeros(0, dtype=np.int64)
        elif dt is None:
            raise ValueError("dt must be given from the second pair on, got None")
        else:
            followed, searched, dropped = self._follow(finder, positive("dt", dt), forecast)
        fresh = self._new_corners(finder, followed)
        corners = StereoObservation(fresh.ids, fresh.uvd, R=fresh.R)
        measured, tracks, initialised = self._release(followed.joined(fresh))
        self._tracks, self._left = tracks, left.copy()  # a camera may write its next image over this one
        return TrackedPair(*measured, searched, corners, initialised, dropped)

    def _follow(self, finder: PairFinder, dt: float, forecast: Forecast | None) -> tuple[Tracks, Search, IntArray]:
        tracks = self._tracks.next_pair()
        expected, matches, motion = self._searched(finder, tracks, self._expected(finder, tracks, dt, forecast))
        if matches.matched.sum() < max(MIN_POINTS, _LOST_SHARE * expected.in_view.sum()):
            flow = self._flow_step(finder, tracks)
            if flow is not None:
                again = self._by_motion(tracks, flow, self._unsure_by(dt))
                expected, matches, motion = self._searched(finder, tracks, again)
        self._moved(expected.step if motion is None else motion.step, dt)
        tracks, outcome = judged(
            self.camera, tracks, matches, [] if motion is None else self._steps[:_JUDGED], self.settings.gate
        )
        searched = Search(tracks.ids, expected.uvd, expected.S, matches.uvd, outcome)
        tracks = self._carried(tracks, matches)
        remaining = self._kept(tracks, outcome)
        leaving = tracks.released & ~remaining
        if not self.settings.movers:  # one that moves has left when it was found to
            leaving = (leaving | (tracks.released & tracks.moving)) & ~self._tracks.moving
        return tracks.select(remaining), searched, tracks.ids[leaving]

    def _expected(self, finder: PairFinder, tracks: Tracks, dt: float, forecast: Forecast | None) -> Expectation:
        """Predict by the filter's forecast, else by constant velocity, else by optical flow."""
        step = None
        if forecast is not None:
            rows = sure_rows(tracks, forecast, self.settings)
            step = step_of_forecast(self.camera, tracks, forecast, rows)
        if step is None and self._steps:
            step = continued(self._steps[0], _modelled(dt) / _modelled(self._dt))
        if step is None:
            step = self._flow_step(finder, tracks) or _REST
        expected = self._by_motion(tracks, step, self._unsure_by(dt))
        if forecast is None:
            return expected
        return by_forecast(self.camera, tracks, expected, forecast, rows, self.settings)

    def _unsure_by(self, dt: float) -> FloatArray:
        return constant_velocity_covariance(self.settings, _modelled(dt))

    def _by_motion(self, tracks: Tracks, step: Step, step_covariance: FloatArray) -> Expectation:
        last = self._steps[0] if self._steps else None
        return by_motion(self.camera, tracks, step, step_covariance, last, self.settings.margin)

    def _flow_step(self, finder: PairFinder, tracks: Tracks) -> Step | None:
        """The motion from optical flow, for pairs that no motion so far explains."""
        rows = np.flatnonzero((tracks.misses == 0) & ~tracks.moving)
        if len(rows) < MIN_POINTS or self._left is None:
            return None
        before = tracks.uvd[rows]
        start = before[:, None, :2].astype(np.float32)
        uv, status, _ = cv2.calcOpticalFlowPyrLK(
            self._left, finder.left, start, np.empty_like(start), winSize=(21, 21), maxLevel=4
        )
        uv = np.asarray(uv, dtype=np.float64)[:, 0]
        tracked = (np.asarray(status)[:, 0] > 0) & finder.inside(uv)
        rows, uv, before = rows[tracked], uv[tracked], before[tracked]
        d = before[:, 2]
        disparity, variance, accepted = finder.disparities(uv, 0.5 * d - 2.0, 2.0 * d + 4.0)
        if accepted.sum() < MIN_POINTS:
            return None
        now = np.column_stack([uv, disparity])[accepted]
        R = np.tile(np.diag([0.25, 0.25, 0.0]), (len(now), 1, 1))
        R[:, 2, 2] = 0.25 + variance[accepted]
        motion = robust_step(self.camera, Pairs(before[accepted], now, tracks.R[rows[accepted]], R), None)
        return None if motion is None else motion.step

    def _searched(
        self, finder: PairFinder, tracks: Tracks, expected: Expectation
    ) -> tuple[Expectation, Found, RobustStep | None]:
        """The scouts first, then the others where the motion of the scouts leads; and the motion of all."""
        scouts = _scouts(tracks, expected)
        matches = self._find(finder, tracks, expected, scouts)
        motion = self._motion(tracks, matches, expected.step)
        guided = ~scouts
        if motion is not None:
            covariance = motion.estimate.covariance + _SCOUTED
            narrowed = self._by_motion(tracks, motion.step, covariance)
            expected = expected.merged(narrowed, guided)
        matches = matches.merged(self._find(finder, tracks, expected, guided), guided)
        return expected, matches, self._motion(tracks, matches, expected.step if motion is None else motion.step)

    def _find(self, finder: PairFinder, tracks: Tracks, expected: Expectation, which: BoolArray) -> Found:
        R_vn = self._R_vc @ expected.step.R
        return finder.find(tracks, expected, R_vn, self._position_v + self._R_vc @ expected.step.t, which)

    def _motion(self, tracks: Tracks, found: Found, start: Step) -> RobustStep | None:
        usable = found.matched & (tracks.misses == 0) & ~tracks.moving
        if usable.sum() < MIN_POINTS:
            return None
        pairs = Pairs(tracks.uvd[usable], found.uvd[usable], tracks.R[usable], found.R[usable])
        return robust_step(self.camera, pairs, start)

    def _moved(self, step: Step, dt: float) -> None:
        self._position_v = self._position_v + self._R_vc @ step.t
        self._R_vc = self._R_vc @ step.R
        self._steps = [step, *self._steps][: MEMORY - 1]
        self._dt = dt

    def _carried(self, tracks: Tracks, found: Found) -> Tracks:
        """Last measured image of each landmark, or the one before carried over by the motion."""
        uvd, R, _ = predicted(self.camera, tracks.uvd, tracks.R, self._steps[0], _CARRIED)
        matched = found.matched
        return replace(
            tracks,
            uvd=np.where(matched[:, None], found.uvd, uvd),
            R=np.where(matched[:, None, None], found.R, R),
        )

    def _kept(self, tracks: Tracks, outcome: IntArray) -> BoolArray:
        standing = ~tracks.moving
        leaving = (outcome == Outcome.OUT_OF_VIEW) | (tracks.misses > self.settings.max_misses)
        leaving |= standing & (tracks.strikes >= _GIVE_UP_STRIKES)
        return np.asarray(~leaving)

    def _new_corners(self, finder: PairFinder, tracks: Tracks) -> Tracks:
        """Corners where too few landmarks stand, off the bodies that move; where movers are wanted, on these, too."""
        moving, standing = tracks.uvd[tracks.moving], int((~tracks.moving).sum())
        uvd, R = np.zeros((0, 3)), np.zeros((0, 3, 3))
        if standing < _SPARE * self.settings.refill_below:
            uvd, R = finder.corners(round(_SPARE * self.settings.max_landmarks) - standing, tracks.uvd[:, :2])
            clear = ~beside_moving(self.camera, uvd, moving) | self.settings.movers
            uvd, R = uvd[clear], R[clear]
        if self.settings.movers and len(moving):
            more, R_more = finder.corners(self.settings.max_landmarks, np.concatenate([tracks.uvd, uvd])[:, :2])
            on_body = beside_moving(self.camera, more, moving)
            uvd, R = np.concatenate([uvd, more[on_body]]), np.concatenate([R, R_more[on_body]])
        if len(uvd) == 0:
            return tracks.select(slice(0))
        ids = self._next_id + np.arange(len(uvd), dtype=np.int64)
        self._next_id += len(uvd)
        patches = cut_patches(finder.left, uvd[:, :2])
        return new_tracks(ids, patches, uvd, R, self._R_vc, self._position_v)

    def _release(self, tracks: Tracks) -> tuple[Measured, Tracks, IntArray]:
        """Ids, (u, v, d), R for the filter, of landmarks found in this pair: those that move like the scene, or all."""
        has_match = np.isfinite(tracks.measured[:, 0, 0])
        candidates = np.flatnonzero(has_match & ~tracks.moving & (tracks.strikes == 0))
        if len(candidates) > self.settings.max_landmarks:
            order = np.argsort(~tracks.released[candidates], kind="stable")  # those the filter has, then by id
            candidates = np.sort(candidates[order[: self.settings.max_landmarks]])
        if self.settings.movers:
            candidates = np.union1d(candidates, np.flatnonzero(has_match & tracks.moving))
        initialised = tracks.ids[candidates[~tracks.released[candidates]]]
        released = tracks.released.copy()
        released[candidates] = True
        measured = tracks.ids[candidates], tracks.measured[candidates, 0], tracks.measured_R[candidates, 0]
        return measured, replace(tracks, released=released), initialised


def _scouts(tracks: Tracks, expected: Expectation) -> BoolArray:
    """Landmarks to search for first: standing, followed for long, from all over the range of disparities."""
    fit = np.flatnonzero(expected.in_view & ~tracks.moving & (tracks.misses == 0) & (tracks.strikes == 0))
    oldest = fit[np.argsort(-tracks.age[fit], kind="stable")[: 2 * _SCOUTS]]
    near_to_far = oldest[np.argsort(tracks.uvd[oldest, 2], kind="stable")]
    is_scout = np.zeros(len(tracks), dtype=bool)
    is_scout[near_to_far[:: max(1, len(near_to_far) // _SCOUTS)]] = True
    return is_scout


def _modelled(dt: float) -> float:
    return min(max(dt, _MODELLED[0]), _MODELLED[1])
