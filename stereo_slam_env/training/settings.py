"""Settings of a training by proximal policy optimisation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from filters.contract.validation import positive, probability, whole_number

VALIDATION_SEEDS = tuple(range(100_000, 100_256))
"""Episodes on which the best network of a run is chosen; training never sees them, and reports use others."""
FEW_DECISIONS: Mapping[str, int] = MappingProxyType({"rollout": 512, "minibatch": 64, "validation": 32})
"""Of `PPOSettings`, for tasks in which a decision takes a second of driving or more."""


@dataclass(frozen=True)
class PPOSettings:
    """Settings of the training.

    Raises
    ------
    ValueError
        A value is impossible.
    """

    decisions: int = 120_000
    """How many are made in all; in a `GazeTask` each holds for `hold` steps."""
    seed: int = 0
    """Of the network, of chance in its actions, and of the episodes."""
    environments: int = 16
    """How many run at once, in lock-step."""
    threads: int = 1
    """Over which the environments are spread; the result does not depend on it."""
    layers: tuple[int, ...] = (64, 64)
    """Neurons of the hidden layers, of policy and value alike."""
    rollout: int = 2048
    """Decisions of all environments together between two updates."""
    minibatch: int = 256
    """Decisions in a gradient step."""
    epochs: int = 10
    """Passes over a rollout."""
    learning_rate: float = 5e-4
    """Step size of Adam."""
    discount: float = 0.95
    """Weight of a reward that comes one decision later."""
    gae_lambda: float = 0.95
    """Lambda of generalised advantage estimation."""
    clip: float = 0.2
    """By how much the ratio of new to old probability of a decision may differ from 1."""
    entropy: float = 0.01
    """Weight of the entropy of decisions, so that it goes on trying."""
    initial_log_std: float = -0.7
    """Logarithm of the standard deviation of continuous actions at first."""
    initial_bias: tuple[float, ...] = ()
    """Of the outputs of the policy at first: logits of a choice, or means of the entries of a Box; none: 0."""
    evaluate_every: int = 16_384
    """Decisions between two looks at the validation episodes."""
    validation: int = len(VALIDATION_SEEDS)
    """How many of these there are, at most 256."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", tuple(self.layers))
        object.__setattr__(self, "initial_bias", tuple(self.initial_bias))
        for name in ("decisions", "environments", "threads", "rollout", "minibatch", "epochs", "evaluate_every"):
            whole_number(name, getattr(self, name), 1)
        whole_number("validation", self.validation, 1, len(VALIDATION_SEEDS))
        whole_number("seed", self.seed, 0)
        for width in self.layers:
            whole_number("layers", width, 1)
        for name in ("learning_rate", "clip"):
            positive(name, getattr(self, name))
        positive("entropy", self.entropy, allow_zero=True)
        for name in ("discount", "gae_lambda"):
            probability(name, getattr(self, name))

    @property
    def steps(self) -> int:
        """Decisions of each environment between two updates."""
        return max(self.rollout // self.environments, 1)
