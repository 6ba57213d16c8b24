"""`RowsVectorEnv`: rows as a vector environment of Gymnasium."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from operator import index
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from filters.contract.validation import whole_number
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.arguments import StereoOptions
from stereo_slam_env.envs.core_rows import CoreRows
from stereo_slam_env.envs.row_wrapper import RowsWrapper
from stereo_slam_env.envs.rows import Arrays, Rows, Seeds, Step, checked_actions
from stereo_slam_env.envs.stereo_env import row_of
from stereo_slam_env.simulator.state import Kept, Sensed


class RowsVectorEnv(gym.vector.VectorEnv[Arrays, NDArray[Any], NDArray[Any]], Kept):
    """Many environments of one kind, each with a scene, a car, a head, a sensor and random generators of its own.

    Made by `gymnasium.make_vec("StereoSlam/Gaze-v0", num_envs=256)`, for every id. The episode of a seed is that of the
    single environment, bit by bit. `info` has the keys of the single environment, as arrays with one row for each.

    Parameters
    ----------
    rows : Rows
        The environments.
    autoreset_mode : AutoresetMode
        NEXT_STEP: the step after the end of an episode is its reset, without an action and a reward. SAME_STEP: the
        reset happens in the last step; the last observation is in `info["final_obs"]`. DISABLED: by
        `reset(options={"reset_mask": mask})`.
    """

    changes = ("rows", "_begun", "_over")

    def __init__(self, rows: Rows, autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP) -> None:
        self.rows, self.num_envs = rows, rows.num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": 10, "autoreset_mode": self.autoreset_mode}
        self.render_mode = "rgb_array" if self.core.draws else None
        self.single_observation_space, self.single_action_space = rows.observation_space, rows.action_space
        self.observation_space = batch_space(rows.observation_space, self.num_envs)
        self.action_space = batch_space(rows.action_space, self.num_envs)
        self._begun = np.zeros(self.num_envs, dtype=np.bool_)
        self._over = np.ones(self.num_envs, dtype=np.bool_)
        self._seeds: list[int | None] = [None] * self.num_envs

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, Arrays]:
        """Begin an episode in every environment, or in those of `options={"reset_mask": mask}`.

        `seed` is one of the first environment, the others have the following ones, or one for each. With
        `options={"scene": "keep"}` scenes stay.
        """
        if self.closed:
            raise RuntimeError("the environments are closed: make them again")
        reset_options = dict(options or {})
        everybody = np.ones(self.num_envs, dtype=np.bool_)
        selected = _mask(reset_options.pop("reset_mask"), self._begun) if "reset_mask" in reset_options else everybody
        self._reset_rows(selected, _seeds_of(seed, self.num_envs), reset_options)
        return self._observe()

    def step(self, actions: NDArray[Any]) -> tuple[Arrays, FloatArray, BoolArray, BoolArray, Arrays]:
        """Step every environment."""
        command = self._command(actions)
        over = self._over.copy()
        if over.any():
            if self.autoreset_mode != AutoresetMode.NEXT_STEP:
                numbers = np.flatnonzero(over)[:5].tolist()
                raise RuntimeError(f"the episodes of environments {numbers} are over: reset them")
            self._reset_rows(over)
        rewards, terminated, truncated = self.rows.step(command, ~over)
        self._over = terminated | truncated
        if self.autoreset_mode != AutoresetMode.SAME_STEP or not self._over.any():
            observation, info = self._observe()
            return observation, rewards, terminated, truncated, info
        last, ended = self._observe(), self._over.copy()
        self._reset_rows(ended)
        observation, info = self._observe()
        info["final_obs"], info["_final_obs"] = _singles(last[0], ended), ended
        info["final_info"] = {**last[1], **{name: ended for name in last[1] if name.startswith("_")}}
        info["_final_info"] = ended
        return observation, rewards, terminated, truncated, info

    def advance(
        self, actions: NDArray[Any], going: BoolArray
    ) -> tuple[Arrays, FloatArray, BoolArray, BoolArray, Arrays]:
        """Step those environments (num_envs,) that are `going`; the others stay as they are, and none is reset."""
        if np.shape(going) != (self.num_envs,) or np.asarray(going).dtype != np.bool_:
            raise ValueError(f"going must be ({self.num_envs},) bool, got {going!r}")
        rewards, terminated, truncated = self.rows.step(self._command(actions), going & ~self._over)
        self._over |= terminated | truncated
        observation, info = self._observe()
        return observation, rewards, terminated, truncated, info

    def render(self) -> Sequence[NDArray[np.uint8]] | None:  # type: ignore[override]
        """Pictures of the environments, (H, W, 3) uint8 each, which are drawn when they are asked for one by one.

        `gymnasium.wrappers.vector.RecordVideo` films the first environment, and draws no other.
        """
        if self.render_mode is None:
            gym.logger.warn("render() needs a render_mode: make the environments with render_mode='rgb_array'")
            return None
        return _PicturesOfRows(self.core)

    def close_extras(self, **arguments: Any) -> None:
        """Stop threads and engines."""
        rows = getattr(self, "rows", None)  # Gymnasium closes what could not be made, too
        if rows is not None:
            rows.close()

    @property
    def filters(self) -> Any:
        """The filters in the loop."""
        try:
            return self.rows.get_attr("beliefs").filters
        except AttributeError:
            raise RuntimeError("there is no filter in the loop: give belief={}") from None

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:  # type: ignore[override]
        """Seed of the last seeded reset of each environment, as `SyncVectorEnv` has them."""
        return tuple(self._seeds)

    @property
    def max_episode_steps(self) -> int | None:
        """The time limit; None: there is none."""
        try:
            return int(self.rows.get_attr("max_episode_steps"))
        except AttributeError:
            return None

    @property
    def core(self) -> CoreRows:
        """The simulator behind the environments."""
        world = self.rows.world
        assert isinstance(world, CoreRows)
        return world

    @property
    def options(self) -> StereoOptions:
        """Arguments of the environments."""
        return self.core.options

    @property
    def outcome(self) -> Sensed:
        """Measurements of the last frame in full precision; do not change them."""
        return self.core.simulator.sensed

    @property
    def nbytes(self) -> int:
        """Memory of the state of all environments, without the filters."""
        return self.core.simulator.nbytes

    def _reset_rows(self, chosen: BoolArray, seeds: Sequence[int | None] = (), options: Mapping[str, Any] = {}) -> None:
        seeds = seeds or [None] * self.num_envs
        self.rows.reset(chosen, seeds, options)
        for b in np.flatnonzero(chosen).tolist():
            self._seeds[b] = self._seeds[b] if seeds[b] is None else seeds[b]
        self._begun |= chosen
        self._over[chosen] = False

    def _observe(self) -> tuple[Arrays, Arrays]:
        """Observation and info; `_key` says whose rows are valid, which all are."""
        observation, info = self.rows.observe()
        everybody = np.ones(self.num_envs, dtype=np.bool_)
        return observation, {**info, **{f"_{key}": everybody for key in info}}

    def _command(self, actions: Any) -> Any:
        """The actions (B, ...), checked."""
        if self.closed:
            raise RuntimeError("the environments are closed: make them again")
        if not self._begun.all():
            raise RuntimeError("reset the environments before the first step")
        return checked_actions("actions", actions, self.single_action_space, self.num_envs)


class TimeLimit(RowsWrapper):
    """Rows whose episodes are truncated after so many steps."""

    def __init__(self, env: Any, max_episode_steps: int) -> None:
        super().__init__(env)
        self.max_episode_steps = max_episode_steps
        self._steps = np.zeros(self.num_envs, dtype=np.int64)

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        self.rows.reset(chosen, seeds, options)
        self._steps[chosen] = 0

    def step(self, actions: Any, going: BoolArray) -> Step:
        rewards, terminated, truncated = self.rows.step(actions, going)
        self._steps[going] += 1
        return rewards, terminated, truncated | (going & (self._steps >= self.max_episode_steps))


def limited(rows: Rows, most: int | None) -> Rows:
    """The rows with a time limit, as `gymnasium.make` has it: None and -1 are none."""
    return rows if most is None or most == -1 else TimeLimit(rows, whole_number("max_episode_steps", most, 1))


def core_rows(
    kind: type[StereoOptions],
    options: Mapping[str, Any],
    *,
    num_envs: int,
    scenes: int | None = None,
    threads: int = 1,
    render_mode: str | None = None,
) -> CoreRows:
    """Rows of environments with these arguments.

    Raises
    ------
    TypeError
        There is no argument of that name.
    ValueError
        An argument is impossible, or only single environments have it.
    """
    world_options = dict(options)
    mode = world_options.pop("render_mode", render_mode)
    if mode not in (None, "rgb_array"):
        raise ValueError(
            f"render_mode must be None or 'rgb_array' in a native vector environment, got {mode!r}: "
            "use vectorization_mode='sync'"
        )
    checked = kind.checked(world_options)
    for name, value in {"sensor": "landmarks", "render_images": False}.items():
        if getattr(checked, name) != value:
            raise ValueError(
                f"{name} must be {value!r} in a native vector environment, got {getattr(checked, name)!r}: "
                "use make_vec(..., vectorization_mode='async') for a process each"
            )
    pool = None if scenes is None else whole_number("scenes", scenes, 1)
    count = whole_number("num_envs", num_envs, 1)
    return CoreRows(checked, count, threads=whole_number("threads", threads, 1), pool=pool, draws=mode is not None)


class _PicturesOfRows(Sequence[NDArray[np.uint8]]):
    """Pictures of the frame of now."""

    def __init__(self, rows: CoreRows) -> None:
        self._rows = rows

    def __len__(self) -> int:
        return self._rows.num_envs

    def __getitem__(self, b: Any) -> Any:
        return self._rows.picture(range(len(self))[b])


def _mask(given: Any, begun: BoolArray) -> BoolArray:
    """Environments to be reset; `begun` (B,) says which have been reset before."""
    mask = np.asarray(given)
    if mask.shape != begun.shape or mask.dtype != np.bool_ or not mask.any():
        raise ValueError(f"reset_mask must be ({len(begun)},) bool with at least one True, got {mask!r}")
    if not (mask | begun).all():
        raise ValueError("reset_mask must be all True in the first reset")
    return mask


def _seeds_of(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """A seed for each environment: one counts up from the first of them on."""
    each: list[int | None]
    try:
        if seed is None:
            each = [None] * count
        elif isinstance(seed, (Sequence, np.ndarray)):
            each = [None if value is None else index(value) for value in seed]
        else:
            each = [index(seed) + b for b in range(count)]
    except TypeError:
        each = []
    if len(each) != count:
        raise ValueError(f"seed must be a whole number or {count} of them, got {seed!r}")
    return each


def _singles(observation: Any, which: BoolArray) -> NDArray[Any]:
    """Observations of single environments, None where they are not asked for; (B,) objects."""
    rows = np.full(len(which), None, dtype=object)
    for b in np.flatnonzero(which).tolist():
        rows[b] = deepcopy(row_of(observation, b))
    return rows
