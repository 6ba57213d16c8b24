"""Bookkeeping of the joint state against a reference that keeps whole matrices and names its rows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from filters.geometry import symmetric
from filters.joint_state import JointState
from filters.landmarks.inverse_depth import Hybrid
from filters.landmarks.landmark_model import LandmarkModel

from ..slots import LANDMARKS
from .states import NewLandmarks, augment, camera_at, new_landmarks, remove, transform_variables, without_map

CAMERA = [("camera", i) for i in range(12)]


def random_new(rng: np.random.Generator, ids: list[int], model: LandmarkModel) -> NewLandmarks:
    """Landmarks with random values, Jacobians and noise; of hybrid ones some have an anchor."""
    count = len(ids)
    anchored = rng.uniform(size=count) < 0.5 if isinstance(model, Hybrid) else np.full(count, model.anchored)
    by_pose = rng.standard_normal((count, 3, 6))
    values = rng.standard_normal((count, model.value_size))
    return new_landmarks(np.array(ids), values, by_pose, random_noise(rng, count), anchored)


def random_noise(rng: np.random.Generator, count: int) -> np.ndarray:
    root = rng.standard_normal((count, 3, 3))
    return root @ root.transpose(0, 2, 1) + 0.1 * np.eye(3)


@dataclass
class Ledger:
    """The reference: P dense, every row with a name, every value under its name."""

    P: np.ndarray
    names: list = field(default_factory=lambda: list(CAMERA))
    values: dict = field(default_factory=dict)
    anchor_of: dict = field(default_factory=dict)

    def add(self, name: object, value: np.ndarray, J_pose: np.ndarray, noise: np.ndarray) -> None:
        """Append one block: P -> [[P, P J'], [J P, J P J' + noise]]."""
        J = np.zeros((3, len(self.P)))
        J[:, :6] = J_pose
        self.P = np.block([[self.P, self.P @ J.T], [J @ self.P, J @ self.P @ J.T + noise]])
        self.names += [(name, i) for i in range(3)]
        self.values[name] = value

    def remove(self, ids: set[int]) -> None:
        for i in ids:
            self.anchor_of.pop(i)
        used = {"camera", *self.anchor_of, *self.anchor_of.values()}
        rows = [row for row, (name, _) in enumerate(self.names) if name in used]
        self.P, self.names = self.P[np.ix_(rows, rows)], [self.names[row] for row in rows]

    def rows(self, name: object) -> list[int]:
        return [self.names.index((name, i)) for i in range(3)]


def assert_same(state: JointState, ledger: Ledger) -> None:
    """Every landmark's values, and the covariance of everything with everything, are where the state says."""
    index = np.arange(len(state))
    assert set(state.ids.tolist()) == set(ledger.anchor_of)
    names = []
    for i in state.ids.tolist():
        names += ([ledger.anchor_of[i]] if state.model.anchored else []) + [i]
    expected_rows = list(range(12)) + [row for name in names for row in ledger.rows(name)]
    rows = np.concatenate([np.arange(12), state.map_rows(index).ravel()])
    P = symmetric.full(state.P)
    np.testing.assert_allclose(P[np.ix_(rows, rows)], ledger.P[np.ix_(expected_rows, expected_rows)], atol=1e-12)
    parameters, anchors = state.parameters(index), state.anchors(index)
    for row, i in enumerate(state.ids.tolist()):
        np.testing.assert_array_equal(parameters[row], ledger.values[i])
        if anchors is not None:
            missing = ledger.anchor_of[i] == i
            np.testing.assert_array_equal(anchors[row], np.nan if missing else ledger.values[ledger.anchor_of[i]])
    used = {*state.parameter_block.tolist(), *state.anchor_block[state.anchor_block >= 0].tolist()}
    assert len(used) == len({*names}) == len(state.blocks)
    assert len(state.P) == 12 + 3 * len(state.blocks)
    assert state.P.flags.f_contiguous


def add_to_both(state: JointState, ledger: Ledger, ids: list[int], frame: int, rng: np.random.Generator) -> None:
    """New landmarks from the present camera position."""
    new = random_new(rng, ids, state.model)
    augment(state, new)
    anchored = new.anchored
    if state.model.shares_anchors and anchored.any():
        ledger.add(("anchor", frame), state.camera.position, np.eye(3, 6), np.zeros((3, 3)))
    for row, i in enumerate(ids):
        if anchored[row] and not state.model.shares_anchors:
            ledger.add(("anchor", i), state.camera.position, np.eye(3, 6), np.zeros((3, 3)))
        ledger.add(i, new.values[row], new.by_leading[row], new.noise[row])
        anchor = ("anchor", frame if state.model.shares_anchors else i)
        ledger.anchor_of[i] = anchor if anchored[row] else i  # without an anchor, its own rows twice


@pytest.mark.parametrize("model", LANDMARKS.values(), ids=LANDMARKS.keys())
@pytest.mark.parametrize("seed", range(3))
def test_random_additions_and_removals_agree_with_a_dense_reference(model: LandmarkModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((12, 14))
    P = root @ root.T
    state = without_map(camera_at(np.zeros(3)), P, model)
    ledger = Ledger(P)
    next_id = 0
    for frame in range(12):
        state.camera = camera_at(rng.standard_normal(3))
        F, Q = rng.standard_normal((12, 12)) / 3, 0.1 * np.eye(12)
        transform_variables(state, F, Q)
        whole = np.eye(len(ledger.P))
        whole[:12, :12] = F
        ledger.P = whole @ ledger.P @ whole.T
        ledger.P[:12, :12] += Q
        if frame % 4 != 3:
            count = int(rng.integers(1, 6))
            ids = rng.permutation(np.arange(next_id, next_id + count)).tolist()
            next_id += count
            add_to_both(state, ledger, ids, frame, rng)
            assert_same(state, ledger)
        gone = rng.uniform(size=len(state)) < 0.4
        ledger.remove(set(state.ids[gone].tolist()))
        remove(state, gone)
        assert_same(state, ledger)
    remove(state, np.ones(len(state), dtype=bool))
    assert state.P.shape == (12, 12)
    assert len(state) == len(state.blocks) == 0
