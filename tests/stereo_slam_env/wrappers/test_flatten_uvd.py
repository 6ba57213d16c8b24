"""One row of numbers between -1 and 1 (1 s)."""

import pickle

import gymnasium as gym
import numpy as np
import pytest

from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama, FlattenUVD, SelectedKeys
from stereo_slam_env.wrappers.observation_shapes import UNITS

from .replayed import ROWS, ReplayEnv, episode


def both(env):
    """The flat observation after a few frames, its layout, and the Dict it was made of."""
    flat = FlattenUVD(env)
    return flat, episode(flat, steps=5)[0][-1], episode(env, steps=5)[0][-1]


def test_boxes_are_scaled_by_their_bounds_and_padding_is_zero():
    env = ReplayEnv(head=(0.3, -0.1))
    flat, seen, original = both(env)
    assert seen.dtype == np.float32
    assert flat.layout.keys() == {"uvd", "mask", "odometry", "head"}
    uvd = seen[flat.layout["uvd"]].reshape(ROWS, 3)
    count = int(original["mask"].sum())
    assert 0 < count < ROWS
    np.testing.assert_allclose(uvd[:count], (original["uvd"][:count] + 100.0) / 1050.0 - 1.0, rtol=1e-5)
    assert not uvd[count:].any()
    np.testing.assert_array_equal(seen[flat.layout["mask"]], original["mask"])
    np.testing.assert_allclose(seen[flat.layout["head"]], np.array([0.3, -0.1]) / 3.0, rtol=1e-6)


def test_the_layout_says_where_everything_is():
    flat, seen, _ = both(BeliefPanorama(BeliefObservation(ReplayEnv(), max_landmarks=4)))
    ends = np.cumsum([part.stop - part.start for part in flat.layout.values()])
    assert [part.stop for part in flat.layout.values()] == ends.tolist()
    assert ends[-1] == len(seen) == flat.observation_space.shape[0]
    assert not {"ids", "belief_landmark_ids"} & flat.layout.keys()
    assert flat.observation_space.contains(seen)


@pytest.mark.parametrize("key", sorted(UNITS))
def test_wide_ranges_are_logarithmic_and_can_be_undone(key):
    flat, seen, original = both(BeliefPanorama(BeliefObservation(ReplayEnv(), max_landmarks=40)))
    values = seen[flat.layout[key]].astype(float)
    bound = float(flat.env.observation_space[key].high.max())
    back = np.sign(values) * UNITS[key] * np.expm1(np.abs(values) * np.log1p(bound / UNITS[key]))
    np.testing.assert_allclose(back, original[key].ravel(), rtol=1e-4, atol=1e-6 * UNITS[key])
    if key != "belief_position":
        assert np.abs(values).max() > 0.02  # linearly it would be lost


def test_the_units_are_those_that_a_trained_network_was_shown():
    """A metre, a millimetre or milliradian, and the square of one and of a centimetre."""
    assert UNITS == {
        **{"belief_position": 1.0, "belief_landmarks": 1.0, "belief_sigmas": 1e-3},
        **{"belief_covariance": 1e-6, "belief_landmark_covariances": 1e-4},
    }


def test_all_stays_within_bounds_and_images_are_left_out():
    env = ReplayEnv()
    env.observation_space["left"] = gym.spaces.Box(0, 255, (4, 4, 3), np.uint8)
    flat = FlattenUVD(env)
    assert "left" not in flat.layout
    env.recording.frames[0].observation.uvd.flags.writeable = True
    env.recording.frames[0].observation.uvd[0] = 1e6
    assert flat.reset()[0].max() == 1.0


def test_what_cannot_be_scaled_is_refused():
    env = ReplayEnv()
    env.observation_space["odometry"] = gym.spaces.Box(-np.inf, np.inf, (6,), np.float32)
    with pytest.raises(ValueError, match="observation key 'odometry' must be a bounded Box"):
        FlattenUVD(env)
    with pytest.raises(ValueError, match="FlattenUVD needs a Dict observation"):
        FlattenUVD(FlattenUVD(ReplayEnv()))


def test_only_the_selected_keys_stay():
    env = SelectedKeys(ReplayEnv(), ["mask", "uvd"])
    observation, _ = env.reset(seed=0)
    assert list(env.observation_space) == ["mask", "uvd"]
    assert observation in env.observation_space
    again, _ = pickle.loads(pickle.dumps(env)).reset(seed=0)
    np.testing.assert_array_equal(again["uvd"], observation["uvd"])
    with pytest.raises(ValueError, match="the observation has no key 'uvw', did you mean 'uvd'"):
        SelectedKeys(ReplayEnv(), ["uvw"])
