"""Statements of the manual that have been false before, against the code (10 s)."""

import re
from pathlib import Path

import gymnasium as gym
import pytest

from filters.kernels.process_noise import TURN_WEIGHT
from stereo_slam_env import envs
from stereo_slam_env.files.folders import claimed_folder

ROOT = Path(__file__).resolve().parents[2]
CALL = re.compile(r"^(\w+)\((env.*?)\)$", re.DOTALL | re.MULTILINE)


def page(name):
    return " ".join((ROOT / "docs" / name).read_text(encoding="utf-8").split())


def test_the_wrappers_take_what_their_page_says():
    """The block of signatures, argument by argument with its default."""
    block = re.search(r"^```text\n(.*?)^```", (ROOT / "docs" / "wrappers.md").read_text(encoding="utf-8"), re.S | re.M)
    shown = {name: " ".join(arguments.split()) for name, arguments in CALL.findall(block[1])}
    assert set(shown) == {name for name in envs.__all__ if isinstance(getattr(envs, name), type)} & set(shown)
    assert len(shown) == 7
    for name, arguments in shown.items():
        assert arguments == taken(getattr(envs, name)), name


def taken(wrapper):
    """Arguments of a wrapper as the page writes them."""
    import inspect

    parameters = list(inspect.signature(wrapper).parameters.values())
    words = [p.name if p.default is p.empty else f"{p.name}={p.default!r}" for p in parameters]
    return ", ".join(words).replace("'", '"')


def test_wrappers_go_into_vectors_of_processes_and_not_into_native_ones():
    """wrappers.md."""
    given = {"num_envs": 2, "wrappers": [envs.BeliefObservation]}
    gym.make_vec("StereoSlam/Gaze-v0", vectorization_mode="sync", **given).close()
    with pytest.raises(gym.error.Error, match="wrappers"):
        gym.make_vec("StereoSlam/Gaze-v0", **given)
    assert 'vectorization_mode="sync", wrappers=[...]' in page("wrappers.md")


def test_the_manual_names_the_lock_of_a_run_directory(tmp_path):
    with claimed_folder(tmp_path):
        (lock,) = tmp_path.iterdir()
    assert f"on the file `{lock.name}`" in page("benchmark.md")


def test_what_was_read_off_kitti_00_is_said():
    """covariances.md and results.md: the weight of a turn."""
    assert TURN_WEIGHT == 5.0
    text = page("covariances.md")
    assert "A turn counts five times as much" in text
    assert "That is the one number here that was read off KITTI 00" in text
    assert not re.search("KITTI 00[^.]*(were not used|played no part in choosing it)", text + page("results.md"))
