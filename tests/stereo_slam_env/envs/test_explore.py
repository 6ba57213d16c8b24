"""Only a map earns (10 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import explore_by_sweeping, follow_route

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
def sweep():
    return episode(explore_by_sweeping)


def test_the_reward_is_the_map_minus_what_it_cost(sweep):
    total, infos, _ = sweep
    sums = {term: sum(info[f"reward_{term}"] for info in infos) for term in TERMS}
    last = infos[-1]
    assert total == pytest.approx(sum(sums.values()))
    assert sums["coverage"] == pytest.approx(20.0 * (last["coverage"] - infos[0]["coverage"]))
    assert sums["path"] == pytest.approx(-0.01 * last["path_length"])
    assert sums["time"] == pytest.approx(-0.05 * last["time"])


def test_what_is_mapped_stays_mapped_and_who_looks_about_succeeds(sweep):
    _, infos, _ = sweep
    coverage = [info["coverage"] for info in infos]
    assert (np.diff(coverage) >= 0.0).all()
    assert coverage[0] < 0.1
    assert infos[-1]["is_success"]
    assert 0.6 < coverage[-1] <= 1.0


def test_looking_about_earns_more_than_looking_ahead_and_that_more_than_standing_still(sweep):
    ahead, *_ = episode(lambda seen, _: follow_route(seen, 5), arguments={"route": "loop"})
    brake, _, truncated = episode(
        lambda *_: np.array([-1, 0, 0, 0, 0], np.float32), max_episode_steps=300, arguments={"route": "loop"}
    )
    assert sweep[0] > ahead + 2.0 > brake + 2.0
    assert truncated
    assert brake == pytest.approx(-1.5, abs=0.5)


def test_the_agent_may_stop():
    total, infos, truncated = episode(lambda *_: np.array([0, 0, 0.6, 0, 0], np.float32))
    assert len(infos) == 2
    assert not truncated
    assert -0.1 < total <= 0.5


def test_a_map_that_is_only_claimed_does_not_count(monkeypatch):
    with gym.make("StereoSlam/Explore-v0", disable_env_checker=True) as env:
        env.reset(seed=1)
        slam = env.get_wrapper_attr("slam")
        world, truth = env.unwrapped.rows.world, env.unwrapped.landmark_truth()
        wrong = type(truth)(truth.ids, truth.positions + 5.0)  # every estimate is 5 m off
        monkeypatch.setattr(world, "landmark_truth", lambda _: wrong)
        for _ in range(20):
            _, _, _, _, info = env.step(np.zeros(5, np.float32))
        sigmas = np.sqrt(np.einsum("nii->n", slam.landmarks.covariances))
    assert (sigmas < 0.8).any()
    assert info["coverage"] == 0.0


def test_corners_in_images_are_refused():
    with pytest.raises(ValueError, match="sensor must be 'landmarks'"):
        gym.make("StereoSlam/Explore-v0", arguments={"sensor": "images"})
