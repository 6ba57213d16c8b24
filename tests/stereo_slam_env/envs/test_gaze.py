"""StereoSlam/Gaze-v0 and DriveGaze-v0: what moves when the head moves. About 10 s."""

import warnings
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scipy.stats import chi2

from filters import VelocityDriven, make_filter
from filters.geometry import rotations
from stereo_slam_env.envs.drive import StereoDriveEnv
from stereo_slam_env.envs.drive_gaze import StereoDriveGazeEnv
from stereo_slam_env.envs.gaze import StereoGazeEnv
from stereo_slam_env.world.routes import FRAME_PERIOD

QUICK = {"route": "right-turn"}
RIGHT = np.array([1.0, 0.0], dtype=np.float32)


@pytest.fixture
def make():
    made = []

    def _make(kind=StereoGazeEnv, **kwargs):
        made.append(kind(**{**QUICK, **kwargs}))
        return made[-1]

    yield _make
    for env in made:
        env.close()


def rollout(env, seed, actions):
    results = [env.reset(seed=seed)]
    for action in actions:
        results.append(env.step(action))
        if results[-1][2]:
            break
    return results


def random_actions(env, steps, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, *env.action_space.shape)).astype(np.float32)


@pytest.mark.parametrize("name", ["StereoSlam/Gaze-v0", "StereoSlam/DriveGaze-v0"])
def test_checkers_pass_without_a_warning(name):
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="needs the extra rl")
    env = gym.make(name, disable_env_checker=True, **QUICK).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=True)
        warnings.filterwarnings("ignore", message=".*unconventional shape.*")
        checker.check_env(gym.make(name, **QUICK))


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [(StereoDriveEnv, {"policy": "route"}), (StereoDriveEnv, {"policy": "agent"}), (StereoGazeEnv, {})],
)
def test_the_truth_obeys_equation_6_and_starts_at_the_origin_of_w(make, kind, arguments):
    env = make(kind, **arguments)
    infos = [result[-1] for result in rollout(env, 2, 0.5 * random_actions(env, 30))]
    np.testing.assert_array_equal(infos[0]["truth_position"], 0)
    np.testing.assert_array_equal(infos[0]["truth_orientation"], [0, 0, 0, 1])
    for before, after in pairwise(infos):
        moved = before["truth_position"] + after["truth_linear_velocity"] * FRAME_PERIOD
        np.testing.assert_allclose(after["truth_position"], moved, atol=1e-12)
        turn = rotations.exp_quaternion(after["truth_angular_velocity"] * FRAME_PERIOD)
        turned = rotations.multiply(before["truth_orientation"], turn)
        np.testing.assert_allclose(after["truth_orientation"], turned, atol=1e-12)


def test_the_observation_tells_where_the_head_is(make):
    env = make()
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(observation["head"], 0)
    for step in range(1, 20):
        observation, *_ = env.step(RIGHT)
        assert observation["head"][0] == pytest.approx(min(0.15 * step, 2.0))
    assert observation in env.observation_space


def test_driving_and_looking_are_apart(make):
    """The four actions are those of Drive-v0 and then those of Gaze-v0."""
    both, drive = make(StereoDriveGazeEnv), make(StereoDriveEnv)
    wheel = np.array([0.5, 0.3], dtype=np.float32)
    rollout(both, 5, [np.concatenate([wheel, RIGHT])] * 10)
    rollout(drive, 5, [wheel] * 10)
    body = both.head.body_pose(both.frame.truth, both.head_angles)
    np.testing.assert_allclose(body.position, drive.frame.truth.position, atol=1e-12)
    assert both.head_angles[0] == pytest.approx(1.5)


def test_a_filter_with_odometry_is_consistent_while_the_head_turns(make):
    """Without odometry no motion model would believe it; with it the estimate stays within its covariance."""
    nees = []
    for seed in range(6):
        env = make(route="straight")
        env.reset(seed=seed)
        slam = make_filter("shared-anchor", camera=env.camera, noise=env.noise, motion=VelocityDriven())
        slam.reset(env.start)
        slam.update(env.frame.observation)
        actions = np.repeat(random_actions(env, 10, seed), 6, axis=0)
        for action in actions:
            env.step(action)
            slam.predict(FRAME_PERIOD, env.frame.odometry)
            slam.update(env.frame.observation)
        error, P = slam.pose_error(env.frame.truth.position, env.frame.truth.orientation)
        nees.append(error @ np.linalg.solve(P, error))
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(nees))
    assert low < np.sum(nees) < high


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"max_pan": 4.0}, r"max_pan must be a number from 0 to 3.14159, got 4.0"),
        ({"pan_rate": 0.0}, r"pan_rate must be a finite number > 0, got 0.0"),
        ({"visibility": 500.0}, r"visibility must be a number from 8 to 150, got 500.0"),
        ({"policy": "agent"}, r"unexpected keyword argument 'policy'"),
        ({"effort_weight": -1.0}, r"effort_weight must be a finite number >= 0, got -1.0"),
    ],
)
def test_a_wrong_argument_gets_one_clear_line(kwargs, message):
    with pytest.raises(ValueError, match=message):
        StereoGazeEnv(**kwargs)
