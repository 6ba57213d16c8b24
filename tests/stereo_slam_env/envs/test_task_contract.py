"""What the manual promises of every task: defaults, bounds of what is shown, rows that rest (5 s)."""

import inspect

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import branches, closed_loop, explore, follow, revisit
from stereo_slam_env.world import named_route

from .replayed import assert_the_second_rests
from .test_tasks import QUICK, made

DEFAULTS = {
    branches.BranchChoice: {"roads": 12, "accuracy": 1.0, "weight": 100.0, "goal": 0.25},
    explore.Coverage: {"accuracy": 0.8, "goal": 0.5, "coverage_weight": 20.0, "path_weight": 0.01},
    revisit.LoopClosure: {"begin": (0.5, 0.95), "dearest": 0.4, "hold": 10},
    closed_loop.RouteByEstimate: {"latency": 0},
    follow.FollowLeader: {"headway": 1.5, "standstill": 4.0, "gap_weight": 1.0},
}
BOUNDS = {
    "StereoSlam/Branches-v0": {
        "branches": (0.0, np.tile([1.0, 1.0, 60.0, 60.0, 100.0], (3, 1))),
        "roads_left": (0.0, [1000.0]),
        "mapped": (0.0, [1.0]),
        "belief_sigmas": (0.0, [1000.0] * 6),
    },
    "StereoSlam/Explore-v0": {"coverage": (0.0, [1.0]), "panorama": (-1.0, np.full((12, 6), 2.0))},
    "StereoSlam/Revisit-v0": {"ahead": (-1000.0, [1000.0]), "panorama": (-1.0, np.full((12, 6), 2.0))},
    "StereoSlam/ActiveGaze-v0": {"panorama": (-1.0, np.full((12, 6), 2.0)), "belief_sigmas": (0.0, [1000.0] * 6)},
    "StereoSlam/ClosedLoop-v0": {"progress": (0.0, [1.0]), "belief_sigmas": (0.0, [1000.0] * 6)},
    "StereoSlam/Follow-v0": {"car": (np.float32([-12.0, -0.55]), [12.0, 0.55])},
}
ACTIONS = {
    "StereoSlam/Branches-v0": gym.spaces.Discrete(3),
    "StereoSlam/Revisit-v0": gym.spaces.Discrete(2),
    "StereoSlam/ActiveGaze-v0": gym.spaces.Discrete(9),
    "StereoSlam/Explore-v0": gym.spaces.Box(-1.0, 1.0, (5,), np.float32),
    "StereoSlam/ClosedLoop-v0": gym.spaces.Box(-1.0, 1.0, (2,), np.float32),
    "StereoSlam/Follow-v0": gym.spaces.Box(-1.0, 1.0, (1,), np.float32),
}


@pytest.mark.parametrize("task", DEFAULTS, ids=lambda task: task.__name__)
def test_defaults_are_those_of_the_manual(task):
    parameters = inspect.signature(task).parameters
    assert {name: parameters[name].default for name in DEFAULTS[task]} == DEFAULTS[task]


@pytest.mark.parametrize("name", BOUNDS)
def test_bounds_are_those_of_the_manual(name):
    env = made(name)
    assert env.action_space == ACTIONS[name]
    for key, (low, high) in BOUNDS[name].items():
        space = env.observation_space[key]
        np.testing.assert_array_equal(space.low, np.full(space.shape, low, np.float32), err_msg=key)
        np.testing.assert_array_equal(space.high, np.asarray(high, np.float32), err_msg=key)


@pytest.mark.parametrize("name", QUICK)
def test_rows_that_do_not_go_on_earn_nothing_and_stay_as_they_are(name):
    vector = gym.make_vec(name, num_envs=2, **QUICK[name])
    vector.reset(seed=[3, 4])
    actions = np.ones_like(vector.action_space.sample())
    vector.step(actions)
    assert_the_second_rests(vector.rows, actions)
    vector.close()


def test_a_loop_is_closed_where_nothing_is_left_of_the_way():
    """`ahead` is 0 at the very step of the route that passes its start, and that is enough."""
    route = named_route("loop")
    closing, begin = revisit.closing_distance(route), 0.95
    first, last = np.searchsorted(route.arc_length, [begin * closing, closing])
    env = made("StereoSlam/Revisit-v0", route="loop", begin=(begin, begin), dearest=1e-6, hold=int(last - first))
    env.reset(seed=0)
    seen, reward, _, _, info = env.step(revisit.GO_ON)
    assert (float(seen["ahead"][0]), reward > 0.0, info["is_success"]) == (0.0, True, True)
