"""d3rlpy trains on the training task, online and from a data set (15 s); it pins an older Gymnasium."""

import gymnasium as gym
import numpy as np
import pytest

d3rlpy = pytest.importorskip("d3rlpy", reason="needs d3rlpy", exc_type=ImportError)

pytestmark = pytest.mark.slow


@pytest.fixture
def env():
    env = gym.wrappers.FlattenObservation(gym.make("stereo_slam_env:StereoSlam/ActiveGaze-v0", max_episode_steps=10))
    yield env
    env.close()


def test_dqn_online(env):
    dqn = d3rlpy.algos.DQNConfig(batch_size=8).create()
    buffer = d3rlpy.dataset.create_fifo_replay_buffer(limit=100, env=env)
    dqn.fit_online(
        env,
        buffer,
        n_steps=30,
        n_steps_per_epoch=30,
        update_start_step=10,
        logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
        show_progress=False,
    )
    observation, _ = env.reset(seed=0)
    assert dqn.predict(observation[None])[0] in range(env.action_space.n)
    assert buffer.transition_count > 0


def test_dqn_from_a_data_set(env):
    rng = np.random.default_rng(0)
    episodes = []
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        rows, over = [], False
        while not over:
            action = int(rng.integers(env.action_space.n))
            following, reward, terminated, truncated, _ = env.step(action)
            rows.append((observation, [action], [reward]))
            observation, over = following, terminated or truncated
        episode = [np.array(column, dtype=np.float32) for column in zip(*rows, strict=True)]
        episodes.append(d3rlpy.dataset.Episode(episode[0], episode[1].astype(int), episode[2], terminated=False))
    data = d3rlpy.dataset.create_infinite_replay_buffer(episodes)
    dqn = d3rlpy.algos.DQNConfig(batch_size=8).create()
    results = dqn.fit(
        data,
        n_steps=10,
        n_steps_per_epoch=5,
        logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
        show_progress=False,
    )
    assert np.isfinite([metrics["loss"] for _, metrics in results]).all()
