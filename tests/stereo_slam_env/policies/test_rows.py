"""Policies in all rows of a vector decide as alone; the oracle is nearer to the truth than any of them (15 s)."""

import gymnasium as gym
import numpy as np
import pytest

from stereo_slam_env.envs.active_gaze import GazeTask
from stereo_slam_env.policies import make_policy
from stereo_slam_env.policies.named_policies import look_towards
from stereo_slam_env.policies.planning import Greedy
from stereo_slam_env.policies.policy_rows import Oracle, RowOfVector, policy_in_rows, rng_of_policy, true_figures


def single(task):
    """One environment of a task."""
    return task.around(gym.make(task.environment, **task.world))


QUICK = {"route": "right-turn"}
SEEDS = [11, 12]


@pytest.mark.parametrize("name", ["sweep", "random", "greedy", "lookahead"])
def test_a_policy_decides_in_a_row_as_in_the_single_environment(name):
    task = GazeTask(arguments=QUICK, pans=None, hold=1)
    vector = task.make_vector(len(SEEDS))
    observation, _ = vector.reset(seed=SEEDS)
    act, everybody, many = policy_in_rows(vector, lambda: make_policy(name), SEEDS), np.ones(2, dtype=bool), []
    for _ in range(12):
        many.append(act(observation, everybody).copy())
        observation = vector.step(many[-1])[0]
    vector.close()
    for b, seed in enumerate(SEEDS):
        env, policy = single(task), make_policy(name)
        seen, _ = env.reset(seed=seed)
        policy.reset(env, rng_of_policy(seed))
        for k in range(12):
            action = policy.act(seen)
            np.testing.assert_array_equal(action, many[k][b])
            seen = env.step(action)[0]
        env.close()


def test_a_policy_that_only_acts_alone_is_asked_row_by_row_and_planners_once():
    """A stranger's has `reset` and `act` and nothing else; rows whose drive is over are not asked."""

    class Alone:
        def reset(self, env, rng):
            self._env, self._pan = env, rng.uniform(-1.0, 1.0)

        def act(self, observation):
            return look_towards(self._env, np.array([self._pan, 0.0]))

    vector = GazeTask(arguments=QUICK, pans=None, hold=1).make_vector(3)
    observation, _ = vector.reset(seed=[1, 2, 3])
    alone = policy_in_rows(vector, Alone, [1, 2, 3])(observation, np.array([True, False, True]))
    pans = [rng_of_policy(seed).uniform(-1.0, 1.0) for seed in (1, 3)]
    np.testing.assert_allclose(alone[:, 0] * 2.0, [pans[0], 0.0, pans[1]], atol=1e-6)
    asked = []

    class Together(Greedy):
        @staticmethod
        def act_together(policies, observations):
            asked.append(len(policies))
            return Greedy.act_together(policies, observations)

    act = policy_in_rows(vector, Together, [1, 2, 3])
    act(observation, np.array([True, True, False]))
    assert asked == [2]
    act(observation, np.zeros(3, dtype=bool))
    assert asked == [2]
    vector.close()


def test_a_row_has_what_policies_may_ask_for_and_nothing_else():
    vector = GazeTask(arguments=QUICK, pans=None).make_vector(2)
    vector.reset(seed=SEEDS)
    row = RowOfVector(vector, 1)
    assert all(row.has_wrapper_attr(name) for name in ("slam", "belief", "camera", "noise", "head", "route", "options"))
    assert not row.has_wrapper_attr("truth")
    np.testing.assert_array_equal(row.get_wrapper_attr("slam").pose.position, vector.filters.poses[1, :3])
    vector.close()


def test_the_oracle_is_nearer_to_the_truth_and_claims_what_everybody_claims():
    """A fixed gaze errs by 0.2 m at the end of this turn; who knows the noise that comes by a third of that."""
    world = {**QUICK, "surroundings": "groves", "pan_rate": 1.5}
    task, seeds, made = GazeTask(arguments=world), range(30, 42), {}
    for name in ("fixed", "oracle"):
        vector = task.make_vector(len(seeds))
        oracle = Oracle(vector.rows, depth=2)
        straight = np.full(len(seeds), 4)
        choose = (lambda _, going, by=oracle: by.act(going)) if name == "oracle" else (lambda *_, s=straight: s)
        made[name] = true_figures(vector, lambda _, c=choose: c, seeds)
        vector.close()
    fixed, oracle = made["fixed"], made["oracle"]
    assert oracle.returns.mean() > 0.6 * fixed.returns.mean()  # both below 0
    assert oracle.final_position_error_m.mean() < 0.7 * fixed.final_position_error_m.mean()
    assert oracle.final_position_nees.mean() < 0.6
    assert 0.4 < fixed.final_position_nees.mean() < 2.2  # twelve drives: chi-squared of 36 degrees of freedom


def test_the_noise_of_a_world_with_lasting_errors_says_so_to_a_filter_that_asks():
    with gym.make("StereoSlam/Gaze-v0", sigma=0.6, lasting=0.8, lasting_time=2.0) as env:
        noise = env.unwrapped.noise
    np.testing.assert_allclose(noise.R[1, 1], 1.0)
    np.testing.assert_allclose(noise.white[1, 1], 0.36)
    step = 0.8 * np.sqrt(2.0 * (1.0 - np.exp(-0.1 / 2.0)))
    np.testing.assert_allclose(noise.drift.pixels, [step, step, np.sqrt(2.0) * step])
