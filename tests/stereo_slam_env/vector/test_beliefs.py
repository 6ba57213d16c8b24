"""Filters in lock-step say what the wrappers of single environments say (5 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from filters import available_filters
from stereo_slam_env.training.task import GAZE_FILTER, POLICY_KEYS, GazeTask
from stereo_slam_env.vector.belief import PoseInformation
from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama, InformationCriterion, InformationGain

from .same_rays import same_rays  # noqa: F401 (a fixture)

pytestmark = pytest.mark.usefixtures("same_rays")
GAZE = "StereoSlam/Gaze-v0"
WORLD = {"route": "right-turn", "rig": "qvga"}
SEEDS = [4, 5]
STEPS = 12


def wrapped(belief, **information):
    env = BeliefPanorama(BeliefObservation(gym.make(GAZE, **WORLD), **belief))
    return InformationGain(env, of="pose", **information)


def drive(env, actions, **reset):
    """What an environment says in every step, the reset first."""
    return [env.reset(**reset), *[env.step(action) for action in actions]]


@pytest.mark.parametrize(
    ("belief", "information"),
    [
        ({"options": GAZE_FILTER}, {"resolution": (0.01, 0.001)}),
        ({"filter": "right-invariant", "hold": 3}, {"criterion": "a-optimality", "weight": 2.0}),
        ({"filter": "euclidean", "use_odometry": False, "max_landmarks": 5}, {"criterion": "entropy"}),
        ({"filter": "inverse-depth", "noise": 2.0}, {"criterion": "e-optimality", "keep_reward": True}),
    ],
)
def test_observations_rewards_and_infos_are_those_of_the_wrappers(belief, information):
    vector = gym.make_vec(GAZE, num_envs=2, belief=belief, panorama={}, information=information, **WORLD)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, 2, 2)).astype(np.float32)
    together = drive(vector, actions, seed=SEEDS)
    for b, seed in enumerate(SEEDS):
        with wrapped(belief, **information) as env:
            alone = drive(env, actions[:, b], seed=seed)
        assert vector.single_observation_space == env.observation_space
        for one, all_of_them in zip(alone, together, strict=True):
            assert one[0].keys() == all_of_them[0].keys()
            for key, value in one[0].items():
                np.testing.assert_allclose(all_of_them[0][key][b], value, rtol=1e-5, atol=1e-6, err_msg=key)
            for key, value in one[-1].items():
                np.testing.assert_allclose(all_of_them[-1][key][b], value, rtol=1e-9, atol=1e-9, err_msg=key)
        rewards = [[step[1] for step in alone[1:]], [step[1][b] for step in together[1:]]]
        np.testing.assert_allclose(*rewards, rtol=1e-9, atol=1e-9)
    vector.close()


def test_the_training_task_is_the_same_in_lock_step():
    vector = gym.make_vec("StereoSlam/ActiveGaze-v0", num_envs=2, arguments=WORLD)
    actions = np.random.default_rng(1).integers(9, size=(STEPS, 2))
    together = drive(vector, actions, seed=SEEDS)
    for b, seed in enumerate(SEEDS):
        with gym.make("StereoSlam/ActiveGaze-v0", arguments=WORLD) as env:
            alone = drive(env, actions[:, b], seed=seed)
        for one, all_of_them in zip(alone, together, strict=True):
            assert tuple(one[0]) == POLICY_KEYS
            for key, value in one[0].items():
                np.testing.assert_allclose(all_of_them[0][key][b], value, rtol=1e-5, atol=1e-6, err_msg=key)
    with pytest.raises(ValueError, match="actions must be 2 numbers from 0 to 8, got"):
        vector.step(np.array([0, 9]))
    vector.close()


def test_the_information_of_an_episode_adds_up_to_the_loss_of_potential():
    task = GazeTask(arguments=WORLD)
    vector = task.make_vector(3, autoreset_mode="Disabled")
    _, info = vector.reset(seed=0)
    first, total, over = info["information_potential"], 0.0, False
    while not over:
        _, rewards, terminated, _, info = vector.step(np.full(3, 6))
        total, over = total + rewards, terminated.all()
    np.testing.assert_allclose(total, first - info["information_potential"], rtol=1e-9)
    assert info["is_success"].all()
    vector.close()


def test_an_episode_that_begins_leaves_the_gains_of_the_others():
    """With SAME_STEP some begin in the step in which others go on."""
    information = PoseInformation({})
    P = np.tile(np.eye(6), (2, 1, 1))
    information.begin(P, np.array([True, True]))
    gained = information.use(0.5 * P, np.array([True, True])).copy()
    np.testing.assert_allclose(gained, 6.0 * np.log(2.0))
    information.begin(np.stack([P[0], 0.5 * P[1]]), np.array([True, False]))
    np.testing.assert_allclose(information.info()["reward_information"], [0.0, gained[1]])
    np.testing.assert_allclose(information.info()["information_potential"], [0.0, -gained[1]])


@pytest.mark.parametrize("name", ["log-det", "entropy", "d-optimality", "a-optimality", "e-optimality"])
def test_potentials_of_many_poses_are_those_of_each(name):
    A = np.random.default_rng(2).standard_normal((5, 6, 6))
    P = A @ A.transpose(0, 2, 1)
    criterion = InformationCriterion(name, of="pose", resolution=(0.01, 0.001))
    np.testing.assert_allclose(criterion.pose_potentials(P), [criterion.potential(each) for each in P], rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"panorama": {}}, "panorama and information need a filter in the loop: give belief={}"),
        ({"belief": {}, "information": {"of": "map"}}, "information has no key 'of'"),
        ({"belief": {"filter": "submaps"}}, "filter must be a StereoEKF with kernels, 'submaps' is none"),
        ({"belief": {}, "keys": ["panorama"]}, "the observation has no key 'panorama'"),
        ({"pans": 1}, "pans must be a whole number >= 2, got 1"),
    ],
)
def test_a_wrong_argument_gets_one_clear_line(arguments, message):
    with pytest.raises(ValueError, match=message) as error:
        gym.make_vec(GAZE, num_envs=2, **arguments)
    assert "\n" not in str(error.value)


def test_a_vector_without_filters_says_so():
    vector = gym.make_vec(GAZE, num_envs=1, **WORLD)
    with pytest.raises(RuntimeError, match="there is no filter in the loop: give belief="):
        _ = vector.unwrapped.filters
    assert "submaps" in available_filters()
