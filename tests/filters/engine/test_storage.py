"""The storage of a filter: what of P counts, copies, clones of the pose as rows of it."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from filters import StereoObservation

from ..drives import DT, drive, run
from ..slots import ERRORS, LANDMARKS
from .beliefs import assert_same_belief, make


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("landmark", ["inverse-depth", "shared-anchor", "euclidean"])
def test_what_lies_outside_the_upper_triangle_in_use_plays_no_part(landmark: str, error: str) -> None:
    frames = drive(1, 12, depths=(6.0, 30.0))
    clean, soiled = (make(landmark=landmark, error=error, gate=0.99, consensus=True) for _ in range(2))
    for frame in frames:
        engine = soiled.engine
        P = engine.storage.P[0]
        row, column = np.indices(P.shape)
        used = engine.recipe.plan.leading + 3 * engine.storage.counts[0, 1]
        P[(column < row) | (column >= used)] = np.nan
        for slam in (clean, soiled):
            slam.predict(DT)
            slam.update(frame.observation)
    assert len(soiled.ids) > 10
    assert_same_belief(soiled, clean, 0.0)


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_an_anchor_leaves_with_the_last_of_its_landmarks(landmark: str) -> None:
    slam = make(landmark=landmark)
    without_map = slam.state_size
    list(run(slam, drive(9, 6)))
    assert slam.state_size > without_map
    slam.predict(DT)
    slam.update(StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3))))
    assert slam.state_size == without_map


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_filters_can_be_copied_and_sent_to_other_processes(landmark: str) -> None:
    frames = drive(7, 6)
    original = make(landmark=landmark)
    list(run(original, frames[:3]))
    original.clone_pose("then")
    twins = [copy.deepcopy(original), pickle.loads(pickle.dumps(original))]
    list(run(original, frames[3:]))
    for twin in twins:
        list(run(twin, frames[3:]))
        assert_same_belief(twin, original, 1e-14)
        np.testing.assert_array_equal(twin.relative_pose("then").covariance, original.relative_pose("then").covariance)


def test_a_landmark_without_an_anchor_leaves_a_full_storage_as_any_other() -> None:
    slam = make(landmark="euclidean")
    room = slam.engine.storage.ids.shape[1]
    u, v, d = np.random.default_rng(3).uniform((400.0, 100.0, 10.0), (900.0, 300.0, 40.0), (room, 3)).T
    slam.update(StereoObservation(np.arange(room), np.column_stack([u, v, d])))
    assert slam.engine.storage.ids.shape[1] == len(slam.ids) == room
    before = slam.landmarks
    slam.forget([0])
    after = slam.landmarks
    np.testing.assert_array_equal(after.ids, before.ids[1:])
    np.testing.assert_array_equal(after.positions, before.positions[1:])
    np.testing.assert_array_equal(after.covariances, before.covariances[1:])
