"""Returns of idle, random, trained and best agents in every task, and their normalised scores.

Run it: python benchmarks/task_scores.py --episodes 50. It takes some five minutes of two cores. The means of the random
and of the best agent are what `stereo_slam_env.policies.scores` calls 0 and 100.
"""

import argparse
from functools import partial

import gymnasium as gym
import numpy as np
from joblib import Parallel, delayed

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.policies import follow_route, make_policy, normalised_score
from stereo_slam_env.training.task import GazeTask
from stereo_slam_env.wrappers import InformationGain

DRIVING = ("StereoSlam/Drive-v0", "StereoSlam/DriveGaze-v0")
SEED = 20_000


class Agent:
    """Actions by `choose` (observation, action space)."""

    def __init__(self, choose):
        self.choose = choose

    def reset(self, env, rng):
        """Begin an episode."""
        self.space = env.action_space
        self.space.seed(int(rng.integers(2**31)))

    def act(self, observation):
        """The next action."""
        return self.choose(observation, self.space)


def idle(_, space):
    """Brake, and look straight ahead."""
    action = np.zeros(space.shape, dtype=np.float32)
    action[0] = -1.0
    return action


AGENTS = {
    "idle": Agent(idle),
    "action 0": Agent(lambda _, space: np.zeros(space.shape, dtype=np.float32)),
    "random": Agent(lambda _, space: space.sample()),
    "follow the route": Agent(lambda observation, space: follow_route(observation, space.shape[0])),
}


def active_gaze():
    """The training task with an action a step, as planners need it: the return telescopes, so it is the same."""
    return InformationGain(GazeTask().make(), of="pose", resolution=GazeTask().resolution)


def episode(make, agent, seed):
    """Return, success and steps of an episode."""
    env = make()
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    agent.reset(env, rng)
    total, steps, over = 0.0, 0, False
    while not over:
        observation, reward, terminated, truncated, info = env.step(agent.act(observation))
        total, steps, over = total + reward, steps + 1, terminated or truncated
    env.close()
    return total, float(info["is_success"]), steps


def show(environment, name, rows):
    """Print the means of an agent."""
    returns, success, steps = np.array(rows).T
    error = returns.std(ddof=1) / np.sqrt(len(returns))
    score = normalised_score(environment, returns).mean()
    print(
        f"{environment:<26} {name:<18} return {returns.mean():8.2f} ± {error:.2f}   score {score:6.1f}   "
        f"success {success.mean():4.0%}   {steps.mean():5.0f} steps",
        flush=True,
    )


def main() -> None:
    """Print the returns of all agents in all tasks."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    seeds = range(SEED, SEED + given.episodes)
    pool = Parallel(given.processes)
    for environment in DRIVING:
        make = partial(gym.make, f"stereo_slam_env:{environment}")
        for name, agent in AGENTS.items():
            show(environment, name, pool(delayed(episode)(make, agent, s) for s in seeds))
    gaze = {name: make_policy(name) for name in ("fixed", "random", "sweep")}
    for name, policy in gaze.items():
        make = partial(gym.make, "stereo_slam_env:StereoSlam/Gaze-v0")
        show("StereoSlam/Gaze-v0", name, pool(delayed(episode)(make, policy, s) for s in seeds))
    for name in ("fixed", "random", "sweep", "greedy", "lookahead", "ppo"):
        show("StereoSlam/ActiveGaze-v0", name, pool(delayed(episode)(active_gaze, make_policy(name), s) for s in seeds))


if __name__ == "__main__":
    main()
