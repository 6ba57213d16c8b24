"""One environment and a row of many give the same bits: every id, whole observations, rewards and infos (40 s)."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import stereo_slam_env  # noqa: F401 (registers the ids)

IDS = sorted(name for name in gym.registry if name.startswith("StereoSlam/"))
QUICK = {"route": "right-turn", "rig": "qvga"}
SMALL = {
    "Drive": QUICK,
    "Gaze": QUICK,
    "DriveGaze": QUICK,
    "ActiveGaze": {"arguments": QUICK},
    "Revisit": {"begin": [0.0, 0.2]},
    "Branches": {"roads": 2},
}
"""Arguments for short episodes; tasks have their own."""
OTHERS = {
    "uvd": ("Gaze", {"noise": "uvd", "surroundings": "field", "revisit": False}),
    "quantised": ("Drive", {"noise": "quantised", "surroundings": "corridor", "observe_ids": False}),
    "lasting": ("Gaze", {"lasting": 0.7, "lasting_time": 2.0, "noise": "quantised"}),
    "heavy-tailed": ("DriveGaze", {"noise": "heavy-tailed", "randomise": True, "tracking_weight": 3.0}),
    "scripted": ("Drive", {"policy": "route", "max_landmarks": 60, "perturbation": 0.0}),
    "inertial": ("Drive", {"vehicle": "smooth", "imu": "bmi088"}),
    "traffic": ("Drive", {"policy": "route", "moving_cars": 5, "pedestrians": 5}),
    "on bodies": (
        "Drive",
        {"policy": "route", "moving_cars": 5, "pedestrians": 5, "moving_landmarks": 5, "bus": "leads"},
    ),
    "bullet": ("Drive", {"policy": "route", "moving_cars": 2, "physics": "bullet"}),
    "heavy-tailed bullet": ("Gaze", {"noise": "heavy-tailed", "physics": "bullet", "surroundings": "street"}),
}


def kind_of(name):
    return name.split("/")[1].split("-")[0]


def actions_of(space, steps, seed=0):
    """Smooth random actions: a car that is steered at random crashes at once. Discrete ones at random."""
    rng = np.random.default_rng(seed)
    if isinstance(space, gym.spaces.Discrete):
        return rng.integers(space.n, size=steps)
    if isinstance(space, gym.spaces.MultiDiscrete):
        return rng.integers(space.nvec, size=(steps, *space.shape))
    walk = np.cumsum(rng.uniform(-0.2, 0.2, (steps, *space.shape)), axis=0)
    return np.clip(walk, -1.0, 1.0).astype(np.float32)


def assert_bits(batch, b, single, where):
    """Row b of each key is the single value, bit by bit and of the same type."""
    assert {key for key in batch if not key.startswith("_")} == set(single)
    for key, value in single.items():
        row, alone = np.asarray(batch[key])[b], np.asarray(value)
        assert (row.dtype, row.shape) == (alone.dtype, alone.shape), (where, key)
        assert row.tobytes() == alone.tobytes(), (where, key)


def compare(name, seeds, steps, autoreset_mode=AutoresetMode.NEXT_STEP, **arguments):
    """Step a vector and single environments, over the ends of episodes; how many episodes ended, and crashed."""
    vector = gym.make_vec(name, num_envs=len(seeds), autoreset_mode=autoreset_mode, **arguments)
    actions = actions_of(vector.action_space, steps)
    calls = [vector.reset(seed=list(seeds)), *(vector.step(action) for action in actions)]
    vector.close()
    ended = crashed = 0
    with gym.make(name, disable_env_checker=True, **arguments) as env:
        for b, seed in enumerate(seeds):
            over = False
            for k, call in enumerate(calls):
                where = name, seed, k
                if k == 0 or over:
                    observation, info = env.reset(seed=seed if k == 0 else None)
                    rest = 0.0, False, False
                else:
                    observation, *rest, info = env.step(actions[k - 1, b])
                if k:
                    assert [value[b] for value in call[1:4]] == list(rest), where
                assert_bits(call[0], b, observation, where)
                assert_bits(call[-1], b, info, where)
                over = rest[1] or rest[2]
                ended, crashed = ended + over, crashed + int(over and bool(info["collision"]))
    return ended, crashed


@pytest.mark.parametrize("name", IDS)
def test_every_id_gives_the_same_bits_in_one_and_in_many(name):
    arguments = SMALL.get(kind_of(name), {})
    compare(name, [5, 6, 7], {"Revisit": 8, "Branches": 4}.get(kind_of(name), 40), **arguments)


@pytest.mark.parametrize("case", OTHERS)
def test_other_arguments_give_the_same_bits(case):
    name, arguments = OTHERS[case]
    compare(f"StereoSlam/{name}-v0", [1, 2], 30, **{**QUICK, "surroundings": "groves", **arguments})


def test_episodes_go_on_to_their_ends():
    """Crashes, the end of the route, and what comes after."""
    ended, crashed = compare("StereoSlam/Drive-v0", range(4), 100, lane=50.0, **QUICK)
    assert 0 < crashed <= ended
    assert compare("StereoSlam/Drive-v0", range(2), 90, policy="route", **QUICK) == (2, 0)
    assert compare("StereoSlam/Gaze-v0", range(2), 90, **QUICK) == (2, 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_many_episodes_give_the_same_bits(name):
    """To their ends and beyond, or, of long tasks, half a minute of the drive."""
    steps = {"Revisit": 12, "Branches": 4, "Explore": 45, "ClosedLoop": 60, "Follow": 30, "ActiveGaze": 17}.get(
        kind_of(name), 85
    )
    compare(name, range(100, 116), steps, **SMALL.get(kind_of(name), {}))


@pytest.mark.parametrize("name", ["StereoSlam/Gaze-v0", "StereoSlam/Drive-v0"])
def test_a_kept_scene_is_driven_through_again(name):
    with gym.make(name, disable_env_checker=True, **QUICK) as env:
        env.reset(seed=1)
        points = env.unwrapped.landmark_truth().positions
        _, info = env.reset(seed=2, options={"scene": "keep"})
        kept = env.unwrapped.landmark_truth().positions
        _, alone = env.reset(seed=2)
        other = env.unwrapped.landmark_truth().positions
    np.testing.assert_array_equal(kept, points)
    assert kept.shape != other.shape or not np.array_equal(kept, other)
    np.testing.assert_array_equal(info["truth_linear_velocity"], alone["truth_linear_velocity"])
    vector = gym.make_vec(name, num_envs=2, **QUICK)
    vector.reset(seed=[1, 3])
    _, together = vector.reset(seed=[2, 4], options={"scene": "keep"})
    assert_bits(together, 0, info, name)
