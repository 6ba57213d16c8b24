"""The chain on a linear Gaussian problem, where conditional independence is exact: against one big Kalman filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from filters.geometry import symmetric
from filters.joint_state import JointState
from filters.motions.motion_model import CAMERA_SIZE, CameraState
from filters.submaps.submap_ekf import SubmapChain

from ..dense import plus
from ..engine.linear_problems import LinearisedMeasurements, update
from ..slots import LANDMARKS
from ..state.states import augment, camera_at, new_landmarks, transform_variables, without_map

DT, IN_VIEW = 0.5, 6
STATIONS = 24  # landmarks, two at each of twelve stations of a ring


class LinearSlam:
    """A camera that does not turn drives round a ring and measures where landmarks are, relative to itself."""

    def __init__(self) -> None:
        P = np.diag(np.repeat([1e-4, 0.0, 1.0, 0.0], 3))
        self.state = without_map(camera_at(np.zeros(3)), P, LANDMARKS["euclidean"])

    def predict(self) -> None:
        """Constant velocity with an impulse."""
        F = np.eye(CAMERA_SIZE)
        F[:3, 6:9] = DT * np.eye(3)
        G = np.zeros((CAMERA_SIZE, 3))
        G[:3], G[6:9] = DT * np.eye(3), np.eye(3)
        camera = self.state.camera
        self.state.camera = CameraState(
            camera.position + DT * camera.linear_velocity,
            camera.orientation,
            camera.linear_velocity,
            camera.angular_velocity,
        )
        transform_variables(self.state, F, 0.04 * G @ G.T)

    def update(self, ids: np.ndarray, z: np.ndarray) -> None:
        """Measure landmark - camera with variance 0.01."""
        state = self.state
        known = np.isin(ids, state.ids)
        index = np.array([state.ids.tolist().index(i) for i in ids[known]], dtype=np.int64)
        by_leading = np.tile(np.hstack([-np.eye(3), np.zeros((3, 3))]), (len(index), 1, 1))
        by_map = np.tile(np.eye(3), (len(index), 1, 1))
        R = np.tile(0.01 * np.eye(3), (len(index), 1, 1))
        innovation = z[known] - (state.parameters(index) - state.camera.position)
        measured = LinearisedMeasurements(innovation, by_leading, by_map, state.map_rows(index), R)
        self.state = plus(state, update(state.P, measured))
        count = int((~known).sum())
        by_pose, noise = np.tile(np.eye(3, 6), (count, 1, 1)), np.tile(0.01 * np.eye(3), (count, 1, 1))
        position = self.state.camera.position
        augment(self.state, new_landmarks(ids[~known], position + z[~known], by_pose, noise, False))


@dataclass
class Ring:
    """What is seen from each station: landmarks near it, and the ring closes."""

    seed: int

    def frames(self, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
        rng = np.random.default_rng(self.seed)
        angle = 2 * np.pi * np.arange(STATIONS) / STATIONS
        landmarks = np.stack([12 * np.sin(angle), rng.standard_normal(STATIONS), 12 - 12 * np.cos(angle)], axis=1)
        made = []
        for frame in range(count):
            turn = 2 * np.pi * frame / (2 * STATIONS)
            position = np.array([10 * np.sin(turn), 0.0, 12 - 10 * np.cos(turn)])
            ids = np.sort((frame // 2 + np.arange(IN_VIEW)) % STATIONS)
            made.append((ids, landmarks[ids] - position + 0.1 * rng.standard_normal((IN_VIEW, 3))))
        return made


def whole(states: list[JointState]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ids ascending, values (N, 3) and covariances with the camera (N, 15, 15) over all states."""
    ids, values, covariances = [], [], []
    for state in states:
        index = np.arange(len(state))
        rows = np.hstack([np.tile(np.arange(CAMERA_SIZE), (len(state), 1)), state.map_rows(index)])
        ids.append(state.ids)
        values.append(state.parameters(index))
        covariances.append(symmetric.blocks(state.P, rows))
    order = np.argsort(np.concatenate(ids))
    return np.concatenate(ids)[order], np.concatenate(values)[order], np.concatenate(covariances)[order]


def assert_same(full: JointState, active: JointState, chain: SubmapChain) -> None:
    np.testing.assert_allclose(active.camera.position, full.camera.position, atol=1e-9)
    np.testing.assert_allclose(active.camera.linear_velocity, full.camera.linear_velocity, atol=1e-9)
    expected, found = whole([full]), whole([active, *chain.seen_from(active)])
    assert found[0].tolist() == expected[0].tolist()
    np.testing.assert_allclose(found[1], expected[1], atol=1e-9)
    np.testing.assert_allclose(found[2], expected[2], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_chain_gives_mean_and_covariance_of_the_full_filter(seed: int) -> None:
    """Four laps of a ring: before the loop closes, when it does, and all along the later laps."""
    full, ours, chain = LinearSlam(), LinearSlam(), SubmapChain()
    brought, lengths = 0, []
    for frame, (ids, z) in enumerate(Ring(seed).frames(8 * STATIONS)):
        if frame:
            full.predict()
            ours.predict()
        again = ids[chain.at_rest(ids)]
        if len(again):
            chain.bring(ours.state, again)
            brought += len(again)
        full.update(ids, z)
        ours.update(ids, z)
        if len(ours.state) > IN_VIEW + 3:
            chain.rest(ours.state, ~np.isin(ours.state.ids, ids))
        assert_same(full.state, ours.state, chain)
        lengths.append(len(chain))
    assert max(lengths[: 2 * STATIONS]) >= 3
    assert brought > 2 * STATIONS
    # What has no landmark at rest any more is joined to its neighbour: the chain is as long as the map needs.
    assert max(lengths[4 * STATIONS :]) <= max(lengths[: 4 * STATIONS])
    assert sum(len(submap.own) for submap in chain.submaps) <= 3 * STATIONS
    # The full filter never forgets, ours holds what it sees and what it has in common with the last submap.
    assert len(full.state) == STATIONS
    assert len(ours.state) <= IN_VIEW + 3


def after_a_lap() -> tuple[LinearSlam, SubmapChain]:
    slam, chain = LinearSlam(), SubmapChain()
    for frame, (ids, z) in enumerate(Ring(0).frames(STATIONS)):
        if frame:
            slam.predict()
        slam.update(ids, z)
        if len(slam.state) > IN_VIEW + 3:
            chain.rest(slam.state, ~np.isin(slam.state.ids, ids))
    return slam, chain


def test_many_landmarks_come_forward_together_or_one_by_one_to_the_same_map() -> None:
    """Which is no new knowledge."""
    found = []
    for batches in ([[0, 1, 2, 5]], [[5], [1], [0], [2]]):
        slam, chain = after_a_lap()
        before = whole([slam.state, *chain.seen_from(slam.state)])
        for batch in batches:
            chain.bring(slam.state, np.array(batch))
        assert set(slam.state.ids.tolist()) >= {0, 1, 2, 5}
        found.append(whole([slam.state, *chain.seen_from(slam.state)]))
        for now, then in zip(found[-1], before, strict=True):
            np.testing.assert_allclose(now, then, atol=1e-10)
    np.testing.assert_allclose(found[0][2], found[1][2], atol=1e-10)


def test_a_landmark_forgotten_at_rest_is_gone_and_the_others_stay_as_they_are() -> None:
    slam, chain = after_a_lap()
    before = whole(list(chain.seen_from(slam.state)))
    gone = chain.ids[::2]
    chain.forget(np.append(gone, 999))
    after = whole(list(chain.seen_from(slam.state)))
    assert set(chain.ids.tolist()) == set(after[0].tolist()) == set(before[0].tolist()) - set(gone.tolist())
    stays = np.isin(before[0], after[0])
    np.testing.assert_array_equal(after[1], before[1][stays])
    np.testing.assert_array_equal(after[2], before[2][stays])
