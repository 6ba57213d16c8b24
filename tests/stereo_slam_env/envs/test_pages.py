"""The docstring of every registered environment is its manual page, and agrees with its spaces, info and arguments."""

import importlib
import inspect
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

import stereo_slam_env  # noqa: F401 (registers the ids)

IDS = ["StereoSlam/Drive-v0", "StereoSlam/DriveGaze-v0", "StereoSlam/Gaze-v0"]
TASKS = [
    f"StereoSlam/{task}{level}-v0"
    for task in ("ActiveGaze", "Explore", "Revisit", "ClosedLoop", "Branches", "Follow")
    for level in ("", "-easy", "-hard")
]
"""Made of these environments and of wrappers, by a function whose docstring is the page."""
SECTIONS = [
    "Description",
    "Action Space",
    "Observation Space",
    "Info",
    "Rewards",
    "Starting State",
    "Episode End",
    "Arguments",
    "Version History",
]


def environment_class(name):
    module, _, attribute = gym.spec(name).entry_point.partition(":")
    return getattr(importlib.import_module(module), attribute)


def section(page, title):
    return re.split(r"^\s*## ", page.split(f"## {title}\n")[1], maxsplit=1, flags=re.MULTILINE)[0]


def table(text):
    """Cells of the rows of the first table."""
    rows = [line.strip().strip("|").split("|") for line in text.splitlines() if line.strip().startswith("|")]
    return [[cell.strip() for cell in row] for row in rows[2:]]


DRIVE = inspect.getdoc(environment_class("StereoSlam/Drive-v0"))
DRIVE_REWARDS = section(DRIVE, "Rewards")


def with_drive(page, title):
    """Rows of the table of a section by first cell, after those of the page of Drive: others list what differs."""
    missing = re.findall(r"`\w+`", section(page, title).partition(" without ")[2].partition(":\n")[0])
    rows = {row[0]: row for each in (DRIVE, page) for row in table(section(each, title))}
    return [row for name, row in rows.items() if page == DRIVE or name not in missing]


@pytest.fixture(params=IDS)
def page_and_class(request):
    made = environment_class(request.param)
    return inspect.getdoc(made), made  # without the indentation, which Python 3.13 takes away by itself


def test_all_are_there():
    assert sorted(name for name in gym.registry if name.startswith("StereoSlam/")) == sorted([*IDS, *TASKS])


def test_the_page_has_every_section_in_order(page_and_class):
    page, _ = page_and_class
    assert re.findall(r"^\s*## (.*)$", page, flags=re.MULTILINE) == SECTIONS


def test_the_action_table_is_the_action_space(page_and_class):
    page, made = page_and_class
    text, space = section(page, "Action Space"), made().action_space
    assert f"`Box(-1, 1, {space.shape}, float32)`" in text
    rows = table(text)
    assert [int(row[0]) for row in rows] == list(range(space.shape[0]))
    np.testing.assert_array_equal([float(row[2]) for row in rows], space.low)
    np.testing.assert_array_equal([float(row[3]) for row in rows], space.high)


def test_the_observation_table_is_the_observation_space(page_and_class):
    page, made = page_and_class
    env = made(render_images=True)
    named = {"N": env.options.max_landmarks, "H": env.camera.height, "W": env.camera.width}
    shown = {}
    for keys, shape, kind, _ in with_drive(page, "Observation Space"):
        numbers = [named.get(part, part) for part in re.findall(r"\w+", shape)]
        for key in re.findall(r"`(\w+)`", keys):
            shown[key] = (tuple(int(n) for n in numbers), kind)
    assert shown == {key: (space.shape, str(space.dtype)) for key, space in env.observation_space.items()}


def test_info_and_rewards_are_named(page_and_class):
    page, made = page_and_class
    env = made(route="right-turn", rig="qvga")
    try:
        _, info = env.reset(seed=0)
    finally:
        env.close()
    formula, *terms = section(page, "Rewards").split("\n\n- ")
    terms_in_info = {key for key in info if key.startswith("reward_")}
    assert set(re.findall(r"reward_\w+", formula)) == terms_in_info
    listed = "\n".join([*terms, *([DRIVE_REWARDS] if "those of `StereoSlam/Drive-v0`" in formula else [])])
    for key in terms_in_info:
        assert f"*{key}*" in listed
        assert f"`{key.removeprefix('reward_')}_weight`" in listed
    for key in info.keys() - terms_in_info:
        assert f"`{key}`" in section(DRIVE if "Drive-v0" in section(page, "Info") else page, "Info")


def test_the_argument_table_has_every_argument_and_its_default(page_and_class):
    page, made = page_and_class
    shown = {row[0]: row[1] for row in with_drive(page, "Arguments")}
    defaults = {**made.Options().as_dict(), "render_mode": None}
    expected = {f"`{k}`": f'`"{v}"`' if isinstance(v, str) else f"`{v}`" for k, v in defaults.items()}
    assert shown == expected


def test_the_bounds_are_finite_and_the_padding_is_inside(page_and_class):
    _, made = page_and_class
    for space in made().observation_space.values():
        if isinstance(space, spaces.Box):
            assert np.isfinite(space.low.astype(float)).all()
            assert np.isfinite(space.high.astype(float)).all()
