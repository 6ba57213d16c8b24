"""Landmarks anchored in a pose with its orientation: the textbook's, their Jacobians, their map, all options."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import chi2

from filters import FilterBatch, Start, StereoEKF, StereoObservation, check_part, jacobian, nees

from .. import textbook
from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, START_COVARIANCE, Frame, drive, finish, run, start
from .first_camera import InFirstCamera

DEPTHS = (6.0, 40.0)
OPTIONS = {"landmark": InFirstCamera(), "gate": None}


class EachWithItsAnchor(InFirstCamera):
    """Landmarks that start together do not share one."""

    shares_anchors = False


def test_the_part_is_right() -> None:
    check_part(InFirstCamera())


@dataclass
class TextbookWithPoses(textbook.TextbookEKF):
    """The textbook's filter with ten numbers of a landmark: the pose that first saw it, theta, phi and rho there."""

    def _size(self) -> int:
        return 10

    def _predict_measurement(self, x: np.ndarray, known: list[int], T: np.ndarray) -> np.ndarray:
        told = []
        for i in known:
            y = x[self._rows(i)]
            there = textbook.point_of_inverse_depth(np.append(np.zeros(3), y[7:]))
            told.append(textbook.project(self.camera, x[:7], y[:3] + textbook.rotation_matrix(y[3:7]) @ there))
        return np.concatenate(told)

    def _add(self, identity: int, z: np.ndarray) -> None:
        at_anchor = np.append(np.zeros(6), 1.0)

        def g(pose: np.ndarray, given: np.ndarray) -> np.ndarray:
            return np.append(pose, textbook.new_inverse_depth(self.camera, at_anchor, given)[3:])

        pose = self.x[:7]
        J_x = np.zeros((10, len(self.x)))
        J_x[:7, :7] = np.eye(7)
        J_R = textbook.complex_step_jacobian(lambda m: g(pose, m), z)
        cross = J_x @ self.P
        self.P = np.block([[self.P, cross.T], [cross, cross @ J_x.T + J_R @ self.R @ J_R.T]])
        self.x = np.concatenate([self.x, g(pose, z).real])
        self.ids = [*self.ids, identity]

    def _orientations(self) -> list[int]:
        return [3, *(textbook.CAMERA_STATE + 10 * i + 3 for i in range(len(self.ids)))]

    def _normalise(self) -> None:
        J = np.eye(len(self.x))
        for at in self._orientations():
            q = self.x[at : at + 4]
            J[at : at + 4, at : at + 4] = textbook.complex_step_jacobian(lambda p: p / np.sqrt(p @ p), q)
            self.x[at : at + 4] = q / np.linalg.norm(q)
        self.P = J @ self.P @ J.T

    def error_covariance(self) -> np.ndarray:
        """P with three numbers for each orientation."""
        orientations = self._orientations()
        starts, blocks, at = [], [], 0
        while at < len(self.x):
            quaternion = at in orientations
            starts.append(at)
            q = self.x[at : at + 4]
            blocks.append(np.linalg.pinv(textbook.rotation_tangent(q)) if quaternion else np.eye(1))
            at += 4 if quaternion else 1
        M = np.zeros((sum(map(len, blocks)), len(self.x)))
        row = 0
        for first, block in zip(starts, blocks, strict=True):
            M[row : row + len(block), first : first + block.shape[1]] = block
            row += len(block)
        return M @ self.P @ M.T


@pytest.mark.parametrize("model", [InFirstCamera(), EachWithItsAnchor()], ids=["shared", "each its own"])
def test_they_are_those_of_the_textbook(model: InFirstCamera) -> None:
    """In each frame of many, in which landmarks come, go and are missed; all of P relative to two sigmas.

    Landmarks that share an anchor are the textbook's, which has it once for each.
    """
    slam = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, landmark=model, gate=None))
    book = TextbookWithPoses(CAMERA, INDEPENDENT_PIXELS.R)
    book.reset(np.array([0.0, 0.0, SPEED]), START_COVARIANCE)
    entered = 0
    for k, frame in enumerate(drive(3, 12, visible=10, depths=DEPTHS)):
        if k:
            slam.predict(DT)
            book.predict(DT)
        entered += len(slam.update(frame.observation).initialised) if k else 0
        book.update(frame.observation)
        state = slam.state
        book.keep(state.ids.tolist())
        np.testing.assert_allclose(slam.pose.position, book.x[:3], rtol=1e-8, atol=1e-10)
        numbers = np.array([book.landmark(i) for i in state.ids]).reshape(-1, 10)
        np.testing.assert_allclose(state.parameters(), numbers[:, 7:], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(state.anchor_poses()[0], numbers[:, :3], rtol=1e-8, atol=1e-10)
        rows = np.concatenate([np.arange(12), state.map_rows(np.arange(len(state))).ravel()])
        P = state.P[np.maximum(rows[:, None], rows), np.minimum(rows[:, None], rows)]
        expected = book.error_covariance()
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(P / scale, expected / scale, rtol=0, atol=1e-8)
    assert entered >= 8


@pytest.mark.parametrize("error", ["so3", "right-invariant"])
def test_H_is_that_of_differences(error: str) -> None:
    slam = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, error=error, **OPTIONS), drive(4, 4, depths=DEPTHS))
    state, definition = slam.state, slam.options.error
    n, uvd = len(state.P), slam.forecast().uvd

    def moved(e: np.ndarray) -> np.ndarray:
        slam.state = definition.moved(state, e)
        told: np.ndarray = slam.forecast().uvd - uvd
        return told

    by_all = jacobian(moved, n)
    slam.state = state
    P = np.tril(state.P) + np.tril(state.P, -1).T
    S = by_all @ P @ by_all.transpose(0, 2, 1) + INDEPENDENT_PIXELS.R
    np.testing.assert_allclose(slam.forecast().S, S, rtol=1e-5, atol=1e-5)
    map_ = slam.landmarks

    def places(e: np.ndarray) -> np.ndarray:
        slam.state = definition.moved(state, e)
        points: np.ndarray = slam.landmarks.positions - map_.positions
        return points

    by_all = jacobian(places, n)
    np.testing.assert_allclose(map_.covariances, by_all @ P @ by_all.transpose(0, 2, 1), rtol=1e-4, atol=1e-6)


def final_nees(slam: StereoEKF, frame: Frame) -> float:
    error, covariance = slam.pose_error(frame.position, frame.orientation)
    return float(nees(error[None], covariance[None])[0]) / 6.0


@pytest.mark.parametrize("error", ["so3", "right-invariant", "left-invariant"])
def test_pose_and_map_are_consistent_and_nearly_those_of_anchors_that_are_points(error: str) -> None:
    """Mean of 12 x 6 numbers of variance one: within .6 and 1.5."""
    found, apart = [], []
    for seed in range(12):
        frames = drive(seed, 12, depths=DEPTHS)
        slam = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, error=error, **OPTIONS), frames)
        other = StereoEKF(CAMERA, INDEPENDENT_PIXELS, error=error, gate=None, landmark="shared-anchor")
        finish(other, frames)
        found.append(final_nees(slam, frames[-1]))
        apart.append(np.linalg.norm(slam.pose.position - other.pose.position))
    assert 0.6 < np.mean(found) < 1.5
    assert np.mean(apart) < 0.01
    mine, theirs = slam.landmarks, other.landmarks
    np.testing.assert_allclose(mine.positions, theirs.positions, rtol=0.01, atol=0.05)
    np.testing.assert_allclose(mine.inverse_distance, theirs.inverse_distance, atol=1e-3)
    np.testing.assert_allclose(mine.inverse_distance_variance, theirs.inverse_distance_variance, rtol=0.05)


@pytest.mark.parametrize(
    "option",
    [
        {"iterations": 3},
        {"drop_unseen": False, "drift": 0.2},
        {"consensus": True, "gate": 0.99},
        {"tail_dof": 4.0},
        {"update": "unscented"},
        {"measurement": "sequential"},
        {"error": "right-invariant", "gauge_walk": 1e-3},
    ],
    ids=lambda option: "-".join(option),
)
def test_options_lead_where_they_do_with_anchors_that_are_points(option: dict[str, object]) -> None:
    frames, found = drive(3, 10, depths=DEPTHS), []
    for landmark in (InFirstCamera(), "shared-anchor"):
        options = {**OPTIONS, "error": "so3", "landmark": landmark, **option}
        slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)
        for k, _ in enumerate(run(slam, frames)):
            if k == 5:
                slam.clone_pose("then")
        sigmas = np.sqrt(np.diag(slam.pose.covariance))
        found.append(np.concatenate([slam.pose.position, sigmas, slam.relative_pose("then").position]))
        state = slam.state
        slam.state = state
        np.testing.assert_array_equal(slam.state.blocks, state.blocks)
    np.testing.assert_allclose(*found, rtol=1e-2, atol=2e-3)


def test_a_batch_is_one_by_one() -> None:
    frames = [drive(seed, 8, depths=DEPTHS) for seed in (1, 2)]
    batch = FilterBatch(lambda: StereoEKF(CAMERA, INDEPENDENT_PIXELS, **OPTIONS), 2)
    batch.reset(Start(linear_velocity=(0.0, 0.0, SPEED), covariance=START_COVARIANCE))
    for k in range(8):
        if k:
            batch.predict(DT)
        batch.update([frames[0][k].observation, frames[1][k].observation])
    for number, slam in enumerate(batch):
        alone = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, **OPTIONS), frames[number])
        np.testing.assert_array_equal(slam.pose.covariance, alone.pose.covariance)
        np.testing.assert_array_equal(slam.landmarks.positions, alone.landmarks.positions)


def test_anchors_leave_with_their_last_landmark() -> None:
    """And a clone that was made in the same frame stays."""
    slam = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, **OPTIONS))
    slam.update(drive(1, 1, depths=DEPTHS)[0].observation)
    slam.clone_pose("first")
    leading, count = 12, len(slam.ids)
    assert slam.state_size == leading + 3 * count + 6 + 6
    slam.forget(slam.ids[1:])
    assert slam.state_size == leading + 3 + 6 + 6
    slam.forget(slam.ids)
    assert slam.state_size == leading + 6


def test_corrections_reach_the_anchor_too() -> None:
    """Of a landmark's nine numbers the first three are its anchor's position, then come its orientation's."""
    slam = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, error="so3", **OPTIONS), drive(2, 6, depths=DEPTHS))
    identity = int(slam.ids[0])
    H = np.zeros((1, 9))
    H[0, 4] = 1.0
    before = slam.state.anchor_poses()[1][0]
    assert slam.correct([1e-3], {identity: H}, [[1e-16]]).used
    after = slam.state.anchor_poses()[1][0]
    turn = before.T @ after
    np.testing.assert_allclose(turn[0, 2], 1e-3, atol=1e-6)


class Anchored(InFirstCamera):
    anchored = True


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"landmark": Anchored()}, "landmark Anchored is in the frame of its anchor: it must have no anchors"),
        ({"landmark": InFirstCamera(), "error": "first-estimates"}, "error must not be first-estimates"),
    ],
    ids=["anchor", "first-estimates"],
)
def test_what_cannot_be_is_refused_in_one_line(options: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words) as refused:
        StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)
    assert "\n" not in str(refused.value)


def test_each_has_room_for_its_own_anchor() -> None:
    uvd = np.column_stack([np.linspace(300.0, 900.0, 60), np.full(60, 150.0), np.full(60, 20.0)])
    slam = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, landmark=EachWithItsAnchor(), gate=None))
    slam.update(StereoObservation(np.arange(60), uvd))
    assert slam.state_size == 12 + 9 * 60


def test_the_gate_knows_the_orientation_of_the_anchor() -> None:
    """A measurement passes just below the limit of its forecast, and not just above."""
    for share, passes in ((0.999, True), (1.001, False)):
        slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, landmark=InFirstCamera(), gate=0.9)
        finish(slam, drive(2, 6, depths=DEPTHS))
        seen = slam.forecast()
        sigma, axis = np.linalg.eigh(seen.S[0])
        nu = np.sqrt(share * chi2.ppf(0.9, 3) * sigma[-1]) * axis[:, -1]
        report = slam.update(StereoObservation(seen.ids[:1], seen.uvd[:1] + nu))
        assert (len(report.updated) == 1) is passes
