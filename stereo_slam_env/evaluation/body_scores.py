"""Scores of moving bodies: how far a filter's bodies and its claims of them are from the true ones, frame by frame.

A filter's body is the true one that most of its measured landmarks are on. Which point of it the filter calls the body,
and which axes, is its own choice: its first belief, as seen from the camera, is put before the true camera, and moves
with the true body from there on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters import BodiesBelief, Pose, nees
from filters.contract.outputs import UpdateReport
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.poses import relative_jacobian
from filters.motions.motion_model import POSE_SIZE
from stereo_slam_env.evaluation.results import BodyScores, ContractBroken
from stereo_slam_env.loop import Moment
from stereo_slam_env.recording.body_truth import BodyTruth
from stereo_slam_env.recording.recording import Recording

SETTLED = 1.0
"""Time after birth, or after a body can first be found, from which it is scored, s; movers, after the first frame."""
LEAST_POINTS, SLOWEST, FARTHEST = 4, 0.7, 40.0
"""Measured points, speed (m/s) and distance (m) of true bodies that are to be found."""
_POINTS = ("movers_measured", "movers_as_static")
_BODIES = ("static_measured", "static_on_bodies", "bodies_to_find", "bodies_found")
_ROUNDING = 1e-9
_NONE, _NO_VECTORS = np.zeros(0, np.int64), np.zeros((0, 3))
_NO_ROWS = (*[_NONE] * 4, *[np.zeros(0)] * 4, *[_NO_VECTORS] * 2, np.zeros((0, 3, 3)), _NO_VECTORS)


@dataclass(eq=False)
class _Birth:
    """Birth of a filter's body."""

    time: float
    truth: BodyTruth
    """True bodies then."""
    pose: Pose
    """First belief, put before the true camera; in W."""
    true_body: int | None = None
    """The true one that more than half of its landmarks were on, -1: none; None while none was measured."""
    in_body: Pose = field(default_factory=Pose)
    """`pose` in the axes of the true body."""
    is_lost: bool = False
    """Whether the true body has been taken away since: where it comes back it has not moved to."""

    def decide(self, true_body: int) -> int:
        """Note the true body, or -1; returns it."""
        at = np.flatnonzero(self.truth.ids == true_body)
        if len(at) == 0:
            true_body = -1
        else:
            self.in_body = Pose(self.truth.positions[at[0]], self.truth.orientations[at[0]]).inverse() @ self.pose
        self.true_body = true_body
        return true_body


class BodyScorer:
    """Scores of the bodies of one run, and counts of the points on movers; for recordings that tell the true bodies."""

    def __init__(self, recording: Recording) -> None:
        self._frames = recording.frames
        self._counts = {name: np.zeros(len(recording), np.int64) for name in (*_POINTS, *_BODIES)}
        self._births: dict[int, _Birth] = {}
        self._delays: dict[int, float] = {}
        self._sighted: dict[int, float] = {}  # when a true body first had enough points
        self._findable: dict[int, float] = {}  # when it was first near and fast enough, too
        self._rows: list[tuple[NDArray[Any], ...]] = [_NO_ROWS]
        self._with_bodies = False

    @property
    def counts(self) -> dict[str, IntArray]:
        """Counts by name, (frames,) each; of a filter without bodies those of points on movers alone."""
        return {name: values for name, values in self._counts.items() if self._with_bodies or name in _POINTS}

    @property
    def scores(self) -> BodyScores | None:
        """The scores so far; None of a filter without bodies."""
        if not self._with_bodies:
            return None
        columns = [np.concatenate(column) for column in zip(*self._rows, strict=True)]
        columns.append(np.array(list(self._delays.values()), np.float64))
        return BodyScores(*columns)

    def add(self, k: int, report: UpdateReport, moment: Moment | None = None) -> None:
        """Score frame k by the filter after its update; without a moment, count the points alone."""
        frame, counts = self._frames[k], self._counts
        belief = None if moment is None else moment.bodies
        self._with_bodies |= belief is not None
        if (truth := frame.bodies) is None:
            return
        ids, labels = frame.observation.ids, truth.of_measurements
        if frame.timestamp - self._frames[0].timestamp > SETTLED - _ROUNDING:
            on_bodies = np.concatenate([report.left, *(() if belief is None else belief.landmarks)])
            used, on_body, moves = np.isin(ids, report.updated), np.isin(ids, on_bodies), labels >= 0
            counts["movers_measured"][k], counts["static_measured"][k] = moves.sum(), (~moves).sum()
            counts["movers_as_static"][k] = (moves & used & ~on_body).sum()
            counts["static_on_bodies"][k] = (~moves & used & on_body).sum()
        if moment is None or belief is None or moment.truth is None:
            return
        votes = _votes(belief, ids, labels, truth)
        true_bodies = np.append(truth.ids, -1)[votes.argmax(axis=1)]
        measured = votes.any(axis=1)
        self._note_true(k, moment.truth, truth, labels, true_bodies[measured])
        self._note_births(moment, moment.truth, belief, truth)
        clear = 2 * votes.max(axis=1) > votes.sum(axis=1)
        for j in np.flatnonzero(measured).tolist():
            birth = self._births[int(belief.ids[j])]
            if birth.true_body is None and (i := birth.decide(int(true_bodies[j]) if clear[j] else -1)) >= 0:
                self._delays.setdefault(i, birth.time - self._sighted.get(i, np.nan))
        if measured.any():
            self._score(moment, moment.truth, truth, belief, np.flatnonzero(measured), true_bodies[measured])

    def _note_true(self, k: int, camera: Pose, truth: BodyTruth, labels: IntArray, matched: IntArray) -> None:
        """Note which true bodies can be found, and which of them the filter has."""
        time, near = self._frames[k].timestamp, np.linalg.norm(truth.positions - camera.position, axis=1) < FARTHEST
        enough = (labels[:, None] == truth.ids).sum(axis=0) >= LEAST_POINTS
        findable = enough & near & (np.linalg.norm(truth.linear, axis=1) > SLOWEST)
        self._sighted = _since(self._sighted, truth.ids, enough, time)
        self._findable = _since(self._findable, truth.ids, findable, time)
        old = np.array([time - self._findable.get(i, time) > SETTLED - _ROUNDING for i in truth.ids.tolist()], bool)
        to_find = truth.ids[findable & old]
        self._counts["bodies_to_find"][k] = len(to_find)
        self._counts["bodies_found"][k] = np.isin(to_find, matched).sum()

    def _note_births(self, moment: Moment, camera: Pose, belief: BodiesBelief, truth: BodyTruth) -> None:
        estimate = Pose(moment.pose.position, moment.pose.orientation)
        for j, number in enumerate(belief.ids.tolist()):
            if number not in self._births:
                pose = camera @ estimate.inverse() @ Pose(belief.positions[j], belief.orientations[j])
                self._births[number] = _Birth(moment.time, truth, pose)
            elif self._births[number].true_body not in (None, *truth.ids.tolist()):
                self._births[number].is_lost = True

    def _score(
        self,
        moment: Moment,
        camera: Pose,
        truth: BodyTruth,
        belief: BodiesBelief,
        rows: IntArray,
        true_bodies: IntArray,
    ) -> None:
        """Score the bodies at `rows` of a belief."""
        births = [self._births[i] for i in belief.ids[rows].tolist()]
        at_birth = np.array([birth.true_body for birth in births], np.int64)
        ages = np.array([moment.time - birth.time for birth in births])
        p, R, twists = _moved(births, at_birth, truth)
        estimated_twists = np.hstack([belief.linear, belief.angular])[rows]
        values = np.full((3, len(rows)), np.nan)
        scored = np.isfinite(p).all(axis=1) & (ages > SETTLED - _ROUNDING)
        if scored.any():
            these = rows[scored]
            errors, S = _pose_errors(moment, camera, belief, these, p[scored], R[scored])
            e = twists[scored] - estimated_twists[scored]
            values[:2, scored] = nees(errors, S), nees(e, belief.covariances[these, 6:, 6:])
            if not np.isfinite(values[:2, scored]).all():
                raise ContractBroken(
                    moment.number, "its belief of moving bodies is not finite, or has no definite covariance"
                )
            lengths = [np.linalg.norm(v[scored, :3], axis=1) for v in (estimated_twists, twists)]
            values[2, scored] = lengths[0] - lengths[1]
        about = np.full(len(rows), moment.number), belief.ids[rows], at_birth, true_bodies, ages
        P = belief.covariances[rows, :3, :3]
        self._rows.append((*about, *values, belief.positions[rows], p, P, belief.linear[rows]))


def _since(before: Mapping[int, float], ids: IntArray, so: BoolArray, time: float) -> dict[int, float]:
    """Time at which each present body was first `so`; of bodies that are gone it is forgotten."""
    return {i: before.get(i, time) for i, now in zip(ids.tolist(), so.tolist(), strict=True) if now or i in before}


def _votes(belief: BodiesBelief, ids: IntArray, labels: IntArray, truth: BodyTruth) -> IntArray:
    """Measured landmarks (K, 1 + true bodies) of each of K bodies by what they are on; the scene is the last column."""
    carriers = np.repeat(np.arange(len(belief)), [len(landmarks) for landmarks in belief.landmarks])
    landmarks = np.concatenate([_NONE, *belief.landmarks])
    _, mine, at = np.intersect1d(landmarks, ids, return_indices=True)
    columns = np.where(labels[at] < 0, len(truth.ids), np.searchsorted(truth.ids, labels[at]))
    votes = np.zeros((len(belief), 1 + len(truth.ids)), np.int64)
    np.add.at(votes, (carriers[mine], columns), 1)
    return votes


def _moved(births: list[_Birth], at_birth: IntArray, truth: BodyTruth) -> tuple[FloatArray, FloatArray, FloatArray]:
    """True positions (N, 3), axes (N, 3, 3) and twists (N, 6) of bodies now; NaN where the true one is absent."""
    present = np.isin(at_birth, truth.ids) & ~np.array([birth.is_lost for birth in births])
    i = np.searchsorted(truth.ids, at_birth[present])
    p, R, twists = (np.full((len(births), *shape), np.nan) for shape in ((3,), (3, 3), (6,)))
    if present.any():
        B = rotations.matrix(truth.orientations[i])
        lever = rotations.turned(B, np.array([birth.in_body.position for birth in births])[present])
        p[present] = truth.positions[i] + lever
        R[present] = B @ np.array([birth.in_body.R_wc for birth in births])[present]
        twists[present] = np.hstack([truth.linear[i] + np.cross(truth.angular[i], lever), truth.angular[i]])
    return p, R, twists


def _pose_errors(
    moment: Moment, camera: Pose, belief: BodiesBelief, rows: IntArray, p: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Errors (N, 6) of the poses of bodies relative to the camera, and the covariances (N, 6, 6) claimed for them."""
    estimate = Pose(moment.pose.position, moment.pose.orientation)
    bodies = [Pose(belief.positions[j], belief.orientations[j]) for j in rows]
    relative = [estimate.inverse() @ body for body in bodies]
    names = [f"body-{number}" for number in belief.ids[rows]]
    joint = moment.slam.belief("pose", *names).covariance  # type: ignore[attr-defined]
    pose, size = np.arange(POSE_SIZE), belief.covariances.shape[1]
    index = np.array([np.append(pose, POSE_SIZE + size * n + pose) for n in range(len(rows))])
    J = np.array([relative_jacobian(estimate, body) for body in bodies])
    S = J @ joint[index[:, :, None], index[:, None, :]] @ J.transpose(0, 2, 1) + 1e-12 * np.eye(POSE_SIZE)
    turns = np.array([pose.R_wc.T for pose in relative]) @ (camera.R_wc.T @ R)
    shifts = camera.to_camera(p) - np.array([pose.position for pose in relative])
    return np.hstack([shifts, rotations.log(turns)]), S
