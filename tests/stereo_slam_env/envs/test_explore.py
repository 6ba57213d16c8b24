"""Only a map earns (10 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import explore_by_looking, follow_route

TERMS = ("coverage", "path", "time", "collision")


def episode(choose, seed=1, **arguments):
    """Return, the info of every step, and whether the episode was cut."""
    with gym.make("StereoSlam/Explore-v0", disable_env_checker=True, **arguments) as env:
        observation, info = env.reset(seed=seed)
        total, infos, over = 0.0, [info], False
        while not over:
            action = choose(observation, len(infos) - 1)
            observation, reward, terminated, truncated, info = env.step(action)
            total, over = total + reward, terminated or truncated
            infos.append(info)
    return total, infos, truncated


@pytest.fixture(scope="module")
def looking():
    return episode(lambda seen, _: explore_by_looking(seen))


def test_the_reward_is_the_map_minus_what_it_cost(looking):
    total, infos, _ = looking
    sums = {term: sum(info[f"reward_{term}"] for info in infos) for term in TERMS}
    last = infos[-1]
    assert total == pytest.approx(sum(sums.values()))
    assert sums["coverage"] == pytest.approx(20.0 * (last["coverage"] - infos[0]["coverage"]))
    assert sums["path"] == pytest.approx(-0.01 * last["path_length"])
    assert sums["time"] == pytest.approx(-0.05 * last["time"])


def test_what_is_mapped_stays_mapped_and_who_looks_about_succeeds(looking):
    _, infos, _ = looking
    coverage = [info["coverage"] for info in infos]
    assert (np.diff(coverage) >= 0.0).all()
    assert coverage[0] < 0.1
    assert infos[-1]["is_success"] == (coverage[-1] >= 0.5)
    assert 0.2 < coverage[-1] <= 1.0


def returns_of(*rules, scenes=6, first=40):
    """Mean returns of rules (seen, step) in the same scenes, all in one vector."""
    vector = gym.make_vec("StereoSlam/Explore-v0", num_envs=scenes * len(rules))
    observation, _ = vector.reset(seed=list(range(first, first + scenes)) * len(rules))
    returns, going, step = np.zeros(vector.num_envs), np.ones(vector.num_envs, dtype=bool), 0
    actions = np.zeros(vector.action_space.shape, np.float32)
    while going.any():
        for b in np.flatnonzero(going):
            actions[b] = rules[b // scenes]({key: values[b] for key, values in observation.items()}, step)
        observation, rewards, terminated, truncated, _ = vector.advance(actions, going)
        returns, going, step = returns + np.where(going, rewards, 0.0), going & ~(terminated | truncated), step + 1
    vector.close()
    return returns.reshape(len(rules), scenes).mean(axis=1)


def blind_sweep(seen, step):
    """Two seconds to either side, whatever is there."""
    action = follow_route(seen, 5, speed=8.0)
    action[3] = 0.35 if step % 40 < 20 else -0.35
    return action


def test_who_looks_where_landmarks_are_has_more_than_a_blind_sweep():
    looking, blind = returns_of(lambda seen, _: explore_by_looking(seen), blind_sweep)
    assert looking > blind + 1.0
    assert looking > 2.0


def test_corners_in_images_are_refused():
    with pytest.raises(ValueError, match="sensor must be 'landmarks'"):
        gym.make("StereoSlam/Explore-v0", arguments={"sensor": "images"})
