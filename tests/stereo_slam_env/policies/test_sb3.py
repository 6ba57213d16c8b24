"""Vector environments under stable-baselines3: its conventions, wrappers and learners (5 s)."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import FlattenObservation, RecordEpisodeStatistics

import stereo_slam_env  # noqa: F401 (registers the ids)

sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra rl")

from stable_baselines3.common.evaluation import evaluate_policy  # noqa: E402
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize  # noqa: E402

from stereo_slam_env.policies import SB3VecEnv  # noqa: E402

QUICK = {"route": "right-turn", "rig": "qvga", "max_landmarks": 8, "scenes": 2}
EPISODE = 3
SAME_STEP, DISABLED = AutoresetMode.SAME_STEP, AutoresetMode.DISABLED


def vector_of(name="Gaze", mode=SAME_STEP, num_envs=2, **options):
    options = {**QUICK, "max_episode_steps": EPISODE, **options}
    return gym.make_vec(f"StereoSlam/{name}-v0", num_envs=num_envs, autoreset_mode=mode, **options)


def stepped(env, count, action=0.1):
    actions = np.full((env.num_envs, *env.action_space.shape), action, dtype=np.float32)
    return [env.step(actions) for _ in range(count)]


@pytest.fixture(params=[SAME_STEP, DISABLED], ids=lambda mode: mode.name)
def env(request):
    env = SB3VecEnv(vector_of(mode=request.param), info_keys=["distance", "truth_position"])
    env.seed(3)
    yield env
    env.close()


def test_each_step_gives_what_the_vector_gives(env):
    vector = vector_of()
    expected, info = vector.reset(seed=3)
    assert env.reset().keys() == expected.keys()
    assert env.reset_infos[1]["distance"] == info["distance"][1]
    found = stepped(env, 2)
    for _ in range(2):
        expected, rewards, *_, info = vector.step(np.full((2, 2), 0.1, dtype=np.float32))
    for key, value in expected.items():
        np.testing.assert_array_equal(found[-1][0][key], value)
    np.testing.assert_array_equal(found[-1][1], rewards.astype(np.float32))
    assert found[-1][2].tolist() == [False, False]
    for b, row in enumerate(found[-1][3]):
        assert row.keys() == {"distance", "truth_position"}
        np.testing.assert_array_equal(row["truth_position"], info["truth_position"][b])


def test_the_end_of_an_episode_is_described_as_its_learners_want(env):
    first = env.reset()
    observation, _, dones, infos = stepped(env, EPISODE)[-1]
    assert dones.all()
    for b, info in enumerate(infos):
        assert info["TimeLimit.truncated"] is True
        assert not info["is_success"]
        assert info["distance"] > 0  # of the episode that has ended
        assert env.observation_space.contains(info["terminal_observation"])
        assert info["terminal_observation"]["progress"] > observation["progress"][b] == first["progress"][b] == 0
    assert all("terminal_observation" not in info for info in stepped(env, 1)[-1][3])


def test_the_end_of_the_route_is_no_truncation():
    env = SB3VecEnv(vector_of(max_episode_steps=-1))
    env.reset()
    infos = next(infos for *_, dones, infos in stepped(env, 400) if dones.all())
    assert infos[0]["is_success"]
    assert infos[0]["TimeLimit.truncated"] is False


def test_environments_that_start_again_in_the_next_step_are_refused():
    with pytest.raises(ValueError, match=r"autoreset_mode=AutoresetMode\.SAME_STEP or DISABLED"):
        SB3VecEnv(vector_of(mode=AutoresetMode.NEXT_STEP))


def test_attributes_and_methods_are_those_of_the_vector(env):
    assert env.get_attr("max_episode_steps") == [EPISODE, EPISODE]
    assert env.get_attr("num_envs", indices=0) == [2]
    assert env.has_attr("options")
    assert not env.has_attr("nothing")
    env.set_attr("mark", 7)
    assert env.vector_env.mark == 7
    assert env.env_method("reset", seed=1)[0][0].keys() == env.observation_space.keys()
    assert env.env_is_wrapped(gym.Wrapper) == [False, False]
    with pytest.raises(ValueError, match="to all"):
        env.set_attr("mark", 7, indices=[1])


def test_a_vector_of_gymnasium_itself_is_taken_too():
    vector = gym.make_vec("CartPole-v1", 2, "sync", vector_kwargs={"autoreset_mode": SAME_STEP}, max_episode_steps=2)
    env = SB3VecEnv(vector)
    env.reset()
    *_, infos = [env.step(np.array([0, 1])) for _ in range(2)][-1]
    assert infos[0]["terminal_observation"].shape == (4,)
    assert infos[0]["TimeLimit.truncated"]


def test_statistics_of_gymnasium_reach_the_loggers(env):
    wrapped = SB3VecEnv(RecordEpisodeStatistics(env.vector_env))
    wrapped.reset()
    steps = stepped(wrapped, EPISODE)
    total = sum(rewards[1] for _, rewards, *_ in steps)
    assert steps[-1][3][1]["episode"]["l"] == EPISODE
    assert steps[-1][3][1]["episode"]["r"] == pytest.approx(total)


def test_monitor_and_normalisation():
    env = VecNormalize(VecMonitor(SB3VecEnv(vector_of("DriveGaze")), info_keywords=("is_success",)))
    env.seed(1)
    assert np.abs(env.reset()["uvd"]).max() <= 10.0
    episode = stepped(env, EPISODE)[-1][3][0]["episode"]
    assert episode["l"] == EPISODE
    assert not episode["is_success"]


def test_ppo_learns_from_dictionaries():
    env = VecMonitor(SB3VecEnv(vector_of("DriveGaze")))
    model = sb3.PPO("MultiInputPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0).learn(16)
    assert model.num_timesteps == 16
    assert model.ep_info_buffer[0]["l"] == EPISODE
    _, lengths = evaluate_policy(model, env, 2, return_episode_rewards=True, warn=False)
    assert lengths == [EPISODE, EPISODE]


def test_learners_off_the_policy_take_flat_observations():
    env = SB3VecEnv(FlattenObservation(vector_of(mode=DISABLED)))
    model = sb3.SAC("MlpPolicy", env, seed=0, buffer_size=100, learning_starts=4, batch_size=4).learn(20)
    assert model.num_timesteps == 20
