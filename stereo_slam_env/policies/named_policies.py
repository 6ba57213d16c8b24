"""Policies by name, ours and third-party ones, their interface, and open-loop policies as baselines.

A third party adds a policy with an entry point in the group `stereo_slam.policies`; the object is called with the
options of the policy and returns a `Policy`.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from filters.contract.validation import did_you_mean, finite_number, first_line, positive, require_known, type_name
from filters.geometry.arrays import FloatArray
from stereo_slam_env.envs.row_wrapper import moving_head
from stereo_slam_env.files.folders import write_atomically
from stereo_slam_env.files.readers import read_arrays
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.world.vehicle import Head

Action = NDArray[np.float32]


class Policy(Protocol):
    """A policy: decides where to look.

    Policies never look at the truth and never copy the environment. What they may ask it for, with `get_wrapper_attr`,
    are `slam` (the filter in the loop, see `envs.BeliefObservation`), `camera`, `noise`, `head`, `head_angles`,
    `route`, the planned drive, and of `options` what the sensors are like (range, noise of the odometry).
    """

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """Begin an episode, which has just begun in `env`.

        Parameters
        ----------
        env : gymnasium.Env
            Reset.
        rng : numpy.random.Generator
            Randomness of the policy.
        """

    def act(self, observation: Mapping[str, Any]) -> Action:
        """The next action, from the observation of the last `reset` or `step`."""


@runtime_checkable
class ActsTogether(Policy, Protocol):
    """A policy that decides in many environments at once; the others are asked one after the other."""

    @staticmethod
    def act_together(policies: Sequence[Any], observations: Sequence[Mapping[str, Any]]) -> Action:
        """The next actions of policies of this class (Q, ...), each as its `act` would decide.

        The policies are made alike, and in rows of one vector of environments.
        """


def require_head(env: gym.Env[Any, Any]) -> Head:
    """The head of an environment; a `ValueError` where it has none that moves."""
    return moving_head(env.get_wrapper_attr("head"))


def look_towards(env: gym.Env[Any, Any], angles: FloatArray) -> Action:
    """The action that turns the head towards pan and tilt (..., 2), rad, and asks for nothing else."""
    head = require_head(env)
    return gaze_action(env, np.clip(angles / np.array(head.max_angles), -1.0, 1.0))


def gaze_action(env: gym.Env[Any, Any], decided: ArrayLike) -> Action:
    """An action (...,) whose last entries are `decided` (..., n), and that asks for nothing else.

    The last two are pan and tilt.
    """
    last = np.asarray(decided, dtype=np.float32)
    assert env.action_space.shape is not None
    action = np.zeros((*last.shape[:-1], *env.action_space.shape), dtype=np.float32)
    action[..., -last.shape[-1] :] = last
    return action


ENTRY_POINT_GROUP = "stereo_slam.policies"

_OWN = {
    "fixed": "named_policies:FixedGaze",
    "random": "named_policies:RandomGaze",
    "sweep": "named_policies:Sweep",
    "most-uncertain": "planning:MostUncertain",
    "greedy": "planning:Greedy",
    "lookahead": "planning:Lookahead",
    "ppo": "named_policies:NetworkPolicy",
}


def make_policy(name: str, **options: Any) -> Policy:
    """Make a policy by name.

    Parameters
    ----------
    name : str
        One of `available_policies()`.
    **options
        The policy's own, JSON-able.

    Raises
    ------
    ValueError
        Unknown name or option, an option's value is refused, or a third-party policy cannot be loaded.
    """
    factory = _found(name)
    parameters = inspect.signature(factory).parameters
    require_known(f"policy {name!r} has no option", options, parameters)
    policy: Policy = factory(**options)
    return policy


def plugin_of(name: str) -> EntryPoint | None:
    """The entry point of a third-party policy; None for one of ours."""
    return None if name in _OWN else _entry_points().get(name)


def available_policies() -> dict[str, str]:
    """Names and one line on each."""
    return {name: (inspect.getdoc(_found(name)) or "no description").splitlines()[0] for name in _entry_points()}


def _own_entry_points() -> dict[str, EntryPoint]:
    return {name: EntryPoint(name, f"{__package__}.{what}", ENTRY_POINT_GROUP) for name, what in _OWN.items()}


def _entry_points() -> dict[str, EntryPoint]:
    """Ours, and those of third parties that have another name."""
    points = _own_entry_points()
    return {
        **points,
        **{point.name: point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name not in points},
    }


def _found(name: str) -> Callable[..., Any]:
    points = _own_entry_points()
    if name not in points:
        points = _entry_points()  # asks every installed package: a tenth of a second
    if name not in points:
        raise ValueError(f"policy must be one of {', '.join(points)}, got {name!r}{did_you_mean(name, points)}")
    point = points[name]
    try:
        loaded: Callable[..., Any] = point.load()
    except Exception as error:  # whatever a stranger's module does at import must not take the run down
        raise ValueError(
            f"policy {name!r} ({point.value}) cannot be loaded: {type_name(error)}: {first_line(error)}"
        ) from error
    return loaded


class _OpenLoop:
    """Looks where `_angles` says after each number of steps."""

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._limits = np.array(require_head(env).max_angles)
        self._env, self._rng, self._step = env, rng, -1

    def act(self, observation: Mapping[str, Any]) -> Action:
        self._step += 1
        return look_towards(self._env, self._angles())

    def _angles(self) -> FloatArray:
        raise NotImplementedError


class FixedGaze(_OpenLoop):
    """Look in one direction, straight ahead by default.

    Parameters
    ----------
    pan, tilt : float
        rad.
    """

    def __init__(self, pan: float = 0.0, tilt: float = 0.0) -> None:
        self._direction = np.array([finite_number("pan", pan), finite_number("tilt", tilt)])

    def _angles(self) -> FloatArray:
        return self._direction


class RandomGaze(_OpenLoop):
    """Look in a random direction for a while, then in another.

    Parameters
    ----------
    seconds : float
        Duration of each direction.
    """

    def __init__(self, seconds: float = 1.0) -> None:
        self._steps = max(1, round(positive("seconds", seconds) / FRAME_PERIOD))

    def _angles(self) -> FloatArray:
        if self._step % self._steps == 0:
            self._direction: FloatArray = self._rng.uniform(-self._limits, self._limits)
        return self._direction


class Sweep(_OpenLoop):
    """Pan from side to side, in a sine.

    Parameters
    ----------
    period : float
        Duration of one sweep to both sides, s.
    amplitude : float
        Largest pan to either side, rad.
    """

    def __init__(self, period: float = 5.0, amplitude: float = 1.2) -> None:
        self._period, self._amplitude = positive("period", period), positive("amplitude", amplitude)

    def _angles(self) -> FloatArray:
        phase = 2 * np.pi * (self._step + 1) * FRAME_PERIOD / self._period
        return np.array([self._amplitude * np.sin(phase), 0.0])


CHECKPOINT = Path(__file__).with_name("checkpoints") / "gaze-ppo.npz"
"""The network that comes with the package, made by `stereo-slam train`."""
_FORMAT = 1


@dataclass(frozen=True, eq=False)
class Network:
    """A multi-layer perceptron with tanh between its layers.

    The entries `keys` of the observation, flattened and joined in this order, are its N inputs, shifted and scaled, (x
    - `mean`) / `scale`, and clipped to `clip` on either side. `weights` are (outputs, inputs) and `biases` (outputs,)
    of each layer. The largest output chooses a row of `choices` (outputs, n), which is the action; None: the outputs
    are the action. `about` says how it was made and is JSON-able; `about["task"]["hold"]` is for how many steps a
    decision holds.
    """

    keys: tuple[str, ...]
    mean: FloatArray
    scale: FloatArray
    clip: float
    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
    about: Mapping[str, Any] = field(default_factory=dict)
    choices: FloatArray | None = None

    def action(self, observation: Mapping[str, Any]) -> Action:
        """The best action, clipped to -1..1; a ValueError for an observation of another size."""
        return np.asarray(self.actions({key: np.asarray(observation[key])[None] for key in self.keys})[0])

    def actions(self, observations: Mapping[str, Any]) -> Action:
        """The best actions for many observations, one a row: (B, n); raises as `action`."""
        parts = [np.asarray(observations[key], dtype=np.float64) for key in self.keys]
        x = np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)
        if x.shape[1] != len(self.mean):
            raise ValueError(
                f"the network sees {len(self.mean)} numbers, and the observation has {x.shape[1]} "
                f"({', '.join(self.keys)}): train one for this environment with stereo-slam train"
            )
        x = ((x - self.mean) / self.scale).clip(-self.clip, self.clip)
        last = len(self.weights) - 1
        for number, (W, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = x @ W.T + b
            if number < last:
                x = np.tanh(x)
        best = x.clip(-1.0, 1.0) if self.choices is None else self.choices[np.argmax(x, axis=1)]
        return best.astype(np.float32)

    def save(self, path: Path) -> None:
        """Write it as arrays (.npz)."""
        arrays: dict[str, Any] = {f"weights_{k}": W.astype(np.float32) for k, W in enumerate(self.weights)}
        arrays |= {f"biases_{k}": b.astype(np.float32) for k, b in enumerate(self.biases)}
        about = {"format": _FORMAT, "keys": list(self.keys), "clip": self.clip, "about": dict(self.about)}
        if self.choices is not None:
            arrays["choices"] = self.choices
        arrays |= {"json": np.array(json.dumps(about)), "mean": self.mean, "scale": self.scale}
        write_atomically(path, lambda stream: np.savez_compressed(stream, **arrays))

    @classmethod
    def load(cls, path: Path) -> Network:
        """Read what `save` wrote; nothing in the file is executed. A `ValueError` where it is missing or no network."""
        try:
            arrays = read_arrays(path)
            about = json.loads(str(arrays["json"]))
            if about["format"] != _FORMAT:
                raise ValueError(f"format {about['format']!r}")
            count = sum(name.startswith("weights_") for name in arrays)
            return cls(
                tuple(about["keys"]),
                arrays["mean"],
                arrays["scale"],
                float(about["clip"]),
                tuple(arrays[f"weights_{k}"].astype(np.float64) for k in range(count)),
                tuple(arrays[f"biases_{k}"].astype(np.float64) for k in range(count)),
                about["about"],
                arrays.get("choices"),
            )
        except FileNotFoundError:
            raise ValueError(f"checkpoint {path} does not exist: make one with stereo-slam train") from None
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            what = f"checkpoint {path} is not a network written by stereo-slam train"
            raise ValueError(f"{what}: {first_line(error)}") from error


class NetworkPolicy:
    """Look where a network decides that was trained with PPO on `StereoSlam/Gaze-v0`.

    Parameters
    ----------
    checkpoint : str, optional
        File written by `stereo-slam train`. None: the one that comes with the package.
    """

    def __init__(self, checkpoint: str | None = None) -> None:
        self.network = Network.load(CHECKPOINT if checkpoint is None else Path(checkpoint))
        self._hold = int(self.network.about.get("task", {}).get("hold", 1))

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        require_head(env)
        self._env, self._step = env, 0

    def act(self, observation: Mapping[str, Any]) -> Action:
        if self._step % self._hold == 0:
            missing = [key for key in self.network.keys if key not in observation]
            if missing:
                raise ValueError(
                    f"the network sees {missing[0]!r}, which is not in the observation: add BeliefPanorama"
                )
            self._action = gaze_action(self._env, self.network.action(observation))
        self._step += 1
        return self._action
