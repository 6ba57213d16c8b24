"""`render_mode="human"` opens a window where it can and says what to do where it cannot; films. About 15 s."""

import sys

import cv2
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo

import stereo_slam_env  # noqa: F401 (registers)
from stereo_slam_env.envs.drive import StereoDriveEnv

QUICK = {"policy": "route", "route": "right-turn", "surroundings": "groves", "rig": "qvga"}
IDLE = np.zeros(2, dtype=np.float32)


@pytest.fixture
def no_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER", "SDL_VIDEO_DRIVER"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def dummy(no_display, monkeypatch):
    """A display that shows nothing."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    return pytest.importorskip("pygame")


def make(**kwargs):
    return gym.make("StereoSlam/Drive-v0", **{**QUICK, **kwargs})


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
@pytest.mark.parametrize("ask", [make, lambda **kwargs: StereoDriveEnv(**QUICK, **kwargs)], ids=["make", "class"])
def test_without_a_display_human_says_what_to_do(no_display, ask):
    pytest.importorskip("pygame")
    with pytest.raises(RuntimeError, match=r"needs a display.*rgb_array.*RecordVideo.*xvfb-run.*SDL_VIDEODRIVER=dummy"):
        ask(render_mode="human")


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_a_display_that_does_not_answer_is_none(no_display, monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("DISPLAY", ":4711")
    env = make(render_mode="human")
    with pytest.raises(RuntimeError, match=r"cannot open a window.*SDL_VIDEODRIVER=dummy"):
        env.reset(seed=0)
    env.close()


def test_without_pygame_human_names_the_extra(no_display, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match=r' -m pip install "stereo-slam-env\[video\]"$'):
        make(render_mode="human")


def test_the_window_shows_each_frame_at_once(dummy):
    with make(render_mode="human") as env, make(render_mode="rgb_array") as still:
        for move in (lambda each: each.reset(seed=0), lambda each: each.step(IDLE)):
            for each in (env, still):
                move(each)
            shown = dummy.surfarray.array3d(dummy.display.get_surface()).swapaxes(0, 1)
            np.testing.assert_array_equal(shown, still.render())
        assert env.render() is None
        env.close()


def test_the_class_declares_human_and_an_environment_where_it_works(no_display, monkeypatch):
    assert StereoDriveEnv.metadata["render_modes"] == ["rgb_array", "human"]
    env = StereoDriveEnv(**QUICK)
    assert env.metadata == {"render_modes": ["rgb_array"], "render_fps": 10}
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    assert StereoDriveEnv(**QUICK).metadata == StereoDriveEnv.metadata


def test_record_video_makes_a_film(tmp_path):
    pytest.importorskip("moviepy")
    drive = make(render_mode="rgb_array", max_episode_steps=6)
    env = RecordVideo(drive, str(tmp_path / "films"), episode_trigger=lambda _: True)
    env.reset(seed=0)
    truncated = False
    while not truncated:
        _, _, _, truncated, _ = env.step(IDLE)
    picture = env.render()
    env.close()
    film = cv2.VideoCapture(str(tmp_path / "films" / "rl-video-episode-0.mp4"))
    frames = []
    while (read := film.read())[0]:
        frames.append(read[1])
    film.release()
    assert len(frames) == 7
    assert frames[0].shape == picture.shape
    last = frames[-1][..., ::-1].astype(float)
    assert np.abs(last - picture).mean() < 8.0  # it is compressed
