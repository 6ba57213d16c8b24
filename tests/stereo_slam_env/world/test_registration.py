"""Scenes and routes of users, by name. About 5 s."""

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs.recorder import record
from stereo_slam_env.world import routes, surroundings
from stereo_slam_env.world.open_country import build_groves
from stereo_slam_env.world.routes import ROUTES, Route, available_routes, named_route, register_route
from stereo_slam_env.world.surroundings import SURROUNDINGS, available_scenes, build_scene, register_scene

SLALOM = Route("any", np.full(40, 5.0), 0.2 * np.sin(np.arange(40) / 8.0))


@pytest.fixture(autouse=True)
def _forgotten():
    """Names that a test registers are gone afterwards."""
    tables = routes._ROUTES, surroundings._SURROUNDINGS
    before = [dict(table) for table in tables]
    yield
    for table, kept in zip(tables, before, strict=True):
        table.clear()
        table.update(kept)


def test_registered_names_work_in_environments_and_recordings():
    register_scene("my-groves", build_groves)
    register_route("slalom", SLALOM)
    names = {"surroundings": "my-groves", "route": "slalom"}
    env = gym.make("StereoSlam/Drive-v0", **names, policy="route")
    try:
        observation, _ = env.reset(seed=0)
        assert env.unwrapped.route.name == "slalom"
        assert observation["mask"].sum() > 3
    finally:
        env.close()
    recording = record(names, seed=0, frames=3)
    assert recording.source["arguments"]["route"] == "slalom"
    again = record({"surroundings": "groves", "route": "slalom"}, seed=0, frames=3)
    for frame, same in zip(recording.frames, again.frames, strict=True):
        np.testing.assert_array_equal(frame.observation.uvd, same.observation.uvd)


def test_lists_name_them_with_a_line_each():
    register_scene("a", build_groves)
    register_scene("b", build_groves, description="mine", walkway=3.0)
    register_route("slalom", lambda: SLALOM)
    assert available_scenes()["a"].startswith("Groups of trees")
    assert available_scenes()["b"] == "mine"
    assert SURROUNDINGS["b"].walkway == 3.0
    assert available_routes()["slalom"] == "41 frames, 20 m"


@pytest.mark.parametrize(
    ("register", "message"),
    [
        (lambda: register_scene("street", build_groves), "name must be new, got 'street': there is such a scene"),
        (lambda: register_route("town", SLALOM), "name must be new, got 'town': there is such a route"),
        (lambda: register_scene("a/b", build_groves), "name must be letters, digits, .* got 'a/b'"),
        (lambda: register_route("", SLALOM), "name must be letters, digits, .* got ''"),
        (lambda: register_scene("new", None), "builder must be a function .* got None"),
        (lambda: register_route("new", 3), "route must be a Route or a function that makes one, got 3"),
        (lambda: register_scene("new", build_groves, walkway=-1.0), "walkway must be a finite number > 0, got -1.0"),
    ],
)
def test_what_cannot_be_registered_is_refused(register, message):
    before = dict(ROUTES), dict(SURROUNDINGS)
    with pytest.raises(ValueError, match=message) as refused:
        register()
    assert "\n" not in str(refused.value)
    assert (dict(ROUTES), dict(SURROUNDINGS)) == before


@pytest.mark.parametrize("table", [ROUTES, SURROUNDINGS])
def test_nobody_assigns_into_the_tables(table):
    with pytest.raises(TypeError):
        table["mine"] = None


def test_unknown_names_are_refused_with_the_nearest_registered_one():
    register_scene("my-groves", build_groves)
    register_route("slalom", SLALOM)
    with pytest.raises(ValueError, match="got 'my-grove', did you mean 'my-groves'"):
        build_scene("my-grove", SLALOM, np.random.default_rng(0))
    with pytest.raises(ValueError, match="got 'slalon', did you mean 'slalom'"):
        named_route("slalon")


PACKAGE = """
import numpy as np
from stereo_slam_env.world.open_country import build_groves
from stereo_slam_env.world.routes import Route, register_route
from stereo_slam_env.world.surroundings import register_scene


def register():
    register_scene("theirs", build_groves)
    register_route("short", Route("short", np.full(30, 5.0), np.zeros(30)))
"""
ENTRY_POINTS = "[stereo_slam.scenes]\nbroken = nowhere:register\ntheirs = their_scenes:register\n"


MAKES = """
import gymnasium
import stereo_slam_env

env = gymnasium.make("StereoSlam/Drive-v0", surroundings="theirs", route="short")
print(env.reset(seed=0)[0]["mask"].sum(), "landmarks")
env.close()
"""


def test_commands_and_new_processes_know_what_installed_packages_register(tmp_path):
    (tmp_path / "their_scenes.py").write_text(PACKAGE)
    information = tmp_path / "their_scenes-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: their-scenes\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(ENTRY_POINTS)

    def run(code, *arguments):
        line = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n{code}", *arguments]
        return subprocess.run(line, capture_output=True, text=True, timeout=140, check=True)

    listed = run("from stereo_slam_env.cli.app import main; main()", "scenes", "list")
    assert "theirs           Groups of trees" in listed.stdout
    assert "short            31 frames" in listed.stdout
    assert "'broken' are not available: ModuleNotFoundError" in listed.stderr + listed.stdout
    assert "landmarks" in run(MAKES).stdout
