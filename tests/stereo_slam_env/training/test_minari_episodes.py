"""Episodes go into a Minari data set and come back as they were (5 s)."""

import os
import socket

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.wrappers import TransformReward

from filters import make_filter
from stereo_slam_env import stereo_observation
from stereo_slam_env.policies import make_policy
from stereo_slam_env.training.task import GAZE_FILTER, GazeTask
from stereo_slam_env.wrappers import InformationGain

pytest.importorskip("minari", reason="needs the extra rl")
from stereo_slam_env.training.minari_episodes import (
    export_episodes,
    load_episodes,
    recording_of_episode,
    seed_of,
)

STEPS = 12
SEEDS = (3, 8)
ID = "gaze/random-v0"


def wrapped():
    return InformationGain(GazeTask(arguments={"route": "right-turn"}).make(), of="pose", resolution=(0.01, 0.001))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("minari")


@pytest.fixture(scope="module")
def dataset(folder):
    before = os.environ.get("MINARI_DATASETS_PATH")
    env = wrapped()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "connect", lambda *_: pytest.fail("Minari wanted the network"))
        export_episodes(env, make_policy("random", seconds=0.3), SEEDS, ID, folder, steps=STEPS, algorithm="random")
    env.close()
    assert os.environ.get("MINARI_DATASETS_PATH") == before
    return load_episodes(ID, folder)


def at(values, step):
    return {key: value[step] for key, value in values.items()}


def test_the_episodes_are_there_with_their_seeds(dataset, folder):
    assert (folder / ID / "data").is_dir()
    assert len(dataset) == 2
    assert [seed_of(dataset, k) for k in range(2)] == list(SEEDS)
    assert dataset.total_steps == 2 * STEPS
    assert dataset.storage.metadata["algorithm_name"] == "random"
    assert not np.array_equal(dataset[0].actions, dataset[1].actions)
    for episode in dataset:
        assert episode.truncations.tolist() == [False] * (STEPS - 1) + [True]
        assert not episode.terminations.any()


def test_in_the_recovered_environment_the_actions_give_the_same_bits(dataset):
    env = dataset.recover_environment()
    assert env.observation_space == dataset.observation_space
    for index, episode in enumerate(dataset):
        observation, info = env.reset(seed=seed_of(dataset, index))
        for step, action in enumerate(episode.actions):
            assert data_equivalence(at(episode.observations, step), dict(sorted(observation.items())), exact=True)
            assert np.array_equal(episode.infos["truth_position"][step], info["truth_position"])
            observation, reward, *_, info = env.step(action)
            assert reward == episode.rewards[step]
        assert data_equivalence(at(episode.observations, STEPS), dict(sorted(observation.items())), exact=True)
    env.close()


def test_a_filter_runs_on_what_was_kept(dataset):
    """The recording has what the environment told its own filter, so the belief is that in the observations."""
    episode, recording = dataset[1], recording_of_episode(dataset, 1)
    slam = make_filter("shared-anchor", camera=recording.camera, noise=recording.noise, **GAZE_FILTER)
    slam.reset(recording.start)
    assert len(recording.frames) == STEPS + 1
    for step, frame in enumerate(recording.frames):
        if step > 0:
            slam.predict(0.1, frame.odometry)
        slam.update(frame.observation)
        seen = stereo_observation(at(episode.observations, step), at(episode.infos, step))
        assert np.array_equal(seen.ids, frame.observation.ids)
        assert np.array_equal(seen.v_right, frame.observation.v_right)
        assert np.array_equal(seen.uvd, frame.observation.uvd.astype(np.float32))
        assert np.array_equal(slam.pose.position.astype(np.float32), episode.observations["belief_position"][step])


def test_one_clear_line_where_it_cannot_be(dataset, folder):
    env = wrapped()
    policy = make_policy("fixed")
    with pytest.raises(ValueError, match="dataset_id 'gaze/random-v0' is taken"):
        export_episodes(env, policy, SEEDS, ID, folder)
    with pytest.raises(ValueError, match="dataset_id must be like 'gaze/sweep-v0', got 'gaze'"):
        export_episodes(env, policy, SEEDS, "gaze", folder)
    with pytest.raises(ValueError, match="seeds must name at least one episode"):
        export_episodes(env, policy, [], "gaze/none-v0", folder)
    with pytest.raises(ValueError, match="env cannot be made again"):
        export_episodes(TransformReward(env, lambda reward: reward), policy, SEEDS, "gaze/lambda-v0", folder)
    with pytest.raises(ValueError, match="there is no data set 'gaze/other-v0'"):
        load_episodes("gaze/other-v0", folder)
    env.close()
    assert [path.name for path in (folder / "gaze").iterdir() if path.is_dir()] == ["random-v0"]


def test_frames_that_were_skipped_make_no_recording(tmp_path):
    env = GazeTask(arguments={"route": "right-turn"}).make(hold=2)
    dataset = export_episodes(env, make_policy("sweep"), [0], "gaze/skips-v0", tmp_path, steps=3)
    env.close()
    with pytest.raises(ValueError, match="skips frames: export with hold=1"):
        recording_of_episode(dataset, 0)


def test_without_minari_one_line_says_what_brings_it(monkeypatch, folder):
    monkeypatch.setattr("filters.contract.extras.find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r'^minari is missing: .* -m pip install "stereo-slam-env\[rl\]"$'):
        load_episodes(ID, folder)
