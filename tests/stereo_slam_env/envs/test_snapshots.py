"""An environment that is set back to a snapshot goes on with the same bits: every id, single and many (40 s)."""

import copy
import pickle
from contextlib import closing
from zlib import crc32

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import BeliefObservation, InformationGain, restore, snapshot

from .test_one_and_many import IDS, SMALL, actions_of, kind_of

QUICK = {"route": "right-turn", "rig": "qvga"}


def bits(value):
    """Everything in observations, rewards and infos as bytes."""
    if isinstance(value, dict):
        return {key: bits(each) for key, each in value.items()}
    if isinstance(value, tuple | list):
        return [bits(each) for each in value]
    array = np.asarray(value)
    return bits(array.tolist()) if array.dtype == object else (array.dtype.str, array.shape, array.tobytes())


def go_on(env, actions):
    """Step on, over the ends of episodes: a single environment is reset without a seed."""
    calls = []
    for action in actions:
        call = env.step(action)
        calls.append(bits(call))
        if not hasattr(env, "num_envs") and (call[2] or call[3]):
            calls.append(bits(env.reset()))
    return calls


def assert_goes_on_again(make, before=3, after=5):
    """Run on, go back, run on again; then in another environment, from a pickle."""
    with closing(make()) as env, closing(make()) as other:
        env.reset(seed=4)
        actions = actions_of(env.action_space, before + after)
        go_on(env, actions[:before])
        taken = snapshot(env)
        wanted = go_on(env, actions[before:])
        go_on(env, actions[:2])
        restore(env, taken)
        assert go_on(env, actions[before:]) == wanted
        other.reset(seed=9)
        restore(other, pickle.loads(pickle.dumps(copy.deepcopy(taken))))
        assert go_on(other, actions[before:]) == wanted


def single(name, **arguments):
    return gym.make(name, disable_env_checker=True, **arguments)


@pytest.mark.parametrize("name", IDS)
def test_every_id_goes_on_from_a_snapshot(name):
    arguments = SMALL.get(kind_of(name), {})
    many = {"Drive": 60, "DriveGaze": 60, "Branches": 5, "Revisit": 5}.get(kind_of(name), 50)  # over crashes, too
    before = 1 + crc32(name.encode()) % 9
    assert_goes_on_again(lambda: single(name, **arguments), before, many)
    assert_goes_on_again(lambda: gym.make_vec(name, num_envs=3, **arguments), before, many)


@pytest.mark.parametrize(
    "arguments",
    [
        {"physics": "bullet", "moving_cars": 3, "policy": "route"},
        {"noise": "heavy-tailed", "moving_cars": 3, "pedestrians": 2, "policy": "route"},
        {"moving_cars": 3, "moving_landmarks": 6, "bus": "pulls-away", "lasting": 0.5, "policy": "route"},
        {"sensor": "images", "randomise": True, "policy": "route"},
        {"render_images": True, "blank_from": 0.3, "policy": "route"},
    ],
)
def test_other_arguments_are_part_of_it(arguments):
    assert_goes_on_again(lambda: single("StereoSlam/Drive-v0", **QUICK, **arguments))


@pytest.mark.parametrize("filter_name", ["shared-anchor", "filterpy-ekf"])
def test_filters_and_wrappers_of_ours_and_of_others_are_part_of_it(filter_name):
    def make():
        env = BeliefObservation(single("StereoSlam/Gaze-v0", **QUICK, max_landmarks=12), filter=filter_name)
        env = InformationGain(env, report_both=True, nees_gate=0.95)
        return gym.wrappers.RecordEpisodeStatistics(gym.wrappers.TimeLimit(env, 6))

    def times_apart(calls):
        for call in calls:
            call[-1].get("episode", {}).pop("t", None)
        return calls

    with make() as env:
        env.reset(seed=1)
        actions = actions_of(env.action_space, 8)
        go_on(env, actions[:3])
        taken = snapshot(env)
        wanted = times_apart(go_on(env, actions))
        restore(env, taken)
        assert times_apart(go_on(env, actions)) == wanted


def test_vectors_with_beliefs_and_a_pool_go_on():
    how = {"belief": {"filter": "dual-bearing"}, "panorama": {}, "information": {}, "scenes": 2, "threads": 2}
    assert_goes_on_again(lambda: gym.make_vec("StereoSlam/Gaze-v0", num_envs=4, max_episode_steps=6, **QUICK, **how))


def test_a_snapshot_of_another_environment_is_refused():
    with single("StereoSlam/Gaze-v0", **QUICK) as env, single("StereoSlam/Gaze-v0") as other:
        env.reset(seed=1)
        with pytest.raises(ValueError, match="snapshot must be one of this environment"):
            restore(other, snapshot(env))
        assert bits(env.step(env.action_space.sample() * 0))
    with gym.make("CartPole-v1") as env, pytest.raises(ValueError, match="snapshot needs an environment StereoSlam"):
        snapshot(env)
