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


def test_it_decides_as_written_down_and_with_choices_the_largest_output_wins():
    choices, seen = np.array([[-1.0, 0.0], [0.0, 0.5], [1.0, 0.0]]), observation()
    for network in (small_network(), small_network(choices=choices)):
        x = np.concatenate([seen["head"], seen["panorama"].ravel()])
        x = np.clip((x - network.mean) / network.scale, -2, 2)
        outputs = network.weights[1] @ np.tanh(network.weights[0] @ x + network.biases[0]) + network.biases[1]
        expected = np.clip(outputs, -1, 1) if network.choices is None else choices[outputs.argmax()]
        np.testing.assert_allclose(network.action(seen), expected, rtol=1e-6)
    assert small_network().action(seen).dtype == np.float32
    assert len({tuple(network.action(observation(k))) for k in range(20)}) > 1


@pytest.mark.parametrize("choices", [None, np.array([[-1.0, 0.0], [1.0, 0.0]])], ids=["outputs", "choices"])
def test_it_comes_back_from_its_file(tmp_path, choices):
    network, seen = small_network(choices=choices), observation()
    network.save(tmp_path / "n.npz")
    back = Network.load(tmp_path / "n.npz")
    np.testing.assert_allclose(back.action(seen), network.action(seen), atol=1e-5)
    assert back.about == network.about


def test_a_file_that_is_no_network_gets_one_clear_line(tmp_path):
    file = tmp_path / "n.npz"
    with pytest.raises(ValueError, match="does not exist: make one with stereo-slam train"):
        NetworkPolicy(str(file))
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    np.savez(tmp_path / "future.npz", json=np.array(json.dumps({"format": 99})))
    written = [(tmp_path / f"{name}.npz").read_bytes() for name in ("other", "future")]
    for content in (b"", b"PK\x03\x04 cut", b"text", *written):
        file.write_bytes(content)
        with pytest.raises(ValueError, match=r"\A[^\n]*n\.npz is not a network written by stereo-slam train[^\n]*\Z"):
            make_policy("ppo", checkpoint=str(file))


def test_nothing_in_a_file_is_executed(tmp_path):
    """A file with pickled objects is refused, not unpickled."""

    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "trapped"), "w"))

    np.savez(tmp_path / "n.npz", json=np.array([Trap()], dtype=object))
    with pytest.raises(ValueError, match="is not a network"):
        Network.load(tmp_path / "n.npz")
    assert not (tmp_path / "trapped").exists()


def test_a_decision_holds_and_other_observations_are_refused(tmp_path):
    small_network(hold=3).save(tmp_path / "n.npz")
    policy, env = NetworkPolicy(str(tmp_path / "n.npz")), StereoGazeEnv(route="right-turn")
    policy.reset(env, np.random.default_rng(0))
    actions = [policy.act(observation(k)) for k in range(6)]
    assert all(np.array_equal(actions[0], action) for action in actions[:3])
    assert not np.array_equal(actions[2], actions[3])
    policy.reset(env, np.random.default_rng(0))
    with pytest.raises(ValueError, match="'panorama', which is not in the observation: add BeliefPanorama"):
        policy.act({"head": np.zeros(2)})
    with pytest.raises(ValueError, match=r"sees 5 numbers, and the observation has 8 \(head, panorama\): train one"):
        policy.act({"head": np.zeros(2), "panorama": np.zeros((6, 1))})


def test_the_network_of_the_package_says_how_it_was_made_and_was_trained_on_todays_task():
    network = NetworkPolicy().network
    env = single(GazeTask(pans=None))
    assert network.action(env.reset(seed=0)[0]) in env.action_space
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
