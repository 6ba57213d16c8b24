"""From a trained model of stable-baselines3 to a network of plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.policies.network import Network

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize


def network_of(
    model: PPO, scaling: VecNormalize, about: Mapping[str, Any], choices: FloatArray | None = None
) -> Network:
    """What decides in a PPO model with a `MultiInputPolicy` of tanh layers.

    Parameters
    ----------
    model : stable_baselines3.PPO
        The model.
    scaling : stable_baselines3.common.vec_env.VecNormalize
        Of its observations, a Dict of boxes.
    about : mapping
        Kept with the network; JSON-able.
    choices : (A, n), optional
        The actions that the numbers of a discrete action space stand for.
    """
    state = {name: np.asarray(tensor.tolist()) for name, tensor in model.policy.state_dict().items()}
    hidden = sorted({int(name.split(".")[2]) for name in state if name.startswith("mlp_extractor.policy_net.")})
    layers = [f"mlp_extractor.policy_net.{number}" for number in hidden] + ["action_net"]
    keys = tuple(scaling.obs_rms)  # in the order in which the features are joined
    variance = np.concatenate([np.ravel(scaling.obs_rms[key].var) for key in keys])
    return Network(
        keys,
        np.concatenate([np.ravel(scaling.obs_rms[key].mean) for key in keys]),
        np.sqrt(variance + scaling.epsilon),
        float(scaling.clip_obs),
        tuple(state[f"{layer}.weight"] for layer in layers),
        tuple(state[f"{layer}.bias"] for layer in layers),
        about,
        choices,
    )
