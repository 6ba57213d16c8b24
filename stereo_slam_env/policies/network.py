"""A trained policy: a small network of plain arrays that runs on NumPy alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from filters.contract.validation import first_line
from filters.geometry.arrays import FloatArray
from stereo_slam_env.files.folders import write_atomically
from stereo_slam_env.files.readers import read_arrays
from stereo_slam_env.policies.registry import Action, gaze_action, require_head

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
        """See `Policy.reset`."""
        require_head(env)
        self._env, self._step = env, 0

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        if self._step % self._hold == 0:
            missing = [key for key in self.network.keys if key not in observation]
            if missing:
                raise ValueError(
                    f"the network sees {missing[0]!r}, which is not in the observation: add BeliefPanorama"
                )
            self._action = gaze_action(self._env, self.network.action(observation))
        self._step += 1
        return self._action
