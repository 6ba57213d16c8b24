"""Every task and every level of it keeps Gymnasium's rules."""

import pickle
import warnings

import gymnasium as gym
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env, data_equivalence

import stereo_slam_env  # noqa: F401 (registers the ids)

QUICK = {
    "StereoSlam/ActiveGaze-v0": {"arguments": {"route": "right-turn"}},
    "StereoSlam/Explore-v0": {"arguments": {"route": "right-turn"}},
    "StereoSlam/Revisit-v0": {"begin": (0.05, 0.1)},
    "StereoSlam/Branches-v0": {"roads": 2},
    "StereoSlam/ClosedLoop-v0": {"arguments": {"route": "right-turn", "rig": "qvga"}},
    "StereoSlam/Follow-v0": {"arguments": {"rig": "qvga", "max_landmarks": 30, "moving_landmarks": 20}},
}
LEVELS = [name.replace("-v0", f"-{level}-v0") for name in QUICK for level in ("easy", "hard")]


def made(name, **arguments):
    """An environment that is over soon, unless the arguments say otherwise."""
    usual = QUICK[name.replace("-easy", "").replace("-hard", "")]
    return gym.make(name, disable_env_checker=True, **{**usual, **arguments})


def rollout(env, actions):
    observation, _ = env.reset(seed=3)
    results = [observation]
    for action in actions:
        results.append(env.step(action)[:4])
        if results[-1][2]:
            break
    env.close()
    return results


@pytest.mark.parametrize("name", QUICK)
def test_the_checker_finds_nothing(name):
    env = made(name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("name", QUICK)
def test_a_task_is_the_same_from_its_spec_and_from_a_pickle(name):
    env = made(name)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(3)]
    again, copied = gym.make(EnvSpec.from_json(env.spec.to_json())), pickle.loads(pickle.dumps(env))
    results = [rollout(one, actions) for one in (env, again, copied)]
    assert data_equivalence(results[0], results[1], exact=True)
    assert data_equivalence(results[0], results[2], exact=True)


@pytest.mark.parametrize("name", [*QUICK, *LEVELS])
def test_observations_are_in_their_space_and_info_keeps_its_keys(name):
    env, normal = made(name), made(name.replace("-easy", "").replace("-hard", ""))
    assert (env.observation_space, env.action_space) == (normal.observation_space, normal.action_space)
    observation, first = env.reset(seed=1)
    assert observation in env.observation_space
    env.action_space.seed(1)
    for _ in range(3):
        observation, _, terminated, _, info = env.step(env.action_space.sample())
        assert observation in env.observation_space
        assert info.keys() == first.keys()
        if terminated:
            break
    env.close()


def test_an_unknown_level_gets_one_clear_line():
    with pytest.raises(ValueError, match=r"level must be .*, got 'hrad'") as error:
        made("StereoSlam/Explore-v0", level="hrad")
    assert "\n" not in str(error.value)


def test_traffic_is_only_where_a_script_drives():
    with_cars = [name for name in LEVELS if made(name).unwrapped.options.moving_cars]
    assert with_cars == ["StereoSlam/ActiveGaze-hard-v0", "StereoSlam/Revisit-hard-v0"]
