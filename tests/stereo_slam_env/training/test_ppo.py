"""Training: what it leaves, that it can be stopped and goes on, and that the network decides as the model did."""

import csv
import dataclasses
import json
import sys

import numpy as np
import pytest

from filters.contract import extras
from stereo_slam_env.cli import app as cli
from stereo_slam_env.policies import make_policy
from stereo_slam_env.policies.network import Network
from stereo_slam_env.training import ppo
from stereo_slam_env.training.ppo import LearningCurve, PPOSettings, train
from stereo_slam_env.training.task import Evaluation, GazeTask

TASK = GazeTask(arguments={"route": "right-turn"}, hold=8)
SETTINGS = PPOSettings(decisions=40, environments=1, rollout=20, minibatch=20, epochs=1, evaluate_every=20)


def rows(out):
    with (out / "learning_curve.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture
def quick(monkeypatch):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    looks = iter(range(100))
    monkeypatch.setattr(ppo, "evaluate", lambda *_, **__: Evaluation(0.5, -40.0, 0.2, 9.0 - next(looks), 1.0))


@pytest.mark.parametrize(("made", "says_stopped"), [(0, True), (2000, True), (4000, False)])
def test_the_command_says_how_far_the_training_came_and_which_network_is_kept(
    monkeypatch, tmp_path, capsys, made, says_stopped
):
    """A time limit may end it before the first decision: the figures are then those of an untrained network."""

    def trained(task, settings, out, **_):
        curve = LearningCurve(out / "learning_curve.csv")
        for decisions in range(0, made + 1, 1000):
            curve.add(
                decisions, 60.0 + decisions, 1.0, Evaluation(0.5, -40.0, 0.2, 0.3 - 0.1 * (decisions == 1000), 1.0)
            )
        return out / "policy.npz"

    monkeypatch.setattr(ppo, "train", trained)
    monkeypatch.setattr("stereo_slam_env.training.task.evaluate", lambda *_: Evaluation(0.6, -39.0, 0.3, 0.4, 1.0))
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
def test_a_resumed_training_has_the_bits_of_an_unbroken_one(tmp_path):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    settings = dataclasses.replace(SETTINGS, decisions=60, validation=2)
    unbroken, resumed = tmp_path / "unbroken", tmp_path / "resumed"
    train(TASK, settings, unbroken)
    for decisions in (20, 40, 60):
        train(TASK, dataclasses.replace(settings, decisions=decisions), resumed)
    clock = ("seconds", "decisions_per_second")
    curves = [[{k: v for k, v in row.items() if k not in clock} for row in rows(out)] for out in (unbroken, resumed)]
    assert curves[0] == curves[1]
    assert len(curves[0]) == 4
    one, other = (Network.load(out / "policy.npz") for out in (unbroken, resumed))
    for a, b in zip(one.weights, other.weights, strict=True):
        np.testing.assert_array_equal(a, b)
    last = {name: float(value) for name, value in curves[0][-1].items()}
    assert all(np.isfinite(last[name]) for name in ppo.DIAGNOSTICS)
    assert last["final_position_nees"] > 0.0
    made_with = json.loads((resumed / "run.json").read_text())
    assert {"python", "numpy", "torch", "stable-baselines3"} <= made_with["versions"].keys()
    assert "commit" in made_with


@pytest.mark.slow
@pytest.mark.parametrize("pans", [5, None])
def test_the_network_decides_as_the_model_does(tmp_path, pans):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    task = dataclasses.replace(TASK, pans=pans)
    env = task.make_for_learning()
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


def test_without_the_extra_one_line_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r'^stable_baselines3 is missing: .* -m pip install "stereo-slam-env\[rl\]"$'):
        train(TASK, SETTINGS, tmp_path)
    assert not list(tmp_path.iterdir())


def test_importing_the_package_does_not_import_torch():
    import subprocess

    code = (
        "import sys, stereo_slam_env, stereo_slam_env.training.ppo, stereo_slam_env.wrappers, stereo_slam_env.policies;"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


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
