"""Every wrapper on the real environment: Gymnasium's and stable-baselines3's rules, specs, vectors (20 s)."""

import copy
import pickle
import warnings
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import FlattenObservation

import stereo_slam_env  # noqa: F401  (registers the environments)
from stereo_slam_env.envs import BeliefObservation, BeliefPanorama, InformationGain, ObserveBodies, TrueError

from .replayed import ReplayEnv

ID = "StereoSlam/Drive-v0"
QUICK = {"route": "right-turn", "surroundings": "corridor", "rig": "qvga", "policy": "route", "max_landmarks": 20}
BELIEF = partial(BeliefObservation, max_landmarks=8)
PARTS = {
    "belief": [BELIEF],
    "panorama": [BELIEF, BeliefPanorama],
    "gain": [BELIEF, partial(InformationGain, nees_gate=0.95, report_both=True)],
    "error": [BELIEF, partial(TrueError, keep_reward=True)],
    "bodies": [partial(BELIEF, filter="moving-bodies"), ObserveBodies],
    "reference": [partial(InformationGain, belief="reference", criterion="a-optimality", keep_reward=True)],
    "flat": [FlattenObservation],
    "everything": [BELIEF, BeliefPanorama, InformationGain, FlattenObservation],
}
IDLE = np.zeros(2, dtype=np.float32)


def on(env, parts):
    for wrap in parts:
        env = wrap(env)
    return env


def wrapped(parts):
    return on(gym.make(ID, disable_env_checker=True, **QUICK), parts)


def rollout(env, seed=3, steps=3):
    return [env.reset(seed=seed), *(env.step(IDLE) for _ in range(steps))]


def refuses_warnings(check, env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*is different from the unwrapped version.*")
        check(env)


@pytest.mark.parametrize("name", PARTS)
def test_gymnasium_accepts_it_without_a_warning(name):
    env = on(ReplayEnv(), PARTS[name])
    refuses_warnings(partial(check_env, skip_render_check=True), env)
    results = rollout(env)
    assert all(env.observation_space.contains(result[0]) for result in results)
    assert all(type(result[1]) is float for result in results[1:])
    shapes = [{key: np.shape(value) for key, value in result[-1].items()} for result in results]
    assert all(shape == shapes[0] for shape in shapes)


def test_from_the_spec_by_pickle_and_by_deepcopy_comes_a_fresh_environment():
    env = wrapped(PARTS["everything"][:-1])  # Gymnasium's FlattenObservation cannot be pickled
    expected = rollout(env)
    from_spec = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    for clone in (from_spec, pickle.loads(pickle.dumps(env)), copy.deepcopy(env)):
        with pytest.raises(RuntimeError, match="reset the environment first"):
            _ = clone.get_wrapper_attr("belief")
        assert data_equivalence(rollout(clone), expected, exact=True)
        clone.close()
    env.close()


@pytest.mark.parametrize(
    ("mode", "how"),
    [
        ("sync", {}),
        ("async", {"context": "forkserver"}),
        *(pytest.param("async", {"context": way}, marks=pytest.mark.slow) for way in ("fork", "spawn")),
    ],
)
def test_vector_environments_give_the_same_bits(mode, how):
    parts = PARTS["everything"][:-1]
    vector = gym.make_vec(ID, num_envs=2, vectorization_mode=mode, vector_kwargs=how, wrappers=parts, **QUICK)
    try:
        frames = [vector.reset(seed=[11, 12])]
        for _ in range(3):
            observation, reward, _, _, info = vector.step(np.zeros((2, 2), dtype=np.float32))
            frames.append((copy.deepcopy(observation), reward, info))
    finally:
        vector.close()
    for index, seed in enumerate([11, 12]):
        env = wrapped(parts)
        for told, alone in zip(frames, rollout(env, seed), strict=True):
            for key, value in alone[0].items():
                np.testing.assert_array_equal(told[0][key][index], value)
            for key, value in alone[-1].items():
                np.testing.assert_array_equal(told[-1][key][index], value)
            if len(alone) == 5:
                assert told[1][index] == alone[1]
        env.close()


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_any_autoreset_mode_starts_the_belief_afresh(mode):
    """A step limit of 2, so that every third or second step is a reset."""
    parts = [*PARTS["everything"][:-1]]
    limited = [partial(gym.wrappers.TimeLimit, max_episode_steps=2), *parts]
    vector = gym.vector.SyncVectorEnv([partial(wrapped, limited)] * 2, autoreset_mode=mode)
    try:
        vector.reset(seed=5)
        for _ in range(6):
            _, reward, _, truncated, info = vector.step(np.zeros((2, 2), dtype=np.float32))
            if mode is AutoresetMode.DISABLED and truncated.any():
                vector.reset(options={"reset_mask": truncated})
            fresh = info["time"] == 0.0
            assert (info["reward_information"][fresh] == 0.0).all()
            assert np.isfinite(reward).all()
    finally:
        vector.close()


@pytest.mark.parametrize("name", ["flat", "everything", "belief", "panorama", "bodies"])
def test_stable_baselines3_accepts_it(name):
    """It takes a Box of three dimensions for an image that is none, says so, and goes on."""
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = wrapped(PARTS[name])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        checker.check_env(env)
    told = [str(warning.message) for warning in caught if "stable_baselines3" in warning.filename]
    assert all("unconventional shape" in text or "image" in text for text in told), told
    assert not told or name in ("belief", "panorama", "bodies")
    env.close()
