"""Blocks of the joint state that stay although no landmark uses them, and blocks that come from elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from filters.geometry import symmetric
from filters.joint_state import JointState

from ..slots import LANDMARKS
from .states import augment, camera_at, new_landmarks, remove, transform_variables, without_map


@pytest.fixture
def state() -> JointState:
    """A camera and two groups of landmarks with shared anchors."""
    rng = np.random.default_rng(0)
    root = rng.standard_normal((12, 14))
    state = without_map(camera_at(np.ones(3)), root @ root.T, LANDMARKS["shared-anchor"])
    for first in (10, 20):
        by_pose, noise = rng.standard_normal((3, 3, 6)), np.tile(np.eye(3), (3, 1, 1))
        augment(state, new_landmarks(first + np.arange(3), rng.standard_normal((3, 3)), by_pose, noise, True))
    return state


def covariance(state: JointState, blocks: np.ndarray) -> np.ndarray:
    return symmetric.full(state.P)[np.ix_(state.block_rows(blocks), state.block_rows(blocks))]


def test_held_variables_are_a_copy_of_their_errors_and_do_not_move_with_them(state: JointState) -> None:
    before = symmetric.full(state.P)
    clone = state.hold_variables()
    rows = state.block_rows(clone)
    assert rows.shape == (12,)
    np.testing.assert_array_equal(state.blocks[clone], 0.0)
    np.testing.assert_array_equal(covariance(state, clone), before[:12, :12])
    transform_variables(state, 2.0 * np.eye(12))
    np.testing.assert_array_equal(covariance(state, clone), before[:12, :12])
    np.testing.assert_array_equal(symmetric.full(state.P)[np.ix_(rows, np.arange(12))], 2.0 * before[:12, :12])


def test_held_blocks_stay_in_their_order_when_landmarks_leave(state: JointState) -> None:
    held = state.parameter_block[[4, 1]]
    values, P = state.blocks[held], covariance(state, held)
    state.rest(np.isin(state.ids, [11, 12, 21]), held)
    assert sorted(state.ids.tolist()) == [10, 20, 22]
    np.testing.assert_array_equal(state.blocks[state.held], values)
    np.testing.assert_array_equal(covariance(state, state.held), P)
    remove(state, np.ones(3, dtype=bool))
    np.testing.assert_array_equal(state.blocks[state.held], values)
    np.testing.assert_array_equal(covariance(state, state.held), P)
    assert len(state.P) == 12 + 6


def test_blocks_from_elsewhere_become_landmarks(state: JointState) -> None:
    rng = np.random.default_rng(1)
    values, gain, own = rng.standard_normal((2, 3)), rng.standard_normal((6, 12)), np.eye(6)
    before = symmetric.full(state.P)
    cross = gain @ before[:12]
    new = state.append(values, values + 1.0, cross, cross[:, :12] @ gain.T + own)
    state.adopt(np.array([99]), new[1:], new[:1])
    index = np.flatnonzero(state.ids == 99)
    np.testing.assert_array_equal(state.parameters(index), values[1:])
    np.testing.assert_array_equal(state.anchors(index), values[:1])
    np.testing.assert_array_equal(state.first_blocks[new], values + 1.0)
    rows = state.map_rows(index)[0]
    np.testing.assert_array_equal(symmetric.full(state.P)[rows][:, : len(before)], cross)
    np.testing.assert_allclose(covariance(state, new), gain @ before[:12, :12] @ gain.T + own)
