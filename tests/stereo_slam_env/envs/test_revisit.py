"""Closing a loop is worth its way, or not (10 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import close_if_it_pays
from stereo_slam_env.envs.revisit import GO_ON, STOP, closing_distance
from stereo_slam_env.world import named_route
from stereo_slam_env.world.routes import Route


def test_the_loop_is_closed_where_it_passes_the_start():
    route = named_route("loop")
    assert closing_distance(route) == pytest.approx(float(route.arc_length[740]), abs=0.5)
    with pytest.raises(ValueError, match="must come back to its start, as 'loop' does, and 'town' does not"):
        closing_distance(named_route("town"))


@pytest.mark.parametrize("further", [0, 20, 60])
def test_a_loop_closes_where_it_is_nearest_to_its_start_wherever_it_ends(further):
    """Round a circle of 100 m: at 100 m, or at the end, where that is nearer than 3 m already."""
    steps = 250 + further - (2 if not further else 0)
    circle = Route("circle", np.full(steps, 4.0), np.full(steps, 2.0 * np.pi / 25.0))
    assert closing_distance(circle) == pytest.approx(100.0 if further else 99.2, abs=0.01)


@pytest.fixture(scope="module")
def way_home():
    """First and later observations, rewards, and infos of driving on to the end."""
    with gym.make("StereoSlam/Revisit-v0", disable_env_checker=True, begin=(0.8, 0.9)) as env:
        observation, info = env.reset(seed=0)
        observations, rewards, infos, over = [observation], [], [info], False
        while not over:
            observation, reward, over, _, info = env.step(GO_ON)
            observations.append(observation)
            rewards.append(reward)
            infos.append(info)
    return observations, np.array(rewards), infos


def test_the_return_is_what_was_learnt_minus_the_price_of_the_way(way_home):
    observations, rewards, infos = way_home
    learnt = infos[0]["information_potential"] - infos[-1]["information_potential"]
    way = infos[-1]["distance"] - infos[0]["distance"]
    assert rewards.sum() == pytest.approx(learnt - float(observations[0]["price"][0]) * way, abs=1e-4)
    for reward, info in zip(rewards, infos[1:], strict=True):
        assert reward == pytest.approx(info["reward_information"] + info["reward_path"])


def test_it_pays_only_once_the_loop_is_closed(way_home):
    observations, rewards, infos = way_home
    ahead = np.array([float(seen["ahead"][0]) for seen in observations])
    assert 0.1 < ahead[0] / 302.0 < 0.2
    assert (np.diff(ahead) < 0.0).all()
    assert ahead[-1] == pytest.approx(-24.0, abs=1.0)
    total = np.concatenate([[0.0], rewards.cumsum()])
    assert total[ahead > 20.0].max() <= 0.0
    assert total[ahead < 0.0].max() > 5.0
    assert infos[-1]["is_success"] == (total[-1] > 0.0)
    assert not infos[0]["is_success"]


def decided(choose, way_home, price):
    """Return and last info of an agent on that way, at another price of a metre."""
    observations, _, infos = way_home
    total = 0.0
    for seen, before, after in zip(observations, infos, infos[1:], strict=False):
        if choose({**seen, "price": np.array([price])}) == STOP:
            return total, before
        total += after["reward_information"] - price * (after["distance"] - before["distance"])
    return total, infos[-1]


def test_the_rule_closes_a_cheap_loop_and_leaves_a_dear_one(way_home):
    cheap, info = decided(close_if_it_pays, way_home, 0.02)
    assert cheap > 5.0
    assert info["distance"] < way_home[2][-1]["distance"]
    assert decided(close_if_it_pays, way_home, 1.0) == (0.0, way_home[2][0])
    assert decided(lambda _: GO_ON, way_home, 1.0)[0] < -20.0


@pytest.mark.parametrize("begin", [(0.9, 0.5), (0.5, 1.1)])
def test_shares_that_are_none_are_refused(begin):
    with pytest.raises(ValueError, match="begin must be two shares"):
        gym.make("StereoSlam/Revisit-v0", begin=begin)


def test_who_stops_at_once_earns_nothing():
    with gym.make("StereoSlam/Revisit-v0", disable_env_checker=True, begin=(0.05, 0.1)) as env:
        env.reset(seed=0)
        _, reward, terminated, truncated, info = env.step(STOP)
    assert (reward, terminated, truncated) == (0.0, True, False)
    assert not info["is_success"]
