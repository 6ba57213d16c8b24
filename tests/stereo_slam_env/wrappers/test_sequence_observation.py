"""As many rows as there are landmarks (1 s)."""

import numpy as np
from gymnasium import spaces

from stereo_slam_env.wrappers import BeliefObservation, SequenceObservation

from .replayed import ReplayEnv, episode


def test_rows_are_those_of_the_mask_and_the_rest_stays():
    env = BeliefObservation(ReplayEnv(), max_landmarks=7)
    sequence = SequenceObservation(env)
    for seen, original in zip(episode(sequence, steps=5)[0], episode(env, steps=5)[0], strict=True):
        assert sequence.observation_space.contains(seen)
        assert seen.keys() == original.keys() - {"mask", "belief_mask"}
        count = int(original["mask"].sum())
        for key in ("uvd", "ids"):
            np.testing.assert_array_equal(seen[key], original[key][:count])
        count = int(original["belief_mask"].sum())
        for key in ("belief_landmarks", "belief_landmark_ids", "belief_landmark_covariances"):
            np.testing.assert_array_equal(seen[key], original[key][:count])
        np.testing.assert_array_equal(seen["belief_covariance"], original["belief_covariance"])


def test_the_spaces_are_sequences_of_bounded_rows():
    space = SequenceObservation(ReplayEnv()).observation_space
    assert isinstance(space["uvd"], spaces.Sequence)
    assert space["uvd"].feature_space == spaces.Box(-100.0, 2000.0, (3,), np.float32)
    assert space["uvd"].stack
    assert "mask" not in space.spaces


def test_an_empty_frame_is_an_empty_sequence():
    env = BeliefObservation(ReplayEnv(), "dead-reckoning")
    sequence = SequenceObservation(env)
    seen = sequence.reset(seed=0)[0]
    assert seen["belief_landmarks"].shape == (0, 3)
    assert seen["belief_landmark_ids"].shape == (0,)
    assert sequence.observation_space.contains(seen)
