"""`Rows`: B environments of one kind in arrays, which everything that is an environment is made of.

One environment is `Rows` with one row, `OneRow` makes such of any single environment, `MixedRows` puts several worlds
side by side, and what a wrapper does is a `RowsWrapper`, written once for one row and for many.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from filters.contract.inputs import Start
from filters.contract.validation import finite_array
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.poses import Pose
from stereo_slam_env.recording.recording import Frame, LandmarkTruth
from stereo_slam_env.simulator.state import Kept, State
from stereo_slam_env.world.routes import Route

Arrays = dict[str, Any]
Step = tuple[FloatArray, BoolArray, BoolArray]
"""Rewards, and which rows are terminated and truncated; each (B,)."""
Seeds = Sequence[int | None]
_NOT_STATE = ("env", "spec", "_cached_spec", "_saved_kwargs", "_metadata", "_render_mode")
"""Attributes of other people's wrappers that their arguments have made."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of some rows in full precision, one row after the other."""

    offsets: IntArray
    """(B + 1,): those of row b are offsets[b] to offsets[b + 1] - 1."""
    ids: IntArray
    """(M,): landmarks, ascending in each row."""
    uvd: FloatArray
    """(M, 3): measurements, px."""
    v_right: FloatArray
    """(M,): rows in the right image, px, where they are measured."""
    with_right: BoolArray
    """(B,): whether rows in the right image are measured."""
    R: FloatArray | None
    """(M, 3, 3): covariances. None: none came with the measurements."""
    times: FloatArray
    """(B,), s."""
    odometry: tuple[FloatArray, FloatArray, BoolArray]
    """Of each row: (B, 6) values, (6, 6) or (B, 6, 6) covariances, and whether there is one (B,)."""


class World(Protocol):
    """Interface of environments on rows, as wrappers use it."""

    def measured(self, which: BoolArray) -> Measured:
        """Measurements of the frames of some rows (B,); of the others there are none."""

    def angles(self) -> FloatArray:
        """Pan and tilt of the heads, rad; (B, 2)."""

    def times(self) -> FloatArray:
        """Times of the frames, s; (B,)."""

    def told(self, name: str) -> FloatArray:
        """A number of `info`, after the last step; (B,)."""

    def shown(self, key: str) -> NDArray[Any]:
        """A key of the observation, after the last step; (B, ...)."""

    def true_positions(self) -> FloatArray:
        """True positions of the left cameras, in W, m; (B, 3)."""

    def true_bodies(self) -> FloatArray:
        """Moving bodies, as `truth_bodies` of `info` has them; (B, K, 14)."""

    def frame(self, b: int) -> Frame:
        """The frame in full precision."""

    def start(self, b: int) -> Start:
        """Start of the episode, as filters are given it."""

    def route_of(self, b: int) -> Route:
        """Nominal drive of a row, without errors."""

    def reroute(self, b: int, route: Route) -> None:
        """Follow another nominal drive from now on, whose steps are the same up to this frame."""

    def body(self, b: int) -> Pose:
        """Pose of the left camera if the head looked straight ahead."""

    def generator(self, b: int) -> np.random.Generator:
        """Random generator of the episodes."""

    def landmark_truth(self, b: int) -> LandmarkTruth:
        """True positions of all landmarks."""


class Rows(Kept, ABC):
    """B environments of one kind. Rows that are not asked to do something stay as they are."""

    num_envs: int
    """Number of rows, B."""
    observation_space: Any
    """`gymnasium.spaces.Space` of one row."""
    action_space: Any
    """`gymnasium.spaces.Space` of one row."""
    world: World
    """What is behind the rows."""

    @abstractmethod
    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """Begin an episode of the chosen rows (B,); a seed is None where the generator of the row goes on."""

    @abstractmethod
    def step(self, actions: Any, going: BoolArray) -> Step:
        """Step the rows that go on (B,), by actions (B, ...); the others get reward 0 and no flag."""

    @abstractmethod
    def observe(self) -> tuple[Arrays, Arrays]:
        """Observation and `info` of all rows, each key with a first axis of B; they are the caller's."""

    @abstractmethod
    def get_attr(self, name: str) -> Any:
        """Attribute of all rows, by the name that single environments have for it; or an `AttributeError`."""

    def select_keys(self, keys: Collection[str]) -> None:
        """Use only these keys of the observation; others may be left out."""

    def close(self) -> None:
        """Give back what was taken; may be called twice."""


class OneRow(Rows):
    """A single environment as one row."""

    changes = ("_said", "_looked")

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        self.num_envs, self.env, self.world = 1, env, self
        self.observation_space, self.action_space = env.observation_space, env.action_space
        self._said: tuple[Any, dict[str, Any]] = {}, {}
        self._looked = False

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        self._said, self._looked = self.env.reset(seed=seeds[0], options=dict(options) or None), False

    def step(self, actions: Any, going: BoolArray) -> Step:
        observation, reward, terminated, truncated, info = self.env.step(actions[0])
        self._said, self._looked = (observation, info), False
        return np.array([float(reward)]), np.array([bool(terminated)]), np.array([bool(truncated)])

    def observe(self) -> tuple[Arrays, Arrays]:
        """Whatever is in `info` is passed on as it is."""
        observation, info = deepcopy(self._said) if self._looked else self._said  # nothing is handed out twice
        self._looked = True
        batched: Any = np.asarray(observation)[None]
        if isinstance(observation, Mapping):
            batched = {key: np.asarray(value)[None] for key, value in observation.items()}
        return batched, {key: [value] for key, value in info.items()}

    def get_attr(self, name: str) -> Any:
        return self.env.get_wrapper_attr(name)

    def snapshot(self) -> State:
        """The environment is part of it."""
        return {**super().snapshot(), "env": state_of(self.env)}

    def restore(self, state: Mapping[str, Any]) -> None:
        put_state(self.env, state["env"])
        super().restore(state)

    def frame(self, b: int) -> Frame:
        frame: Frame = self.get_attr("frame")
        return frame

    def start(self, b: int) -> Start:
        start: Start = self.get_attr("start")
        return start

    def route_of(self, b: int) -> Route:
        route: Route = self.get_attr("route")
        return route

    def reroute(self, b: int, route: Route) -> None:
        self.get_attr("reroute")(route)

    def body(self, b: int) -> Pose:
        body: Pose = self.get_attr("body")
        return body

    def generator(self, b: int) -> np.random.Generator:
        return self.env.np_random

    def landmark_truth(self, b: int) -> LandmarkTruth:
        truth: LandmarkTruth = self.get_attr("landmark_truth")()
        return truth

    def angles(self) -> FloatArray:
        if self.env.has_wrapper_attr("head_angles"):
            return np.asarray(self.get_attr("head_angles"), dtype=np.float64)[None]
        return np.asarray(self._said[0].get("head", np.zeros(2)), dtype=np.float64)[None]

    def times(self) -> FloatArray:
        return np.array([self.frame(0).timestamp])

    def told(self, name: str) -> FloatArray:
        return np.array([self._said[1][name]], dtype=np.float64)

    def shown(self, key: str) -> NDArray[Any]:
        return np.asarray(self._said[0][key])[None]

    def true_positions(self) -> FloatArray:
        """Raise a `ValueError` where a frame has no truth."""
        truth = self.frame(0).truth
        if truth is None:
            raise ValueError("the environment must have the truth: its frames have truth = None")
        return truth.position[None]

    def true_bodies(self) -> FloatArray:
        return np.asarray(self._said[1]["truth_bodies"], dtype=np.float64)[None]

    def measured(self, which: BoolArray) -> Measured:
        frame = self.frame(0)
        observation, odometry = frame.observation.ordered(), frame.odometry
        right = np.zeros(len(observation)) if observation.v_right is None else observation.v_right
        values, covariance = np.zeros((1, 6)), np.zeros((6, 6))
        if odometry is not None:
            values[0, :3], values[0, 3:], covariance = odometry.linear, odometry.angular, odometry.covariance
        return Measured(
            np.array([0, len(observation)]),
            observation.ids,
            observation.uvd,
            right,
            np.array([observation.v_right is not None]),
            observation.R,
            np.array([frame.timestamp]),
            (values, covariance, np.array([odometry is not None])),
        )


class MixedRows(Rows):
    """Rows of several kinds, one kind after the other; what they show and take must have the same shapes.

    Parameters
    ----------
    parts : sequence of Rows
        At least one.

    Raises
    ------
    ValueError
        Two of them show or take something else.
    """

    def __init__(self, parts: Sequence[Rows]) -> None:
        self.parts, first = list(parts), parts[0]
        self.observation_space, self.action_space, self.world = first.observation_space, first.action_space, first.world
        for part in self.parts:
            if _shapes(part) != _shapes(first):
                raise ValueError(f"worlds must show and take the same, got {_shapes(first)} and {_shapes(part)}")
        self.num_envs = sum(part.num_envs for part in self.parts)
        ends = np.cumsum([part.num_envs for part in self.parts]).tolist()
        self._slices = [slice(end - part.num_envs, end) for end, part in zip(ends, self.parts, strict=True)]

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        for part, rows in zip(self.parts, self._slices, strict=True):
            if chosen[rows].any():
                part.reset(chosen[rows], seeds[rows], options)

    def step(self, actions: Any, going: BoolArray) -> Step:
        steps = [part.step(actions[rows], going[rows]) for part, rows in zip(self.parts, self._slices, strict=True)]
        rewards, terminated, truncated = (np.concatenate(column) for column in zip(*steps, strict=True))
        return rewards, terminated, truncated

    def observe(self) -> tuple[Arrays, Arrays]:
        observations, infos = zip(*(part.observe() for part in self.parts), strict=True)
        return _joined(observations), _joined(infos)

    def get_attr(self, name: str) -> Any:
        return self.parts[0].get_attr(name)

    def select_keys(self, keys: Collection[str]) -> None:
        for part in self.parts:
            part.select_keys(keys)

    def snapshot(self) -> State:
        return {"parts": [part.snapshot() for part in self.parts]}

    def restore(self, state: Mapping[str, Any]) -> None:
        for part, state_of_part in zip(self.parts, state["parts"], strict=True):
            part.restore(state_of_part)

    def close(self) -> None:
        for part in self.parts:
            part.close()


def _shapes(rows: Rows) -> Any:
    space = rows.observation_space
    shapes = {key: part.shape for key, part in space.items()} if isinstance(space, spaces.Dict) else space.shape
    return shapes, rows.action_space.shape


def _joined(parts: Sequence[Any]) -> Any:
    """Arrays of all parts, one after the other; of a dictionary the keys that all of them have."""
    if isinstance(parts[0], Mapping):
        shared = [key for key in parts[0] if all(key in part for part in parts)]
        return {key: _joined([part[key] for part in parts]) for key in shared}
    return np.concatenate([np.asarray(part) for part in parts])


def checked_actions(name: str, actions: Any, space: gym.Space[Any], count: int) -> Any:
    """Actions (B, ...), or each part of them: finite and within the space, or a `ValueError` that names them."""
    if isinstance(space, spaces.Dict):
        if not isinstance(actions, Mapping) or actions.keys() != space.keys():
            raise ValueError(f"{name} must have the keys {', '.join(space)}, got {actions!r}")
        return {key: checked_actions(name, actions[key], part, count) for key, part in space.items()}
    if isinstance(space, spaces.Box):
        return np.clip(finite_array(name, actions, (count, *space.shape)), space.low, space.high)
    numbers, last = np.asarray(actions), getattr(space, "n", 1) - 1
    is_whole = np.issubdtype(numbers.dtype, np.integer) and numbers.shape == (count,)
    if not is_whole or numbers.min() < 0 or numbers.max() > last:
        wanted_words, got = f"{count} whole numbers", numbers.tolist()
        if name == "action":
            wanted_words, got = "a whole number", got[0]
        raise ValueError(f"{name} must be {wanted_words} from 0 to {last}, got {got!r}")
    return numbers


def state_of(env: Any) -> tuple[Any, ...]:
    """The state of a stack of wrappers, layer by layer, down to the first one that knows those below it."""
    layers: list[Any] = []
    while not isinstance(env, Kept):
        if not hasattr(env, "env"):
            raise ValueError(f"snapshot needs an environment StereoSlam/... or its native vector, got {env}")
        layers.append(deepcopy({name: value for name, value in vars(env).items() if _is_state(name, value)}))
        env = env.env
    return (*layers, env.snapshot())


def put_state(env: Any, state: tuple[Any, ...]) -> None:
    """Set a stack of wrappers back."""
    *layers, inside = state
    for layer in layers:
        vars(env).update(deepcopy(layer))
        env = env.env
    env.restore(inside)


def _is_state(name: str, value: Any) -> bool:
    """Whether an attribute of somebody else's wrapper is state: not a space, a function or what it wraps."""
    return name not in _NOT_STATE and not isinstance(value, gym.Space) and not callable(value)
