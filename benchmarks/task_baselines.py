"""Baselines in the tasks of `stereo_slam_env.tasks`, on scenes that nothing was tuned on.

Run it: python benchmarks/task_baselines.py --episodes 20. It takes a quarter of an hour of one core. For every agent
it shows the interquartile mean of the returns with its 95 % bootstrap interval, and the share of successes.
"""

import argparse
from functools import partial

import gymnasium as gym
import numpy as np
from joblib import Parallel, delayed
from scipy.stats import bootstrap, trim_mean

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.policies import follow_route
from stereo_slam_env.tasks import close_if_it_pays, drive_slowly, explore_by_sweeping

SEED = 20_000
"""The first one; rules were tuned on seeds below 100."""
EXPLORE, REVISIT, CLOSED = "StereoSlam/Explore-v0", "StereoSlam/Revisit-v0", "StereoSlam/ClosedLoop-v0"
HARD = {name: name.replace("-v0", "-hard-v0") for name in (EXPLORE, REVISIT, CLOSED)}


def randomly(_, __, space):
    """An action at random."""
    return space.sample()


def brake(_, __, space):
    """Stand still, and never stop the episode."""
    return -np.eye(space.shape[0], dtype=np.float32)[0]


def stop(_, __, space):
    """Stop the episode at once."""
    return 0 if isinstance(space, gym.spaces.Discrete) else np.eye(space.shape[0], dtype=np.float32)[2]


def go_on(*_):
    """Never stop."""
    return 1


def ahead(seen, *_):
    """Follow the route, and look straight ahead."""
    return follow_route(seen, 5)


def sweep(seen, step, _):
    """See `explore_by_sweeping`."""
    return explore_by_sweeping(seen, step)


def closing(seen, *_):
    """See `close_if_it_pays`."""
    return close_if_it_pays(seen)


def fast(seen, *_):
    """Follow the route."""
    return follow_route(seen)


def slow(seen, *_):
    """See `drive_slowly`."""
    return drive_slowly(seen)


DEAD = {"filter": "dead-reckoning"}
ROWS = [
    (EXPLORE, {}, {"stop at once": stop, "brake": brake, "random": randomly, "look ahead": ahead, "sweep": sweep}),
    (HARD[EXPLORE], {}, {"sweep": sweep}),
    (REVISIT, {}, {"stop at once": stop, "random": randomly, "go on": go_on, "close if it pays": closing}),
    (HARD[REVISIT], {}, {"close if it pays": closing}),
    (CLOSED, {}, {"brake": brake, "random": randomly}),
    *((CLOSED, {"latency": n}, {"follow the route": fast, "5 m/s": slow}) for n in (0, 2, 5)),
    *((CLOSED, {"latency": n, **DEAD}, {"follow the route": fast, "5 m/s": slow}) for n in (0, 2, 5)),
    (HARD[CLOSED], {}, {"follow the route": fast, "5 m/s": slow}),
]
"""Id, arguments and agents."""


def episode(name, arguments, choose, seed):
    """Return, highest return on the way, success, steps, and the largest cross-track error (or NaN)."""
    env = gym.make(name, disable_env_checker=True, **arguments)
    observation, info = env.reset(seed=seed)
    env.action_space.seed(seed)
    total, best, steps, over, off = 0.0, 0.0, 0, False, 0.0
    while not over:
        observation, reward, terminated, truncated, info = env.step(choose(observation, steps, env.action_space))
        total, steps, over = total + reward, steps + 1, terminated or truncated
        best, off = max(best, total), max(off, info.get("cross_track", np.nan))
    env.close()
    return total, best, float(info["is_success"]), steps, off


def show(name, arguments, agent, returns, successes, steps, off):
    """Print a row of the table."""
    middle = partial(trim_mean, proportiontocut=0.25)
    low, high = bootstrap((returns,), middle, method="percentile", rng=0).confidence_interval
    given = ", ".join(f"{key} {value}" for key, value in arguments.items())
    print(
        f"| {name.partition('/')[2]} | {given} | {agent} | {middle(returns):.1f} | {low:.1f} to {high:.1f} | "
        f"{returns.mean():.2f} | {successes.mean():.0%} | {steps.mean():.0f} | {off.mean():.2f} |",
        flush=True,
    )


def main():
    """Run everything."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", default="", help="a part of the id")
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args()
    pool = Parallel(given.processes)
    print("| task | arguments | agent | IQM | 95 % interval | mean | success | steps | off the route, m |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, arguments, agents in ROWS:
        if given.only not in name:
            continue
        for agent, choose in agents.items():
            seeds = range(given.seed, given.seed + given.episodes)
            rows = pool(delayed(episode)(name, arguments, choose, seed) for seed in seeds)
            returns, best, *others = np.array(rows).T
            show(name, arguments, agent, returns, *others)
            if choose is go_on:  # who knows what comes stops at the highest return; no agent can
                show(name, arguments, "hindsight", best, best > 0.0, *others[1:])


if __name__ == "__main__":
    main()
