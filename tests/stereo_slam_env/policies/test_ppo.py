"""Training: what it leaves, that it can be stopped and goes on, and that the network decides as the model did."""

import csv
import dataclasses
import io
import json
import shutil
import zipfile

import gymnasium as gym
import numpy as np
import pytest

from filters.contract import extras
from stereo_slam_env.cli import app as cli
from stereo_slam_env.files.folders import claimed_folder
from stereo_slam_env.policies import make_policy, ppo
from stereo_slam_env.policies.named_policies import Network
from stereo_slam_env.policies.policy_rows import normalised_score
from stereo_slam_env.policies.ppo import LearningCurve, train
from stereo_slam_env.policies.registered_task import (
    EpisodeOutcome,
    GazeTask,
    PolicyEvaluation,
    PPOSettings,
    RegisteredTask,
    words,
)


def single(task):
    """One environment of a task."""
    return task.around(gym.make(task.environment, **task.world))


TASK = GazeTask(arguments={"route": "right-turn"}, hold=8)
SETTINGS = PPOSettings(decisions=40, environments=1, rollout=20, minibatch=20, epochs=1, evaluate_every=20)


def rows(out):
    with (out / "learning_curve.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture
def quick(monkeypatch):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    looks = iter(range(100))
    monkeypatch.setattr(ppo, "evaluate", lambda *_, **__: PolicyEvaluation(0.5, -40.0, 0.2, 9.0 - next(looks), 1.0))


@pytest.mark.parametrize(("made", "says_stopped"), [(0, True), (2000, True), (4000, False)])
def test_the_command_says_how_far_the_training_came_and_which_network_is_kept(
    monkeypatch, tmp_path, capsys, made, says_stopped
):
    """A time limit may end it before the first decision: the figures are then those of an untrained network."""

    def trained(task, settings, out, **_):
        curve = LearningCurve(out / "learning_curve.csv")
        for decisions in range(0, made + 1, 1000):
            look = PolicyEvaluation(0.5, -40.0, 0.2, 0.3 - 0.1 * (decisions == 1000), 1.0)
            curve.add(decisions, 60.0 + decisions, 1.0, look)
        return out / "policy.npz"

    monkeypatch.setattr(ppo, "train", trained)
    final = PolicyEvaluation(0.6, -39.0, 0.3, 0.4, 1.0)
    monkeypatch.setattr("stereo_slam_env.policies.registered_task.evaluate", lambda *_: final)
    assert cli.main(["train", "--decisions", "4000", "--minutes", "1", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert (f"stopped after {made:,} of 4,000 decisions" in said) == says_stopped
    assert f"policy.npz (the best so far, after {min(made, 1000):,} decisions)" in said


@pytest.mark.slow
def test_a_run_leaves_a_network_a_curve_and_what_it_was_made_with(quick, tmp_path):
    network = train(TASK, SETTINGS, tmp_path)
    assert [float(row["decisions"]) for row in rows(tmp_path)] == [0, 20, 40]
    about = json.loads((tmp_path / "run.json").read_text())
    assert GazeTask(**about["task"]) == TASK
    assert PPOSettings(**about["settings"]) == SETTINGS
    assert Network.load(network).about["settings"]["seed"] == 0
    assert Network.load(network).about["decisions"] == 40
    make_policy("ppo", checkpoint=str(network))
    # The same command with more decisions goes on; with something else it is refused.
    train(TASK, dataclasses.replace(SETTINGS, decisions=60), tmp_path)
    assert [float(row["decisions"]) for row in rows(tmp_path)] == [0, 20, 40, 60]
    with pytest.raises(ValueError, match=r"holds a run with seed = 0, not 1: give another directory"):
        train(TASK, dataclasses.replace(SETTINGS, seed=1), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "task",
    [
        TASK,
        RegisteredTask("StereoSlam/ClosedLoop-v0", {"arguments": {"route": "right-turn"}}),
        RegisteredTask("StereoSlam/Drive-v0", {"route": "right-turn", "max_landmarks": 8}),
        RegisteredTask("StereoSlam/Explore-v0", {"max_episode_steps": 30}),
    ],
    ids=["looks", "ClosedLoop", "Drive", "Explore"],
)
def test_a_resumed_training_has_the_bits_of_an_unbroken_one(tmp_path, task):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    settings = dataclasses.replace(SETTINGS, decisions=60, validation=2)
    unbroken, resumed = tmp_path / "unbroken", tmp_path / "resumed"
    train(task, settings, unbroken)
    for decisions in (20, 40, 60):
        train(task, dataclasses.replace(settings, decisions=decisions), resumed)
    clock = ("seconds", "decisions_per_second")
    curves = [[{k: v for k, v in row.items() if k not in clock} for row in rows(out)] for out in (unbroken, resumed)]
    assert curves[0] == curves[1]
    assert len(curves[0]) == 4
    assert float(curves[0][-1]["decisions"]) == 60
    one, other = (Network.load(out / "policy.npz") for out in (unbroken, resumed))
    for a, b in zip(one.weights, other.weights, strict=True):
        np.testing.assert_array_equal(a, b)
    last = {name: float(value) for name, value in curves[0][-1].items()}
    assert all(np.isfinite(last[name]) for name in ppo.DIAGNOSTICS)
    assert last.get("final_position_nees", 1.0) > 0.0
    assert np.isfinite(last["validation_return"])
    made_with = json.loads((resumed / "run.json").read_text())
    assert {"python", "numpy", "torch", "stable-baselines3"} <= made_with["versions"].keys()
    assert "commit" in made_with


@pytest.mark.slow
@pytest.mark.parametrize("pans", [5, None])
def test_the_network_decides_as_the_model_does(tmp_path, pans):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    task = dataclasses.replace(TASK, pans=pans)
    env = single(task)
    with ppo._learner(task, SETTINGS, tmp_path) as (model, scaling):
        model.learn(40)
        network = ppo.network_of(model, scaling, {}, task.choices)
        observation, _ = env.reset(seed=3)
        for _ in range(6):
            decided, _ = model.predict(scaling.normalize_obs(observation), deterministic=True)
            expected = decided if task.choices is None else task.choices[decided]
            np.testing.assert_allclose(network.action(observation), expected, atol=1e-5)
            observation, *_ = env.step(env.action_space.sample())
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(name for name in gym.registry if name.startswith("StereoSlam/")))
def test_every_id_can_be_trained_by_the_command(tmp_path, capsys, name):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    command = ["train", "--environment", name, "--decisions", "2", "--environments", "1", "--validation", "1"]
    assert cli.main([*command, "--minutes", "1e-9", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "validation_return" in said
    assert "stopped after 0 of 2 decisions" in said
    assert Network.load(tmp_path / "policy.npz").about["task"]["environment"].startswith("StereoSlam/")


def test_options_of_looks_are_refused_where_the_id_has_its_own_reward(tmp_path, capsys):
    command = ["train", "--environment", "StereoSlam/Drive-v0", "--nees-gate", "0.95", "--out", str(tmp_path)]
    assert cli.main(command) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: --nees-gate is of where to look (StereoSlam/Gaze-v0, StereoSlam/ActiveGaze-v0, ")
    assert not list(tmp_path.iterdir())
    assert cli.main(["train", "--environment", "StereoSlam/Fly-v0", "--out", str(tmp_path)]) == 2
    assert "environment must be one of StereoSlam/ActiveGaze-easy-v0, " in capsys.readouterr().err


def test_where_to_look_is_learnt_at_the_level_of_the_id(tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    command = ["train", "--environment", "StereoSlam/ActiveGaze-hard-v0", "--minutes", "1e-9", "--validation", "1"]
    assert cli.main([*command, "--out", str(tmp_path)]) == 0
    task = Network.load(tmp_path / "policy.npz").about["task"]
    assert (task["reward"], task["arguments"]["sigma"]) == ("error", 1.25)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ('{"arguments": 5}', "arguments must be a mapping of arguments of the environment, got 5"),
        ('{"holds": 3}', "ActiveGaze-hard-v0 has no argument 'holds', did you mean 'hold'?"),
        ('{"level": "hrad"}', "level must be "),
    ],
)
def test_arguments_of_where_to_look_that_there_are_not_get_one_line(tmp_path, capsys, arguments, said):
    command = ["train", "--environment", "StereoSlam/ActiveGaze-hard-v0", "--arguments", arguments]
    assert cli.main([*command, "--out", str(tmp_path)]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_module_before_the_id_is_imported_where_it_is_typed_and_nowhere_else(tmp_path, monkeypatch, capsys):
    (tmp_path / "strange_tasks.py").write_text("from pathlib import Path\nPath(__file__).with_name('mark').touch()\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ValueError, match="environment must be one of"):
        RegisteredTask("strange_tasks:Some-v0")
    assert not (tmp_path / "mark").exists()
    assert cli.main(["train", "--environment", "strange_tasks:Some-v0", "--out", str(tmp_path / "run")]) == 2
    assert "got 'Some-v0'" in capsys.readouterr().err
    assert (tmp_path / "mark").exists()
    assert cli.main(["train", "--environment", "nowhere:Some-v0", "--out", str(tmp_path / "run")]) == 2
    assert "--environment must name a module to import, got 'nowhere:Some-v0'" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["CartPole-v1", "Pendulum-v1", "FrozenLake-v1"])
def test_what_no_network_here_can_read_is_refused_in_a_line(name):
    with pytest.raises(ValueError, match=f"environment must show a Dict of Boxes, '{name}' shows .*: wrap it"):
        RegisteredTask(name)


def test_the_words_of_a_progress_bar_have_the_score_of_the_task_as_it_is():
    name = "StereoSlam/Drive-v0"
    score = f"{float(normalised_score(name, 31.4)):.0f}"
    said = RegisteredTask(name).words(EpisodeOutcome(31.4, 1.0, 300.0))
    assert said == f"return 31.40, success 100%, score {score}"
    assert RegisteredTask(name, {"route": "loop"}).words(EpisodeOutcome(3.0, np.nan, 9.0)) == "return 3.00"
    figures = PolicyEvaluation(0.5, -40.0, 0.2, 0.4, 1.0, -4.52)
    assert words(GazeTask(), figures) == "true error 0.400 m, claimed 0.500 m, score 0"
    assert words(GazeTask(hold=3), figures) == "true error 0.400 m, claimed 0.500 m"


class Valve(gym.Env):
    """A stranger's task: leave it open, action 1, for three steps."""

    metadata = {  # noqa: RUF012
        "render_modes": [],
        "training": {"discount": 0.5, "arguments": {"weight": 2.0}, "initial_bias": [0.0, 1e3]},
    }
    observation_space = gym.spaces.Dict({"steps": gym.spaces.Box(0.0, 3.0, (1,), np.float32)})
    action_space = gym.spaces.Discrete(2)

    def __init__(self, weight=1.0, render_mode=None):
        self.weight = weight

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = np.zeros(1, np.float32)
        return {"steps": self.steps}, {}

    def step(self, action):
        self.steps = self.steps + 1
        return {"steps": self.steps}, self.weight * float(action), bool(self.steps >= 3 or not action), False, {}


@pytest.fixture
def valve(monkeypatch):
    monkeypatch.setitem(gym.registry, "Valve-v0", gym.spec("StereoSlam/Gaze-v0"))  # so that it is taken out again
    del gym.registry["Valve-v0"]
    gym.register("Valve-v0", Valve)
    return RegisteredTask("Valve-v0")


def test_a_task_states_its_settings_and_what_is_given_counts_more(valve):
    assert ppo.settings_for(valve) == PPOSettings(discount=0.5, initial_bias=(0.0, 1e3))
    assert ppo.settings_for(valve, discount=0.9, seed=3) == PPOSettings(discount=0.9, initial_bias=(0.0, 1e3), seed=3)
    assert ppo.settings_for(RegisteredTask("StereoSlam/DriveGaze-v0")) == PPOSettings(discount=0.999)
    assert RegisteredTask("StereoSlam/Drive-v0").arguments == {"keys": ["car", "progress", "route"]}
    assert ppo.settings_for(GazeTask()) == PPOSettings()
    assert RegisteredTask("Valve-v0").arguments == {"weight": 2.0}
    assert RegisteredTask("Valve-v0", {"weight": 5.0}).arguments == {"weight": 5.0}


def test_a_setting_that_there_is_not_is_named(valve, monkeypatch):
    monkeypatch.setitem(Valve.metadata["training"], "dicount", 0.5)
    with pytest.raises(ValueError, match="dicount"):
        ppo.settings_for(RegisteredTask("Valve-v0"))


@pytest.mark.slow
def test_a_strangers_task_is_trained_from_the_bias_that_it_states(valve, tmp_path):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    settings = ppo.settings_for(valve, decisions=8, rollout=8, minibatch=8, environments=2, validation=2)
    network = Network.load(train(valve, settings, tmp_path))
    assert network.biases[-1].tolist() == pytest.approx([0.0, 1e3], abs=1.0)
    assert [float(row["validation_return"]) for row in rows(tmp_path)] == [6.0, 6.0]
    with pytest.raises(ValueError, match="initial_bias must have 2 numbers, one for each output, got 3"):
        train(valve, dataclasses.replace(settings, initial_bias=(0.0, 0.0, 0.0)), tmp_path / "other")


def test_tensorboard_gets_what_the_curve_has(tmp_path):
    """Where it is installed; losses, KL, entropy, explained variance and throughput under their usual names."""
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    events = pytest.importorskip(
        "tensorboard.backend.event_processing.event_accumulator", reason="TensorBoard is not installed"
    )
    train(TASK, dataclasses.replace(SETTINGS, validation=2), tmp_path)
    (folder,) = (tmp_path / "tensorboard").iterdir()
    read = events.EventAccumulator(str(folder)).Reload()
    assert {*ppo.DIAGNOSTICS.values(), "time/fps"} <= set(read.Tags()["scalars"])
    kl = [event.value for event in read.Scalars("train/approx_kl")]
    assert float(rows(tmp_path)[-1]["kl"]) == pytest.approx(kl[-1], rel=1e-4)


def test_without_the_extra_one_line_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r'^stable_baselines3 is missing: .* -m pip install "stereo-slam-env\[rl\]"$'):
        train(TASK, SETTINGS, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"decisions": 0}, "decisions must be a whole number >= 1, got 0"),
        ({"layers": (0,)}, r"layers must be a whole number >= 1, got 0"),
        ({"discount": 1.5}, "discount must be a probability from 0 to 1, got 1.5"),
    ],
)
def test_wrong_settings_get_one_clear_line(wrong, message):
    with pytest.raises(ValueError, match=message):
        PPOSettings(**wrong)


# ---- folders of a training -------------------------------------------------------------------------------------------


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file() and path.name != ".lock"}


@pytest.mark.parametrize("name", ["thesis.tex", "learning_curve.csv", "state.pt", "run.json", "policy.npz"])
def test_the_folder_of_a_stranger_is_refused_and_left_as_it_is(quick, tmp_path, name):
    (tmp_path / name).write_text('{"task": "mine"}')
    before = content(tmp_path)
    with pytest.raises(ValueError, match="is not empty and holds no training: choose another directory"):
        train(TASK, SETTINGS, tmp_path)
    assert content(tmp_path) == before
    assert not (tmp_path / ".lock").exists()


def test_a_training_that_is_refused_leaves_nothing(quick, tmp_path):
    with pytest.raises(ValueError, match="initial_bias must have"):
        train(TASK, dataclasses.replace(SETTINGS, initial_bias=(1.0, 2.0, 3.0)), tmp_path / "run")
    with pytest.raises(ValueError, match="minutes"):
        train(TASK, SETTINGS, tmp_path / "run", minutes=-1.0)
    assert content(tmp_path / "run") == {}
    with claimed_folder(tmp_path / "run"), pytest.raises(ValueError, match="is in use by another process"):
        train(TASK, SETTINGS, tmp_path / "run")
    assert content(tmp_path / "run") == {}


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    out = tmp_path_factory.mktemp("training") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ppo, "evaluate", lambda *_, **__: PolicyEvaluation(0.5, -40.0, 0.2, 9.0, 1.0))
        train(TASK, dataclasses.replace(SETTINGS, decisions=20), out)
    return out


def packed(content):
    """The same archive, packed: a kilobyte may then hold a gigabyte."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(name, old.read(name))
    return stream.getvalue()


def with_state(content, **changes):
    import torch

    stream = io.BytesIO()
    torch.save({**torch.load(io.BytesIO(content), weights_only=True), **changes}, stream)
    return stream.getvalue()


STATES = {
    "no archive": lambda old: b"x",
    "cut off": lambda old: old[:-200],
    "packed": packed,
    "without decisions": lambda old: with_state(old, decisions=None),
    "decisions": lambda old: with_state(old, decisions=-3),
    "policy": lambda old: with_state(old, policy={}),
    "optimizer": lambda old: with_state(old, optimizer={"state": 3}),
    "no moments": lambda old: with_state(old, moments={}),
    "moments": lambda old: with_state(old, moments={"": ([1.0, 2.0], [1.0], 3.0)}),
}
CURVES = [
    "decisions,seconds\n0,1\n",
    "a,b\n1,2\n",
    "decisions,seconds,final_position_error_m\nnan,1,2\n",
    "\0",
    "a\n1,2",
]
DAMAGES = [
    *(("state.pt", STATES[name], "state of this training") for name in STATES),
    *(("learning_curve.csv", lambda _, text=text: text.encode(), "learning curve") for text in CURVES),
]


@pytest.mark.parametrize(("name", "damaged", "what"), DAMAGES, ids=[*STATES, *map(repr, CURVES)])
def test_what_is_damaged_is_one_line_and_stays(quick, trained, tmp_path, name, damaged, what):
    shutil.copytree(trained, tmp_path / "run")
    file = tmp_path / "run" / name
    file.write_bytes(damaged(file.read_bytes()))
    before = content(tmp_path / "run")
    with pytest.raises(ValueError, match=rf"\A[^\n]*{name} is no {what} [^\n]*\Z"):
        train(TASK, SETTINGS, tmp_path / "run")
    assert content(tmp_path / "run") == before


@pytest.mark.parametrize("name", ["run.json", "learning_curve.csv", "state.pt", "policy.npz", "tensorboard"])
def test_links_out_of_a_training_are_refused(quick, trained, tmp_path, name):
    shutil.copytree(trained, tmp_path / "run")
    theirs = tmp_path / "theirs"
    if name == "tensorboard":
        shutil.rmtree(tmp_path / "run" / name, ignore_errors=True)
        theirs.mkdir()
    else:
        (tmp_path / "run" / name).rename(theirs)
    before = None if theirs.is_dir() else theirs.read_bytes()
    (tmp_path / "run" / name).symlink_to(theirs)
    with pytest.raises(ValueError, match="is a link out of its folder"):
        train(TASK, SETTINGS, tmp_path / "run")
    assert (list(theirs.iterdir()) == []) if before is None else theirs.read_bytes() == before


def test_a_curve_that_is_a_link_is_replaced(tmp_path):
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "data.csv").write_text("mine")
    curve = LearningCurve(tmp_path / "learning_curve.csv")
    (tmp_path / "learning_curve.csv").symlink_to(tmp_path / "theirs" / "data.csv")
    curve.add(0, 1.0, 0.0, PolicyEvaluation(0.5, -40.0, 0.2, 9.0, 1.0))
    assert (tmp_path / "theirs" / "data.csv").read_text() == "mine"
    assert len(LearningCurve(tmp_path / "learning_curve.csv").rows) == 1


def test_a_look_whose_state_was_not_saved_is_repeated(quick, trained, tmp_path, monkeypatch):
    shutil.copytree(trained, tmp_path / "run")
    curve = LearningCurve(tmp_path / "run" / "learning_curve.csv")
    curve.add(40, 9.0, 0.0, PolicyEvaluation(0.5, -40.0, 0.2, 0.1, 1.0))  # killed before `state.pt`
    train(TASK, SETTINGS, tmp_path / "run")
    assert [float(row["decisions"]) for row in rows(tmp_path / "run")] == [0, 20, 40]
    assert float(rows(tmp_path / "run")[-1]["final_position_error_m"]) != 0.1
