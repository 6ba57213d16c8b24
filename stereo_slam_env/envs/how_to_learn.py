"""Settings with which environments are best learnt, by the names of `PPOSettings`: `metadata["training"]` has them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

STEERING: Mapping[str, Any] = MappingProxyType(
    {
        **{"environments": 64, "rollout": 4096, "minibatch": 512, "evaluate_every": 65_536, "validation": 32},
        **{"learning_rate": 1e-3, "discount": 0.995, "entropy": 0.002},
        **{"initial_log_std": -1.2, "initial_bias": [0.3, 0.0]},
    }
)
"""Steering: a car that drives, and hardly swerves, from the beginning. One that stands, or leaves the lane at once,
sees no road."""
FEW_DECISIONS: Mapping[str, int] = MappingProxyType({"rollout": 512, "minibatch": 64, "validation": 32})
"""Tasks in which a decision takes a second of driving or more."""
