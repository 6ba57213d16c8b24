"""A trained network without the library that trained it."""

import csv
import json
from dataclasses import replace
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest

from stereo_slam_env.envs.active_gaze import GazeTask
from stereo_slam_env.envs.gaze import StereoGazeEnv
from stereo_slam_env.policies import make_policy
from stereo_slam_env.policies.named_policies import CHECKPOINT, Network, NetworkPolicy
from stereo_slam_env.policies.registered_task import PPOSettings


def single(task):
    """One environment of a task."""
    return task.around(gym.make(task.environment, **task.world))


def small_network(seed=0, hold=1, choices=None):
    rng = np.random.default_rng(seed)
    sizes = (5, 8, 2 if choices is None else len(choices))
    return Network(
        keys=("head", "panorama"),
        mean=rng.standard_normal(5),
        scale=rng.uniform(0.5, 2.0, 5),
        clip=2.0,
        weights=tuple(rng.standard_normal((n, m)) for m, n in pairwise(sizes)),
        biases=tuple(rng.standard_normal(n) for n in sizes[1:]),
        about={"task": {"hold": hold}},
        choices=choices,
    )


def observation(seed=1):
    rng = np.random.default_rng(seed)
    return {"head": rng.standard_normal(2), "panorama": rng.standard_normal((3, 1)), "other": np.nan}


def test_it_decides_as_written_down():
    network, seen = small_network(), observation()
    x = np.concatenate([seen["head"], seen["panorama"].ravel()])
    x = np.clip((x - network.mean) / network.scale, -2, 2)
    expected = network.weights[1] @ np.tanh(network.weights[0] @ x + network.biases[0]) + network.biases[1]
    action = network.action(seen)
    np.testing.assert_allclose(action, np.clip(expected, -1, 1), rtol=1e-6)
    assert action.dtype == np.float32


def test_with_choices_the_largest_output_wins():
    choices = np.array([[-1.0, 0.0], [0.0, 0.5], [1.0, 0.0]])
    network = small_network(choices=choices)
    actions = {tuple(network.action(observation(k))) for k in range(20)}
    assert actions <= set(map(tuple, choices.tolist()))
    assert len(actions) > 1
    seen = observation()
    x = np.clip((np.concatenate([seen["head"], seen["panorama"].ravel()]) - network.mean) / network.scale, -2, 2)
    outputs = network.weights[1] @ np.tanh(network.weights[0] @ x + network.biases[0]) + network.biases[1]
    np.testing.assert_array_equal(network.action(seen), choices[outputs.argmax()])


@pytest.mark.parametrize("choices", [None, np.array([[-1.0, 0.0], [1.0, 0.0]])], ids=["outputs", "choices"])
def test_it_comes_back_from_its_file(tmp_path, choices):
    network, seen = small_network(choices=choices), observation()
    network.save(tmp_path / "n.npz")
    back = Network.load(tmp_path / "n.npz")
    np.testing.assert_allclose(back.action(seen), network.action(seen), atol=1e-5)
    assert back.about == network.about


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut", b"text"], ids=["empty", "cut", "text"])
def test_a_damaged_file_gets_one_clear_line(tmp_path, content):
    (tmp_path / "n.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"n\.npz is not a network written by stereo-slam train") as error:
        make_policy("ppo", checkpoint=str(tmp_path / "n.npz"))
    assert "\n" not in str(error.value)


def test_nothing_in_a_file_is_executed(tmp_path):
    """A file with pickled objects is refused, not unpickled."""

    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "trapped"), "w"))

    np.savez(tmp_path / "n.npz", json=np.array([Trap()], dtype=object))
    with pytest.raises(ValueError, match="is not a network"):
        Network.load(tmp_path / "n.npz")
    assert not (tmp_path / "trapped").exists()


def test_other_arrays_and_other_formats_are_refused(tmp_path):
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    np.savez(tmp_path / "future.npz", json=np.array(json.dumps({"format": 99})))
    for name in ("other", "future"):
        with pytest.raises(ValueError, match="is not a network"):
            Network.load(tmp_path / f"{name}.npz")


def test_a_missing_file_says_how_to_make_one(tmp_path):
    with pytest.raises(ValueError, match="does not exist: make one with stereo-slam train"):
        NetworkPolicy(str(tmp_path / "none.npz"))


def test_a_decision_holds(tmp_path):
    small_network(hold=3).save(tmp_path / "n.npz")
    policy, env = NetworkPolicy(str(tmp_path / "n.npz")), StereoGazeEnv(route="right-turn")
    policy.reset(env, np.random.default_rng(0))
    actions = [policy.act(observation(k)) for k in range(6)]
    assert all(np.array_equal(actions[0], action) for action in actions[:3])
    assert not np.array_equal(actions[2], actions[3])


def test_an_observation_without_its_keys_is_refused(tmp_path):
    small_network().save(tmp_path / "n.npz")
    policy = NetworkPolicy(str(tmp_path / "n.npz"))
    policy.reset(StereoGazeEnv(route="right-turn"), np.random.default_rng(0))
    with pytest.raises(ValueError, match="'panorama', which is not in the observation: add BeliefPanorama"):
        policy.act({"head": np.zeros(2)})


def test_an_observation_of_another_size_is_refused(tmp_path):
    small_network().save(tmp_path / "n.npz")
    policy = NetworkPolicy(str(tmp_path / "n.npz"))
    policy.reset(StereoGazeEnv(route="right-turn"), np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"sees 5 numbers, and the observation has 8 \(head, panorama\): train one"):
        policy.act({"head": np.zeros(2), "panorama": np.zeros((6, 1))})


def test_the_network_of_the_package_fits_what_it_is_shown():
    env = single(GazeTask(pans=None))
    observation, _ = env.reset(seed=0)
    assert NetworkPolicy().network.action(observation) in env.action_space
    env.close()


def test_the_network_of_the_package_says_how_it_was_made_and_was_trained_on_todays_task():
    network = NetworkPolicy().network
    task = GazeTask(**network.about["task"])
    assert replace(task, worlds=()) == GazeTask(reward="information")
    assert len(task.worlds) >= 4
    settings = PPOSettings(**network.about["settings"])
    given = {name: getattr(settings, name) for name in ("decisions", "environments", "validation", "seed")}
    assert settings == PPOSettings(**given)
    assert sum(W.size for W in network.weights) < 20_000
    curve = list(csv.DictReader(CHECKPOINT.with_suffix(".csv").open()))
    best = min(curve, key=lambda row: float(row["final_pose_logdet"]))
    assert float(best["final_pose_logdet"]) < float(curve[0]["final_pose_logdet"])
