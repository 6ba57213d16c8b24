"""What an agent is trained on: an environment with a filter in the loop, and a reward for what the filter learns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import gymnasium as gym
from gymnasium.wrappers import FilterObservation, RepeatAction

from filters.known_names import require_known
from filters.validation import positive

GAZE_FILTER: Mapping[str, Any] = {"drop_unseen": False, "motion": "velocity-driven", "iterations": 2}
"""Options of a filter for a head that turns: it keeps what is out of view, believes the odometry, and linearises twice,
because landmarks that come back into view correct it by a lot at once."""
POLICY_KEYS = ("belief_sigmas", "head", "panorama")
"""Keys of the observation that a network decides by, in their order."""


@dataclass(frozen=True)
class GazeTask:
    """An environment, the filter in the loop, and the reward; JSON-able.

    Attributes
    ----------
    environment : str
        An id with a head.
    arguments : mapping
        Of the environment.
    filter : str
        Name of the filter in the loop.
    filter_options : mapping
        Of the filter.
    criterion : str
        Of `InformationGain`, on the pose.
    resolution : (2,) tuple
        Of `InformationGain`: knowing the position better than this, m, and the rotation, rad, is worth nothing.
    hold : int
        Steps for which a decision holds.
    """

    environment: str = "StereoSlam/Gaze-v0"
    arguments: Mapping[str, Any] = field(default_factory=dict)
    filter: str = "shared-anchor"
    filter_options: Mapping[str, Any] = field(default_factory=lambda: dict(GAZE_FILTER))
    criterion: str = "log-det"
    resolution: tuple[float, float] = (0.01, 0.001)
    hold: int = 5

    def __post_init__(self) -> None:
        if type(self.hold) is not int or self.hold < 1:
            raise ValueError(f"hold must be an integer >= 1, got {self.hold!r}")
        object.__setattr__(self, "resolution", tuple(positive("resolution", value) for value in self.resolution))

    def make(self) -> gym.Env[Any, Any]:
        """The environment as classical policies and benchmarks see it: with the belief in the observation."""
        import stereo_slam_env  # noqa: F401 (registers the ids, also in a process that was spawned)
        from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama

        env = gym.make(self.environment, **self.arguments)
        return BeliefPanorama(BeliefObservation(env, self.filter, options=self.filter_options))

    def make_for_learning(self) -> gym.Env[Any, Any]:
        """The environment as a network sees it: `POLICY_KEYS` only, paid for what the filter learns of the pose."""
        from stereo_slam_env.wrappers import InformationGain

        paid = InformationGain(self.make(), self.criterion, of="pose", resolution=self.resolution)
        return FilterObservation(RepeatAction(paid, self.hold), POLICY_KEYS)

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form; `from_dict` reads it."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> GazeTask:
        """A task from its JSON form; an unknown key is refused with the nearest known one."""
        require_known("task has no key", data, [*cls.__dataclass_fields__])
        return cls(**data)
