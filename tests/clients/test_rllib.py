"""RLlib trains on the training task and on a native vector environment (20 s); it pins Gymnasium 1.2.2."""

import gymnasium as gym
import pytest

pytest.importorskip("ray.rllib", reason="needs ray[rllib]", exc_type=ImportError)

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.connectors.env_to_module import FlattenObservations
from ray.tune.registry import register_env

pytestmark = pytest.mark.slow
STEPS, ITERATIONS = 64, 2


@pytest.fixture(scope="module", autouse=True)
def cluster():
    ray.init(num_cpus=2, include_dashboard=False)
    yield
    ray.shutdown()


def train(config):
    """A few iterations of PPO in this process; how many steps the environments did."""
    config = config.training(train_batch_size_per_learner=STEPS, minibatch_size=32, num_epochs=1)
    algorithm = config.build_algo()
    results = [algorithm.train() for _ in range(ITERATIONS)]
    algorithm.stop()
    assert all("default_policy" in result["learners"] for result in results)
    return results[-1]["num_env_steps_sampled_lifetime"]


def test_ppo_on_the_flattened_task():
    def make(_):
        return gym.wrappers.FlattenObservation(gym.make("stereo_slam_env:StereoSlam/ActiveGaze-v0"))

    register_env("task", make)
    runners = {"num_env_runners": 0, "rollout_fragment_length": STEPS}
    assert train(PPOConfig().environment("task").env_runners(**runners)) == ITERATIONS * STEPS


def test_ppo_on_a_native_vector():
    config = PPOConfig().environment(
        "stereo_slam_env:StereoSlam/Gaze-v0", env_config={"route": "right-turn", "rig": "qvga", "max_landmarks": 8}
    )
    config = config.env_runners(
        num_env_runners=0,
        num_envs_per_env_runner=4,
        gym_env_vectorize_mode="vector_entry_point",
        rollout_fragment_length=STEPS // 4,
        env_to_module_connector=lambda *_, **__: FlattenObservations(),
    )
    assert train(config) >= ITERATIONS * STEPS
