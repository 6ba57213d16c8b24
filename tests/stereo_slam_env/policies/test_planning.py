"""Policies that plan on the filter's belief (20 s)."""

from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401
from stereo_slam_env.policies import available_policies, make_policy
from stereo_slam_env.policies.foresight import turning_head
from stereo_slam_env.policies.planning import Greedy, Lookahead, Planner, Preferences, directions, worths

from .looking import looked_around, with_belief

PLANNING = ("most-uncertain", "greedy", "lookahead")


def actions(name, seed=8, steps=25, **arguments):
    env, policy = with_belief(**arguments), make_policy(name)
    observation, _ = env.reset(seed=seed)
    policy.reset(env, np.random.default_rng(0))
    taken = []
    for _ in range(steps):
        taken.append(policy.act(observation))
        assert env.action_space.contains(taken[-1])
        observation = env.step(taken[-1])[0]
    env.close()
    return np.array(taken)


@pytest.mark.parametrize("name", PLANNING)
def test_it_is_known_by_name_turns_the_head_and_the_same_seed_gives_the_same_actions(name):
    assert name in available_policies()
    first = actions(name)
    assert np.ptp(first[:, 0]) > 0.3
    np.testing.assert_array_equal(first, actions(name))
    for other in ("euclidean", "submaps"):
        assert np.isfinite(actions(name, steps=6, filter=other)).all()


def test_one_of_ours_is_made_without_asking_all_installed_packages(monkeypatch):
    """That costs a tenth of a second, and each row of a vector has a policy of its own."""
    asked = []
    monkeypatch.setattr(
        "stereo_slam_env.policies.named_policies.entry_points", lambda **group: asked.append(group) or []
    )
    make_policy("greedy")
    assert not asked
    with pytest.raises(ValueError, match="policy must be one of"):
        make_policy("gredy")
    assert asked


@pytest.mark.parametrize("name", PLANNING)
def test_without_a_filter_or_a_head_it_says_what_is_missing(name):
    policy, rng = make_policy(name), np.random.default_rng(0)
    with pytest.raises(ValueError, match="BeliefObservation"):
        policy.reset(gym.make("StereoSlam/Gaze-v0"), rng)
    with pytest.raises(ValueError, match="Gaze-v0"):
        policy.reset(gym.make("StereoSlam/Drive-v0"), rng)


@pytest.mark.parametrize(
    ("name", "options", "named"),
    [
        ("greedy", {"gain": "poses"}, "gain"),
        ("greedy", {"pans": 0}, "pans"),
        ("lookahead", {"steps": 1.5}, "steps"),
        ("lookahead", {"replan": 0}, "replan"),
        ("lookahead", {"effort": -1.0}, "effort"),
        ("most-uncertain", {"patience": 0}, "patience"),
        ("greedy", {"tits": 3}, "tilts"),
    ],
)
def test_an_impossible_option_is_named(name, options, named):
    with pytest.raises(ValueError, match=named):
        make_policy(name, **options)


def test_directions_are_a_grid_over_all_the_head_can_do():
    head = gym.make("StereoSlam/Gaze-v0").unwrapped.head
    grid = directions(head, 5, 3)
    assert grid.shape == (15, 2)
    np.testing.assert_array_equal(np.unique(grid[:, 0]), [-2.0, -1.0, 0.0, 1.0, 2.0])
    np.testing.assert_array_equal(np.unique(grid[:, 1]), [-0.4, 0.0, 0.4])
    np.testing.assert_array_equal(directions(head, 3, 1)[:, 1], 0.0)


def test_where_nothing_is_known_it_looks_at_what_nobody_has_seen():
    env = with_belief(rig="vga", route="straight", visibility=8.0)  # nothing is as near as that at the start
    env.reset(seed=0)
    assert len(env.slam.landmarks.ids) == 0
    planner = Planner(env, Preferences("map", 9, 1, curiosity=1.0, effort=0.01))
    planner.look()
    targets = planner.targets
    worth = planner.worth(targets, targets[:, None])
    assert worth[4] < 0.0 + 1e-9  # straight ahead has been seen
    assert abs(planner.best(targets[:, None])[0]) > 0.4
    env.close()


def test_turning_costs_effort():
    env = looked_around()
    targets = np.array([[0.0, 0.0], [1.0, 0.0], [-2.0, 0.2]])
    free, dear = (Planner(env, Preferences("pose", 9, 1, 0.0, effort)) for effort in (0.0, 3.0))
    for planner in (free, dear):
        planner.look()
    turn = np.abs(targets - env.get_wrapper_attr("head_angles")) / [2.0, 0.4]
    difference = free.worth(targets, targets[:, None]) - dear.worth(targets, targets[:, None])
    np.testing.assert_allclose(difference, 3.0 * turn.sum(axis=1), rtol=1e-9)
    env.close()


def test_most_uncertain_looks_at_what_is_known_worst_and_gives_up_what_it_cannot_see():
    env = looked_around()
    policy = make_policy("most-uncertain", patience=4)
    policy.reset(env, np.random.default_rng(0))
    observation = {"ids": np.array([-1])}  # nothing is ever seen
    wanted = []
    for _ in range(12):
        action = policy.act(observation)
        wanted.append(policy._wanted)
    assert len(set(wanted)) == 3
    assert wanted[0] == wanted[3] != wanted[4]
    belief = env.belief
    traces = np.trace(belief.relative_covariances, axis1=1, axis2=2)
    first = int(np.flatnonzero(belief.ids == wanted[0])[0])
    near = np.linalg.norm(belief.points_c, axis=1) < 30.0
    ahead = np.abs(np.arctan2(*belief.points_c.T[[0, 2]]) + env.get_wrapper_attr("head_angles")[0]) < 1.9
    level = np.abs(np.arctan2(belief.points_c[:, 1], np.hypot(*belief.points_c.T[[0, 2]]))) < 0.2
    assert (near & ahead & level).sum() > 5
    assert traces[first] >= traces[near & ahead & level].max()
    assert env.action_space.contains(action)
    env.close()


def test_greedy_without_curiosity_and_effort_looks_where_the_filter_would_learn_most():
    env = looked_around()
    policy = Greedy(gain="pose", pans=9, curiosity=0.0, effort=0.0)
    policy.reset(env, np.random.default_rng(0))
    chosen = policy.act({})[0] * 2.0
    planner = Planner(env, Preferences("pose", 9, 1, 0.0, 0.0))
    planner.look()
    targets = planner.targets
    worth = planner.worth(targets, targets[:, None])
    assert chosen == pytest.approx(targets[np.argmax(worth), 0])
    assert worth.max() > 0.1
    env.close()


def test_the_worth_in_many_environments_is_that_in_each_by_itself():
    """Other routes, maps of other sizes, heads that are turned elsewhere, after other numbers of steps."""
    envs = [looked_around(steps, route=route) for steps, route in ((25, "straight"), (9, "right-turn"), (0, "town"))]
    for gain, steps in (("map", 1), ("pose", 16), ("map", 5)):
        planners = [Planner(env, Preferences(gain, 9, 1, 0.15, 0.05)) for env in envs]
        for looks, planner in enumerate(planners):
            for _ in range(looks + 1):
                planner.look()
        targets, head = planners[0].targets, planners[0].outlook.head
        angles = turning_head(head, np.stack([planner.outlook.angles for planner in planners]), targets, steps)
        together = worths(planners, targets, angles)
        assert np.ptp(together, axis=1).min() > 0.1
        for planner, turning, worth in zip(planners, angles, together, strict=True):
            np.testing.assert_allclose(planner.worth(targets, turning), worth, rtol=1e-12)
    for env in envs:
        env.close()


@pytest.mark.parametrize("policy", [Greedy(), Lookahead(replan=1)], ids=["greedy", "lookahead"])
def test_it_gets_to_where_it_turns_before_it_chooses_again(policy):
    env = looked_around()
    policy.reset(env, np.random.default_rng(0))
    observation, targets = {}, []
    for _ in range(40):
        action = policy.act(observation)
        targets.append(2.0 * float(action[0]))
        observation = env.step(action)[0]
    changes = np.flatnonzero(np.diff(targets)) + 1
    assert len(changes) >= 2
    for change, again in pairwise(changes):
        turn = abs(targets[change] - targets[change - 1])
        assert again - change >= np.ceil(turn / 0.15 - 1e-3)  # 0.15 rad a step
    env.close()
