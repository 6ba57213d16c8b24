"""What clients ask of environments: films of one of many, a base class they look for, words after `close` (10 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import BeliefObservation

QUICK = {"route": "right-turn", "rig": "qvga", "max_landmarks": 8}


def test_a_picture_of_a_row_is_that_of_the_single_environment_and_the_others_are_not_drawn():
    vector = gym.make_vec("StereoSlam/Gaze-v0", num_envs=3, render_mode="rgb_array", **QUICK)
    env = gym.make("StereoSlam/Gaze-v0", render_mode="rgb_array", **QUICK)
    vector.reset(seed=5)
    env.reset(seed=6)
    for _ in range(2):
        frames = vector.render()
        assert len(frames) == 3
        np.testing.assert_array_equal(frames[1], env.render())
        vector.step(np.zeros((3, 2), np.float32))
        env.step(np.zeros(2, np.float32))
    renderers = [pictures._renderer is not None for pictures in vector.unwrapped.core._pictures]
    assert renderers == [False, True, False]
    with pytest.raises(IndexError):
        vector.render()[3]
    vector.close()
    env.close()


def test_a_vector_without_pictures_says_how_to_get_them():
    vector = gym.make_vec("StereoSlam/Gaze-v0", num_envs=2, **QUICK)
    vector.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode='rgb_array'"):
        assert vector.render() is None
    vector.close()


def test_record_video_films_one_environment_of_a_vector(tmp_path):
    pytest.importorskip("moviepy", reason="MoviePy is not installed")
    vector = gym.make_vec("StereoSlam/ActiveGaze-v0", num_envs=4, render_mode="rgb_array", arguments=QUICK)
    film = gym.wrappers.vector.RecordVideo(
        vector, str(tmp_path / "films"), record_first_only=True, video_length=3, disable_logger=True
    )
    film.reset(seed=0)
    for _ in range(4):
        film.step(film.action_space.sample())
    film.close()
    assert [file.suffix for file in (tmp_path / "films").iterdir()] == [".mp4"]


def test_a_library_that_looks_one_base_class_up_finds_gymnasium():
    """As skrl's automatic wrapper does, of the outermost wrapper and of the environment inside."""
    for task in ("Drive", "Gaze", "DriveGaze"):
        env = BeliefObservation(gym.make(f"StereoSlam/{task}-v0"))
        assert gym.Env in type(env.unwrapped).__bases__
        env.close()
    vector = gym.make_vec("StereoSlam/Gaze-v0", num_envs=1)
    assert gym.vector.VectorEnv in type(vector.unwrapped).__bases__
    vector.close()


@pytest.mark.parametrize("name", sorted(name for name in gym.registry if name.startswith("StereoSlam/")))
def test_a_step_after_close_says_that_it_is_closed(name):
    env = gym.make(name)
    env.reset(seed=0)
    discrete = isinstance(env.action_space, gym.spaces.Discrete)
    action = env.action_space.n - 1 if discrete else env.action_space.sample()  # of Revisit 0 would be to stop
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.step(action)
    vector = gym.make_vec(name, num_envs=1)
    vector.reset(seed=0)
    vector.close()
    for after in (lambda: vector.step(vector.action_space.sample()), lambda: vector.reset(seed=0)):
        with pytest.raises(RuntimeError, match="the environments are closed: make them again"):
            after()
