"""Whatever is raised in a trial is a failed trial: exceptions that cannot say what they are, nor be sent (30 s)."""

from __future__ import annotations

import json

import pytest

from filters.contract.validation import error_line, first_line, type_name
from stereo_slam_env.benchmark import preset, run_benchmark
from stereo_slam_env.benchmark.campaign import check_study
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, PolicyChoice, Scenario
from stereo_slam_env.benchmark.scenarios.study import Study

from ...third_party import MODULE, install

HOSTILE = """
class Meta(type):
    @property
    def __name__(cls):
        raise RuntimeError("nameless")

class NoText(type):
    __name__ = 3

class Text(str):
    def strip(self):
        raise RuntimeError("no strip")

    def splitlines(self):
        return 3

class Nameless(Exception, metaclass=Meta): ...

class Numbered(Exception, metaclass=NoText): ...

class Silent(Exception):
    def __str__(self):
        raise SystemExit(3)

class Own(Exception):
    def __str__(self):
        return Text("own text")

class Basic(BaseException): ...

class Unsendable(Exception):
    def __reduce__(self):
        raise Basic("not to be sent")

class Group(Basic):
    def __str__(self):
        raise self

class Deep(Exception):
    def __str__(self):
        return str(self)

RAISED = {name: kind for name, kind in globals().items() if isinstance(kind, type) and issubclass(kind, BaseException)}
OF_PYTHON = KeyboardInterrupt, SystemExit, GeneratorExit, StopIteration, RecursionError
RAISED |= {kind.__name__: kind for kind in OF_PYTHON}
"""
NAMES = ("Nameless", "Numbered", "Silent", "Own", "Basic", "Unsendable", "Group", "Deep")
OF_PYTHON = ("KeyboardInterrupt", "SystemExit", "GeneratorExit", "StopIteration", "RecursionError")
FILTER = (
    HOSTILE
    + MODULE
    + '''

def of(name, where):
    def meet(self, now):
        if now == where:
            raise RAISED[name]("hello")

    class Hostile(DeadReckoning):
        """Raises."""

        def __init__(self, camera, noise):
            meet(self, "start")
            super().__init__(camera, noise)

        def update(self, observation):
            if self.updates == 2:
                meet(self, "frame")
            return super().update(observation)

        def pose_error(self, position, orientation):
            if self.updates == 2:
                meet(self, "error")
            return super().pose_error(position, orientation)

    return Hostile


for name in RAISED:
    for where in ("start", "frame", "error"):
        globals()[f"{name}_{where}"] = of(name, where)
'''
)
POLICY = (
    HOSTILE
    + '''
class Policy:
    """Raises."""

    def reset(self, env, rng):
        pass

    def act(self, observation):
        raise Nameless("hello")
'''
)


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    folder = tmp_path / "site"
    folder.mkdir()
    both = [(name, where) for name in (*NAMES, *OF_PYTHON) for where in ("start", "frame", "error")]
    points = {f"{name}-{where}": f"{name}_{where}" for name, where in both}
    install(folder, "hostile_filters", FILTER, points)
    install(folder, "hostile_policies", POLICY, {"nameless": "Policy"}, "stereo_slam.policies")
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(__import__("sys").modules, "hostile_filters", raising=False)


@pytest.mark.parametrize("where", ["start", "frame", "error"])
def test_whatever_a_filter_raises_is_a_failed_trial(hostile, tmp_path, where):
    names = [f"{name}-{where}" for name in (*NAMES, *OF_PYTHON) if (name, where) != ("KeyboardInterrupt", "start")]
    filters = tuple(FilterChoice(name, name) for name in (*names, "inverse-depth"))
    scenario = Scenario("one", ReferenceSource("short_turn"), filters, frames=5, metrics=())
    run_benchmark(scenario, tmp_path / "run", jobs=2)
    found = json.loads((tmp_path / "run" / "summary.json").read_text())["filters"]
    assert found["inverse-depth"]["failures"] == []
    for name in names:
        (failure,) = found[name]["failures"]
        assert failure.isprintable(), name
        assert name.partition("-")[0] in failure, failure
    assert "Own: own text" in found[f"Own-{where}"]["failures"][0]
    assert "Silent: its message cannot be read" in found[f"Silent-{where}"]["failures"][0]


def test_whatever_a_policy_raises_is_a_failed_trial(hostile, tmp_path):
    policies = PolicyChoice("nameless", "nameless"), PolicyChoice("fixed", "fixed")
    filters = (FilterChoice("inverse-depth", "inverse-depth"),)
    scenario = Scenario("gaze", preset("gaze").source, filters, policies=policies, frames=4, metrics=())
    run_benchmark(scenario, tmp_path / "run", jobs=1)
    found = json.loads((tmp_path / "run" / "summary.json").read_text())["filters"]
    assert "policy: Nameless: hello" in found["nameless"]["failures"][0]
    assert found["fixed"]["failures"] == []


def test_a_constructor_that_raises_anything_is_no_reason_to_stop(hostile):
    names = [f"{name}-start" for name in (*NAMES, *OF_PYTHON) if name != "KeyboardInterrupt"]
    filters = tuple(FilterChoice(name, name) for name in names)
    check_study(Study.of(Scenario("one", ReferenceSource("short_turn"), filters)))


@pytest.mark.parametrize("name", NAMES)
def test_words_are_found_for_any_exception(name):
    space: dict = {"__name__": "space"}
    exec(HOSTILE, space)
    error = space[name]("hello\x1b")
    assert type_name(error) == name
    for words in (first_line(error), error_line(error)):
        assert type(words) is str
        assert words.isprintable()
