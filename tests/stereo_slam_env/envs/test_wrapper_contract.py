"""What wrappers promise: defaults, bounds of what they add, rows that rest (3 s)."""

import inspect

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import (
    BeliefObservation,
    BeliefPanorama,
    DirectionOfGaze,
    InformationCriterion,
    InformationGain,
    ObserveBodies,
    TrueError,
)

from .replayed import ReplayEnv, assert_the_second_rests

DEFAULTS = {
    BeliefObservation: {
        **{"filter": "shared-anchor", "max_landmarks": 64, "use_odometry": True},
        **{"noise": None, "options": None, "hold": 1},
    },
    BeliefPanorama: {"sectors": 12, "reach": None},
    DirectionOfGaze: {"pans": 9},
    InformationCriterion: {"prior_sigma": 10.0, "resolution": (0.0, 0.0)},
    InformationGain: {
        **{"criterion": "log-det", "of": "map", "prior_sigma": 10.0, "resolution": (0.0, 0.0), "belief": "filter"},
        **{"nees_gate": None, "weight": 1.0, "keep_reward": False, "max_age": 0, "use_odometry": True},
        "report_both": False,
    },
    ObserveBodies: {"most": 8},
    TrueError: {"weight": 1.0, "keep_reward": False},
}
LARGEST_ID = np.iinfo(np.int32).max


@pytest.mark.parametrize("wrapper", DEFAULTS, ids=lambda wrapper: wrapper.__name__)
def test_defaults_are_those_of_the_manual(wrapper):
    parameters = inspect.signature(wrapper).parameters
    assert {name: parameters[name].default for name in DEFAULTS[wrapper]} == DEFAULTS[wrapper]


def test_bounds_are_those_of_the_manual():
    believed = BeliefObservation(ReplayEnv(), max_landmarks=5)
    around = BeliefPanorama(believed, sectors=7)
    rows = ObserveBodies(BeliefObservation(ReplayEnv(), filter="moving-bodies"), most=2).observation_space["bodies"]
    high = np.array([*[1e3] * 3, *[100.0] * 3, 10.0, 1e3, 100.0, 10.0, 1.0], np.float32)
    assert rows == gym.spaces.Box(np.tile(np.append(-high[:7], np.zeros(4, np.float32)), (2, 1)), np.tile(high, (2, 1)))
    bounds = {
        "belief_position": (-1e4, 1e4, (3,)),
        "belief_orientation": (-1.0, 1.0, (4,)),
        "belief_covariance": (-1e6, 1e6, (6, 6)),
        "belief_landmarks": (-1e4, 1e4, (5, 3)),
        "belief_landmark_covariances": (-1e6, 1e6, (5, 3, 3)),
        "belief_landmark_ids": (-1, LARGEST_ID, (5,)),
        "belief_mask": (0, 1, (5,)),
        "panorama": (-1.0, 2.0, (7, 6)),
        "belief_sigmas": (0.0, 1000.0, (6,)),
    }
    spaces = around.observation_space.spaces
    inner = ReplayEnv().observation_space.spaces
    assert spaces.keys() == bounds.keys() | inner.keys()
    assert {key: spaces[key] for key in inner} == inner
    for key, (low, high, shape) in bounds.items():
        assert spaces[key] == gym.spaces.Box(low, high, shape, spaces[key].dtype), key
    assert DirectionOfGaze(gym.make("StereoSlam/Gaze-v0")).action_space == gym.spaces.Discrete(9)


@pytest.mark.parametrize(
    "wrappers",
    [
        {"information": {"of": "pose"}},
        {"information": {"nees_gate": 0.9, "keep_reward": True, "report_both": True}},
        {"information": {"belief": "reference", "max_age": None}},
        {"error": {"weight": 1e9}},
        {"error": {"keep_reward": True}, "belief": {"hold": 2}},
        {"panorama": {}},
    ],
    ids=str,
)
def test_rows_that_do_not_go_on_earn_nothing_and_stay_as_they_are(wrappers):
    arguments = {"belief": {}, "route": "right-turn", "rig": "qvga", **wrappers}
    vector = gym.make_vec("StereoSlam/Gaze-v0", num_envs=2, **arguments)
    vector.reset(seed=[3, 4])
    actions = np.full((2, 2), 0.5, dtype=np.float32)
    vector.step(actions)
    assert_the_second_rests(vector.rows, actions)
    vector.close()
