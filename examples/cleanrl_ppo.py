"""Proximal policy optimisation in one file of PyTorch: an agent turns the head so that the estimate becomes true.

In Gymnasium's autoreset mode NEXT_STEP (the default of `make_vec`) the step after the end of an episode is its reset:
it ignores the action and its reward is 0. The rollout keeps such steps, because their observation begins the next
episode, but they are left out of the loss.

Run it (extra rl): python examples/cleanrl_ppo.py --steps 30000. A minute of one core: the environments, with a filter
in the loop of each, run in lock-step. It prints the mean return of the episodes that ended in each rollout, minus the
sum of the squared true errors, m^2; at the end the returns of a fixed gaze and of the network on other seeds.
"""

import argparse

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers.vector import FlattenObservation
from torch import nn
from torch.distributions import Normal

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import GazeTask

DISCOUNT, GAE_LAMBDA, CLIP, EPOCHS, MINIBATCHES = 0.95, 0.95, 0.2, 10, 4
VALUE_WEIGHT, MAX_GRADIENT, REWARD_SCALE = 0.5, 0.5, 1.0


class Agent(nn.Module):
    """A Gaussian policy and a value function."""

    def __init__(self, observations, actions):
        super().__init__()
        self.mean = perceptron(observations, actions, last_gain=0.01)
        self.value = perceptron(observations, 1, last_gain=1.0)
        self.log_std = nn.Parameter(torch.full((actions,), -0.7))

    def policy(self, observation):
        """Distribution of the action."""
        return Normal(self.mean(observation), self.log_std.exp())


def perceptron(inputs, outputs, last_gain, width=64):
    """Two hidden layers of tanh, with orthogonal weights."""
    layers = [nn.Linear(inputs, width), nn.Linear(width, width), nn.Linear(width, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last_gain), strict=True):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


def advantages(reward, value, next_value, terminated, ended):
    """Generalised advantage estimates (T, E); `next_value` is the value after each step."""
    gains, following = torch.zeros_like(reward), torch.zeros(reward.shape[1])
    for t in reversed(range(len(reward))):
        surprise = reward[t] + DISCOUNT * next_value[t] * ~terminated[t] - value[t]  # a truncated episode has a future
        gains[t] = following = surprise + DISCOUNT * GAE_LAMBDA * ~ended[t] * following
    return gains


def learn(agent, optimizer, batch):
    """Train on a rollout with the clipped objective, in several passes."""
    size = len(batch["gain"])
    for _ in range(EPOCHS):
        for rows in torch.randperm(size).chunk(MINIBATCHES):
            part = {name: values[rows] for name, values in batch.items()}
            gain = (part["gain"] - part["gain"].mean()) / (part["gain"].std(correction=0) + 1e-8)
            ratio = (agent.policy(part["observation"]).log_prob(part["action"]).sum(-1) - part["log_prob"]).exp()
            objective = torch.minimum(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            value_error = (agent.value(part["observation"]).squeeze(-1) - part["return"]).square().mean()
            optimizer.zero_grad()
            (VALUE_WEIGHT * value_error - objective).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), MAX_GRADIENT)
            optimizer.step()


def mean_return(envs, seed, look):
    """Mean return of the first episode of each environment."""
    observation, _ = envs.reset(seed=seed)
    total, running = np.zeros(envs.num_envs), np.ones(envs.num_envs, bool)
    while running.any():
        observation, reward, terminated, truncated, _ = envs.step(look(torch.as_tensor(observation)))
        total += reward * running
        running &= ~(terminated | truncated)
    return total.mean()


def main():
    """Train, and compare with a fixed gaze."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=30_000, help="decisions of all environments together")
    parser.add_argument("--rollout", type=int, default=128, help="decisions of each between two updates")
    parser.add_argument("--environments", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--route", default="straight")
    given = parser.parse_args()
    torch.manual_seed(given.seed)
    torch.set_num_threads(1)  # so small a network is slower on several
    belief = {"options": GazeTask().filter_options, "hold": 4}  # a decision holds for 0.4 s
    loop = {"belief": belief, "panorama": {}, "error": {}}
    kind = {**loop, "keys": ["belief_sigmas", "head", "panorama"], "route": given.route}
    envs = FlattenObservation(gym.make_vec("StereoSlam/Gaze-v0", given.environments, **kind))
    assert envs.metadata["autoreset_mode"] is gym.vector.AutoresetMode.NEXT_STEP
    agent = Agent(envs.single_observation_space.shape[0], envs.single_action_space.shape[0])
    optimizer = torch.optim.Adam(agent.parameters(), lr=5e-4)

    shape = (given.rollout, given.environments)
    observation = torch.as_tensor(envs.reset(seed=given.seed)[0])
    is_reset = np.zeros(given.environments, bool)  # whether the next step only begins another episode
    paid = np.zeros(given.environments)  # in the episode so far
    for done in range(0, given.steps, given.rollout * given.environments):
        seen, chosen = torch.zeros(*shape, observation.shape[1]), torch.zeros(*shape, *envs.single_action_space.shape)
        finished = []
        log_prob, reward, value, next_value = (torch.zeros(shape) for _ in range(4))
        terminated, ended, counts = (torch.zeros(shape, dtype=torch.bool) for _ in range(3))
        for t in range(given.rollout):
            with torch.no_grad():
                policy = agent.policy(observation)
                action = policy.sample()
                seen[t], chosen[t], counts[t] = observation, action, torch.as_tensor(~is_reset)
                log_prob[t], value[t] = policy.log_prob(action).sum(-1), agent.value(observation).squeeze(-1)
                following, pay, over, cut, _ = envs.step(action.clamp(-1, 1).numpy())
                observation = torch.as_tensor(following)  # at the end of an episode truly its last, in this mode
                next_value[t] = agent.value(observation).squeeze(-1)
            reward[t], terminated[t], ended[t] = (torch.as_tensor(x) for x in (REWARD_SCALE * pay, over, over | cut))
            is_reset = over | cut
            paid += pay
            finished += list(paid[is_reset])
            paid *= ~is_reset
        gain = advantages(reward, value, next_value, terminated, ended)
        names = ("observation", "action", "log_prob", "gain", "return")
        rollout = zip(names, (seen, chosen, log_prob, gain, gain + value), strict=True)
        learn(agent, optimizer, {name: values[counts] for name, values in rollout})
        told = f"{np.mean(finished):.2f}" if finished else "no episode ended"
        print(f"{done + given.rollout * given.environments:>7} decisions: mean return {told}")

    fixed = mean_return(envs, given.seed + 1000, lambda seen: np.zeros(envs.action_space.shape, np.float32))
    network = mean_return(envs, given.seed + 1000, lambda seen: agent.mean(seen).detach().clamp(-1, 1).numpy())
    print(f"on other seeds: fixed gaze {fixed:.2f}, network {network:.2f} m^2")
    envs.close()


if __name__ == "__main__":
    main()
