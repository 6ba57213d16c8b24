"""TorchRL takes single environments and native vectors (15 s)."""

import gymnasium as gym
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)

pytest.importorskip("torchrl", reason="needs torchrl", exc_type=ImportError)

from torchrl.envs import GymEnv, GymWrapper, check_env_specs

pytestmark = pytest.mark.slow
QUICK = {"route": "right-turn", "rig": "qvga", "max_landmarks": 8}


@pytest.mark.parametrize("name", ["Drive", "Gaze", "DriveGaze"])
def test_specifications(name):
    env = GymEnv(f"stereo_slam_env:StereoSlam/{name}-v0", **QUICK)
    check_env_specs(env)
    assert env.rollout(3)["next", "reward"].shape == (3, 1)
    env.close()


def test_specifications_of_the_task():
    env = GymEnv("stereo_slam_env:StereoSlam/ActiveGaze-v0")
    check_env_specs(env)
    env.close()


def test_a_native_vector():
    """With DISABLED, which TorchRL prefers: with SAME_STEP it loses last observations that are dictionaries."""
    mode = gym.vector.AutoresetMode.DISABLED
    vector = gym.make_vec("StereoSlam/Gaze-v0", num_envs=3, autoreset_mode=mode, max_episode_steps=4, **QUICK)
    env = GymWrapper(vector)
    check_env_specs(env)
    rollout = env.rollout(10, break_when_any_done=False)
    assert rollout["next", "uvd"].shape == (3, 10, 8, 3)
    assert rollout["next", "truncated"][:, 3].all()
    # What follows the action that ended an episode is its last observation, not the first of the next episode.
    assert (rollout["next", "progress"][:, 3] > rollout["progress"][:, 3]).all()
    assert (rollout["progress"][:, 4] == 0).all()
    env.close()
