"""Proximal policy optimisation (stable-baselines3) of a small network on any task; it can be interrupted."""

from __future__ import annotations

import csv
import io
import json
import logging
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, fields
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from filters.contract.extras import require_module
from filters.contract.validation import first_line, positive, require_known, whole_number
from filters.geometry.arrays import FloatArray
from stereo_slam_env.envs.active_gaze import GazeTask
from stereo_slam_env.files.folders import (
    claimed_folder,
    is_occupied,
    json_text,
    write_atomically,
    write_json,
    write_text,
)
from stereo_slam_env.files.opening import open_regular, require_links_inside
from stereo_slam_env.files.package_versions import commit, version_of
from stereo_slam_env.files.readers import read_json, read_text, require_plain_zip
from stereo_slam_env.policies.named_policies import Network
from stereo_slam_env.policies.registered_task import (
    VALIDATION_SEEDS,
    EpisodeOutcome,
    PolicyEvaluation,
    PPOSettings,
    RegisteredTask,
    evaluate,
    words,
)

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

Task = GazeTask | RegisteredTask
Progress = Callable[..., None]
"""Called with decisions made, decisions wanted, and the latest result in words."""

DIAGNOSTICS = {
    "policy_loss": "train/policy_gradient_loss",
    "value_loss": "train/value_loss",
    "entropy": "train/entropy_loss",
    "kl": "train/approx_kl",
    "clipped": "train/clip_fraction",
    "explained_variance": "train/explained_variance",
}
"""Columns of the learning curve, and what the logger of stable-baselines3 calls them; NaN before the first update."""
ABOUT, STATE = "run.json", "state.pt"
_WRITTEN = (ABOUT, STATE, "learning_curve.csv", "policy.npz", "tensorboard")
"""Entries of the directory of a training."""
_ROUNDED = 1e-5
"""Relative: numbers of a learning curve have six digits."""
_OBSERVATION_CLIP = 5.0
_PACKAGES = ("stereo-slam-env", "numpy", "numba", "gymnasium", "torch", "stable-baselines3")

_log = logging.getLogger(__name__)


def settings_for(task: Task, **given: Any) -> PPOSettings:
    """The settings that a task states, and over them those that are given; a `ValueError` names one there is not."""
    stated = {**(task.training if isinstance(task, RegisteredTask) else {}), **given}
    names = [each.name for each in fields(PPOSettings)]
    require_known("the task states what is no setting of a training", stated, names)
    return PPOSettings(**stated)


def merit(row: Mapping[str, float]) -> float:
    """Score that a network is chosen by: the least true error of the position in the end, else the largest return."""
    return -row["final_position_error_m"] if "final_position_error_m" in row else row["validation_return"]


class LearningCurve:
    """Learning curve in a CSV file, read back when a training goes on.

    Parameters
    ----------
    file : Path
        Need not exist yet.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self.rows: list[dict[str, float]] = []
        if file.exists():
            try:
                rows = csv.DictReader(read_text(file, inside=file.parent).splitlines())
                if "decisions" not in (rows.fieldnames or ()):
                    raise ValueError("it has no column decisions")
                self.rows = [{name: float(value) for name, value in row.items()} for row in rows]
                if not np.isfinite([(row["decisions"], row["seconds"], merit(row)) for row in self.rows]).all():
                    raise ValueError("decisions, seconds and results must be finite")
            except (KeyError, TypeError, ValueError, csv.Error) as error:
                raise ValueError(
                    f"{file} is no learning curve ({first_line(error)}): give another directory"
                ) from error

    @property
    def seconds(self) -> float:
        """Time of the training so far, s."""
        return self.rows[-1]["seconds"] if self.rows else 0.0

    def cut(self, decisions: int) -> None:
        """Drop rows after so many decisions: of looks after which the state of the training was not saved."""
        self.rows = [row for row in self.rows if row["decisions"] <= decisions * (1.0 + _ROUNDED)]

    @property
    def best(self) -> dict[str, float]:
        """The row of the network that is kept, by `merit`."""
        return max(self.rows, key=merit)

    def add(
        self,
        decisions: int,
        seconds: float,
        mean_return: float,
        results: PolicyEvaluation | EpisodeOutcome,
        diagnostics: Mapping[str, float] = MappingProxyType({}),
    ) -> bool:
        """Add a row; whether it is the best so far."""
        decisions_made = decisions - (self.rows[-1]["decisions"] if self.rows else 0.0)
        speed = decisions_made / max(seconds - self.seconds, 1e-9) if decisions_made else np.nan
        row = {"decisions": float(decisions), "seconds": seconds, "mean_return": mean_return, **asdict(results)}
        row |= {"decisions_per_second": speed, **{name: diagnostics.get(name, np.nan) for name in DIAGNOSTICS}}
        self.rows.append(row)
        best = self.best is row
        stream = io.StringIO(newline="")
        writer = csv.DictWriter(stream, list(dict.fromkeys(name for each in self.rows for name in each)), restval="nan")
        writer.writeheader()
        writer.writerows({name: f"{value:.6g}" for name, value in each.items()} for each in self.rows)
        write_text(self._file, stream.getvalue())
        return best


def train(
    task: Task,
    settings: PPOSettings,
    out: Path,
    *,
    minutes: float | None = None,
    progress: Progress | None = None,
) -> Path:
    """Train a network, or go on where an interrupted run in `out` stopped.

    `out` gets `run.json` (task, settings, versions, commit), `learning_curve.csv` (return, claim, true error, losses,
    entropy, KL, explained variance, throughput), `policy.npz` (of a `GazeTask` the network with the least true error on
    the validation episodes, else that with the largest return, see `Network`), `state.pt` (to go on) and,
    where TensorBoard is installed, `tensorboard/` with all that stable-baselines3 logs. A training that was stopped
    between two looks at the validation episodes goes on from the last look, with the bits of one that was not stopped.

    Parameters
    ----------
    task : GazeTask or RegisteredTask
        What on.
    settings : PPOSettings
        How.
    out : Path
        Directory of the run.
    minutes : float, optional
        Stop at the first look at the validation episodes after this time; the same call goes on.
    progress : callable, optional
        Called with decisions made, decisions wanted, and the latest result in words.

    Returns
    -------
    Path
        Of `policy.npz`.

    Raises
    ------
    ImportError
        The extra rl is missing.
    ValueError
        `out` holds something else or another training, is damaged, or is in use by another process.
    """
    require_module("stable_baselines3", "rl")
    import torch

    about = _about(task, settings)
    require_own_training(out, about)
    more = None if minutes is None else 60.0 * positive("minutes", minutes)
    torch.set_num_threads(1)
    with claimed_folder(out), _learner(task, settings, out) as (model, scaling):
        require_own_training(out, about)
        curve = LearningCurve(out / "learning_curve.csv")
        curve.cut(model.num_timesteps if (out / STATE).exists() else -1)
        began = time.monotonic() - curve.seconds
        limit = None if more is None else curve.seconds + more
        write_json(out / ABOUT, about)
        seeds, last_words = VALIDATION_SEEDS[: settings.validation], ""
        validation: dict[str, float] = {}

        def look() -> str:
            """Evaluate the network, keep it if it is the best so far, and save the state of the training."""
            made_by = {"task": asdict(task), "settings": asdict(settings), "decisions": model.num_timesteps}
            network = network_of(model, scaling, made_by, task.choices)
            results = evaluate(network, task, seeds, threads=settings.threads)
            returns = [episode["r"] for episode in model.ep_info_buffer or ()] or [np.nan]
            if curve.add(model.num_timesteps, time.monotonic() - began, float(np.mean(returns)), results, validation):
                network.save(out / "policy.npz")
            _save_state(out / STATE, model, scaling)
            summary = words(task, results)
            _log.info("%d decisions: %s", model.num_timesteps, summary)
            return summary

        if not curve.rows:
            last_words = look()
        while model.num_timesteps < settings.decisions and (limit is None or curve.seconds < limit):
            target = min(model.num_timesteps + settings.evaluate_every, settings.decisions)
            _begin_stage(model, settings.seed)
            while model.num_timesteps < target:
                model.learn(settings.steps * settings.environments, reset_num_timesteps=False)
                logged = model.logger.name_to_value
                validation = {name: float(logged[key]) for name, key in DIAGNOSTICS.items() if key in logged}
                model.logger.dump(model.num_timesteps)  # each `learn` begins with a new logger: TensorBoard's share
                if progress is not None:
                    progress(min(model.num_timesteps, settings.decisions), settings.decisions, last_words)
            last_words = look()
    return out / "policy.npz"


def _about(task: Task, settings: PPOSettings) -> dict[str, Any]:
    """Content of `run.json`."""
    versions = {name: version_of(name) for name in _PACKAGES} | {"python": platform.python_version()}
    made_with = {"task": asdict(task), "settings": asdict(settings), "versions": versions, "commit": commit()}
    about: dict[str, Any] = json.loads(json_text(made_with))
    return about


def require_own_training(out: Path, about: Mapping[str, Any]) -> None:
    """Raise a `ValueError` where `out` holds anything but this training, be it with another length or threads."""
    if out.exists() and not out.is_dir():
        raise ValueError(f"output {out} is a file: give a directory")
    if not out.is_dir() or not is_occupied(out):
        return
    try:
        before = read_json(out / ABOUT, inside=out)
    except FileNotFoundError:
        before = None
    parts = ("task", "settings")
    if not isinstance(before, dict) or not all(isinstance(before.get(part), dict) for part in parts):
        raise ValueError(f"output {out} is not empty and holds no training: choose another directory")
    require_links_inside(out, only=_WRITTEN)
    for part in parts:
        for key, value in about[part].items():
            if key not in ("decisions", "threads") and before[part].get(key) != value:
                raise ValueError(
                    f"{out} holds a run with {key} = {before[part].get(key)!r}, not {value!r}: give another directory"
                )


@contextmanager
def _learner(task: Task, settings: PPOSettings, out: Path) -> Iterator[tuple[PPO, VecNormalize]]:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    from stereo_slam_env.policies.sb3 import SB3VecEnv

    vector = task.make_vector(
        settings.environments, autoreset_mode="SameStep", scenes=settings.scenes, threads=settings.threads
    )
    scaling = VecNormalize(VecMonitor(SB3VecEnv(vector)), clip_obs=_OBSERVATION_CLIP, gamma=settings.discount)
    try:
        scaling.seed(settings.seed)
        model = PPO(
            "MultiInputPolicy",
            scaling,
            learning_rate=settings.learning_rate,
            n_steps=settings.steps,
            batch_size=settings.minibatch,
            n_epochs=settings.epochs,
            gamma=settings.discount,
            gae_lambda=settings.gae_lambda,
            clip_range=settings.clip,
            ent_coef=settings.entropy,
            policy_kwargs={"net_arch": list(settings.layers), "log_std_init": settings.initial_log_std},
            seed=settings.seed,
            device="cpu",
            tensorboard_log=str(out / "tensorboard") if find_spec("tensorboard") else None,
        )
        if settings.initial_bias:
            _bias(model, settings.initial_bias)
        if (out / STATE).exists():
            _load_state(out / STATE, model, scaling)
        yield model, scaling
    finally:
        scaling.close()


def _bias(model: PPO, biases: Sequence[float]) -> None:
    """Set the biases of the last layer of the policy; a `ValueError` where it has another number of them."""
    import torch

    bias = model.policy.action_net.bias
    if len(biases) != len(bias):
        raise ValueError(f"initial_bias must have {len(bias)} numbers, one for each output, got {len(biases)}")
    with torch.no_grad():
        bias.copy_(torch.tensor(biases))


def _begin_stage(model: PPO, seed: int) -> None:
    """Begin new episodes, with randomness from the seed and the decisions made alone.

    So what follows depends on what `_save_state` keeps, and on nothing else.
    """
    model.set_random_seed(int(np.random.SeedSequence([seed, model.num_timesteps]).generate_state(1)[0] >> 1))
    model._last_obs = None  # the environments are reset
    if model.ep_info_buffer is not None:
        model.ep_info_buffer.clear()


def network_of(
    model: PPO, scaling: VecNormalize, about: Mapping[str, Any], choices: FloatArray | None = None
) -> Network:
    """The policy network of a PPO model with a `MultiInputPolicy` of tanh layers, as plain arrays.

    `scaling` is that of its observations, a Dict of boxes; `about` is kept with it; `choices` (A, n) are the actions
    that the numbers of a discrete action space stand for.
    """
    state = {name: np.asarray(tensor.tolist()) for name, tensor in model.policy.state_dict().items()}
    hidden = sorted({int(name.split(".")[2]) for name in state if name.startswith("mlp_extractor.policy_net.")})
    layers = [f"mlp_extractor.policy_net.{number}" for number in hidden] + ["action_net"]
    keys = tuple(scaling.obs_rms)  # in the order in which the features are joined
    mean, variance = (
        np.concatenate([np.ravel(getattr(scaling.obs_rms[k], of)) for k in keys]) for of in ("mean", "var")
    )
    return Network(
        keys,
        mean,
        np.sqrt(variance + scaling.epsilon),
        float(scaling.clip_obs),
        tuple(state[f"{layer}.weight"] for layer in layers),
        tuple(state[f"{layer}.bias"] for layer in layers),
        about,
        choices,
    )


def _moments(scaling: VecNormalize) -> dict[str, Any]:
    """Running moments of each key of the observation and, under "", of the reward."""
    return {**scaling.obs_rms, "": scaling.ret_rms}


def _save_state(file: Path, model: PPO, scaling: VecNormalize) -> None:
    """Weights, optimiser and scaling: plain tensors and numbers, nothing that runs when it is read."""
    import torch

    state = {
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "decisions": model.num_timesteps,
        "moments": {
            key: (np.asarray(rms.mean).tolist(), np.asarray(rms.var).tolist(), float(rms.count))
            for key, rms in _moments(scaling).items()
        },
    }
    write_atomically(file, lambda stream: torch.save(state, stream))


def _load_state(file: Path, model: PPO, scaling: VecNormalize) -> None:
    import torch

    with open_regular(file, inside=file.parent) as stream:
        try:
            require_plain_zip(stream)
            state = torch.load(stream, weights_only=True)
            model.policy.load_state_dict(state["policy"])
            model.policy.optimizer.load_state_dict(state["optimizer"])
            model.num_timesteps = whole_number("decisions", state["decisions"], 0)
            for key, rms in _moments(scaling).items():
                mean, variance = (np.asarray(values, dtype=np.float64) for values in state["moments"][key][:2])
                if mean.shape != np.shape(rms.mean) or variance.shape != np.shape(rms.var):
                    raise ValueError(f"the moments of {key!r} have the shape {mean.shape}")
                rms.mean, rms.var, rms.count = mean, variance, float(state["moments"][key][2])
        except Exception as error:  # of PyTorch, pickle or zip, as the damage is
            raise ValueError(
                f"{file} is no state of this training ({first_line(error)}): give another directory"
            ) from error
