"""Filters in the loop of many rows say, bit by bit, what the wrappers of one environment say (15 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from filters import StereoNoise, make_filter
from filters.catalogue import presets
from stereo_slam_env.envs import (
    BeliefObservation,
    BeliefPanorama,
    DirectionOfGaze,
    InformationCriterion,
    InformationGain,
    SelectedKeys,
    belief_observation,
)
from stereo_slam_env.envs.active_gaze import GAZE_FILTER, GazeTask

GAZE = "StereoSlam/Gaze-v0"
WORLD = {"route": "right-turn", "rig": "qvga"}
SEEDS = [4, 5, 6]
STEPS = 12


def drive(env, actions, **reset):
    """What an environment says in every step, the reset first."""
    return [env.reset(**reset), *[env.step(action) for action in actions]]


def assert_rows(together, alone, b):
    """Row b of a vector is what one environment says, bit by bit; info keys that begin with _ are the vector's own."""
    for one, all_of_them in zip(alone, together, strict=True):
        for batch, single in ((all_of_them[0], one[0]), (all_of_them[-1], one[-1])):
            assert {key for key in batch if not key.startswith("_")} == set(single)
            for key, value in single.items():
                assert np.asarray(batch[key][b]).tobytes() == np.asarray(value).tobytes(), key
                assert np.asarray(batch[key]).dtype == np.asarray(value).dtype, key
        assert [value[b] for value in all_of_them[1:-1]] == list(one[1:-1])


def test_every_row_assumes_the_noise_of_its_own_filter(monkeypatch):
    actions = np.zeros((STEPS, 2, 2), np.float32)

    def final_positions(*sigmas):
        made = iter([sigmas[0], *sigmas])  # one more is made, to see whether they go in a batch

        def make(name, *, noise, **rest):
            return make_filter(name, noise=StereoNoise.independent_pixels(next(made)), **rest)

        monkeypatch.setattr(belief_observation, "make_filter", make)
        vector = gym.make_vec(GAZE, num_envs=2, belief={}, **WORLD)
        said = drive(vector, actions, seed=SEEDS[:2])
        vector.close()
        return said[-1][0]["belief_position"]

    mixed, low, high = final_positions(0.5, 2.0), final_positions(0.5, 0.5), final_positions(2.0, 2.0)
    np.testing.assert_array_equal(mixed, [low[0], high[1]])
    assert (low != high).any(axis=1).all()


@pytest.mark.parametrize(
    ("belief", "information"),
    [
        ({"options": GAZE_FILTER}, {"resolution": (0.01, 0.001)}),
        ({"filter": "right-invariant", "hold": 3}, {"criterion": "a-optimality", "weight": 2.0}),
        ({"filter": "euclidean", "use_odometry": False, "max_landmarks": 5}, {"criterion": "entropy"}),
        ({"filter": "inverse-depth", "noise": 2.0}, {"criterion": "e-optimality", "keep_reward": True}),
        ({}, {"of": "map", "nees_gate": 0.5}),
        ({"filter": "dual-bearing"}, {"report_both": True, "max_age": 3}),
        ({"filter": "dead-reckoning"}, {"belief": "reference", "of": "map"}),
        ({"filter": "submaps", "hold": 2}, {"use_odometry": False}),
    ],
    ids=str,
)
def test_the_wrappers_are_the_same_on_one_row_and_on_many(belief, information):
    vector = gym.make_vec(GAZE, num_envs=3, belief=belief, panorama={}, information=information, **WORLD)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, 3, 2)).astype(np.float32)
    together = drive(vector, actions, seed=SEEDS)
    vector.close()
    for b, seed in enumerate(SEEDS):
        inside = BeliefPanorama(BeliefObservation(gym.make(GAZE, **WORLD), **belief))
        with InformationGain(inside, **{"of": "pose", **information}) as env:
            assert vector.single_observation_space == env.observation_space
            assert_rows(together, drive(env, actions[:, b], seed=seed), b)


def test_a_stranger_s_filter_is_the_same_on_one_row_and_on_many(monkeypatch):
    """One that is no EKF of the engine, though it looks like one: its update is its own."""

    def made(camera, noise):
        slam = make_filter("shared-anchor", camera=camera, noise=noise)
        update = slam.update
        monkeypatch.setattr(slam, "update", lambda observation: update(observation.select(observation.ids % 3 > 0)))
        return slam

    monkeypatch.setitem(presets.PRESETS, "every-other", made)
    vector = gym.make_vec(GAZE, num_envs=3, belief={"filter": "every-other"}, **WORLD)
    actions = np.zeros((STEPS, 3, 2), dtype=np.float32)
    together = drive(vector, actions, seed=SEEDS)
    with BeliefObservation(gym.make(GAZE, **WORLD), "every-other") as env:
        assert_rows(together, drive(env, actions[:, 1], seed=SEEDS[1]), 1)
        assert (env.slam.landmarks.ids % 3 > 0).all()
    vector.close()


def test_keys_and_directions_are_arguments_of_a_vector():
    arguments = {"belief": {"hold": 2}, "panorama": {"sectors": 6}, "keys": ["head", "panorama"], "pans": 5}
    vector = gym.make_vec(GAZE, num_envs=3, **arguments, **WORLD)
    actions = np.random.default_rng(1).integers(5, size=(STEPS, 3))
    together = drive(vector, actions, seed=SEEDS)
    inside = BeliefPanorama(BeliefObservation(gym.make(GAZE, **WORLD), hold=2), 6)
    with DirectionOfGaze(SelectedKeys(inside, ["head", "panorama"]), 5) as env:
        assert vector.single_observation_space == env.observation_space
        assert vector.single_action_space == env.action_space
        assert_rows(together, drive(env, actions[:, 2], seed=SEEDS[2]), 2)
    with pytest.raises(ValueError, match="actions must be 3 whole numbers from 0 to 4, got"):
        vector.step(np.array([0, 5, 1]))
    vector.close()


def test_rows_that_begin_leave_the_others_as_they_are():
    """With a mask some begin while others wait: their beliefs, potentials and gains stay."""
    vector = gym.make_vec(GAZE, num_envs=3, autoreset_mode="Disabled", belief={}, panorama={}, information={}, **WORLD)
    vector.reset(seed=1)
    before = [vector.step(np.full((3, 2), 0.5, dtype=np.float32)) for _ in range(5)][-1]
    after = vector.reset(options={"reset_mask": np.array([False, True, False])})
    for one, other in ((before[0], after[0]), (before[-1], after[-1])):
        for key, value in one.items():
            np.testing.assert_array_equal(value[[0, 2]], other[key][[0, 2]], err_msg=key)
    assert after[1]["reward_information"].tolist()[1] == 0.0
    vector.close()


def test_the_information_of_an_episode_adds_up_to_the_loss_of_potential():
    vector = GazeTask(arguments=WORLD, reward="information").make_vector(3, autoreset_mode="Disabled")
    _, info = vector.reset(seed=0)
    first, total, over = info["information_potential"], 0.0, False
    while not over:
        _, rewards, terminated, _, info = vector.step(np.full(3, 6))
        total, over = total + rewards, terminated.all()
    np.testing.assert_allclose(total, first - info["information_potential"], rtol=1e-9)
    vector.close()


@pytest.mark.parametrize("name", ["log-det", "entropy", "d-optimality", "a-optimality", "e-optimality"])
def test_potentials_of_many_poses_are_those_of_each(name):
    A = np.random.default_rng(2).standard_normal((5, 6, 6))
    P = A @ A.transpose(0, 2, 1)
    criterion = InformationCriterion(name, of="pose", resolution=(0.01, 0.001))
    np.testing.assert_allclose(criterion.pose_potentials(P), [criterion.potential(each) for each in P], rtol=1e-12)


def test_a_filter_that_fails_is_named_with_its_row(monkeypatch):
    frames = []

    def made(camera, noise):
        slam = make_filter("shared-anchor", camera=camera, noise=noise)
        number, update = len(frames), slam.update
        frames.append(0)

        def failing(observation):
            frames[number] += 1
            if (number, frames[number]) == (1, 4):
                raise ZeroDivisionError("of something")
            return update(observation)

        monkeypatch.setattr(slam, "update", failing)
        return slam

    monkeypatch.setitem(presets.PRESETS, "failing", made)
    vector = gym.make_vec(GAZE, num_envs=2, belief={"filter": "failing"}, **WORLD)
    vector.reset(seed=0)
    for _ in range(2):
        vector.step(np.zeros((2, 2)))
    with pytest.raises(RuntimeError, match="filter 'failing' failed in frame 3 of environment 1: ZeroDivisionError"):
        vector.step(np.zeros((2, 2)))
    vector.close()


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"panorama": {}}, ValueError, "panorama, information and error need a filter in the loop: give belief={}"),
        ({"belief": {}, "information": {"off": "map"}}, TypeError, "unexpected keyword argument 'off'"),
        ({"belief": {}, "keys": ["panorama"]}, ValueError, "the observation has no key 'panorama'"),
        ({"pans": 1}, ValueError, "pans must be a whole number >= 2, got 1"),
    ],
    ids=str,
)
def test_a_wrong_argument_gets_one_clear_line(arguments, error, message):
    with pytest.raises(error, match=message) as raised:
        gym.make_vec(GAZE, num_envs=2, **arguments)
    assert "\n" not in str(raised.value)


def test_a_vector_without_filters_says_so():
    vector = gym.make_vec(GAZE, num_envs=1, **WORLD)
    with pytest.raises(RuntimeError, match="there is no filter in the loop: give belief="):
        _ = vector.unwrapped.filters
