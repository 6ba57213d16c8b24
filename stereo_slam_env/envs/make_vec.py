"""`gymnasium.make_vec` with a filter in the loop, levels of difficulty, and snapshots of environments and vectors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import gymnasium as gym
from gymnasium.vector import AutoresetMode

from filters.contract.validation import one_of
from stereo_slam_env.envs.arguments import STEERING, DriveGazeOptions, DriveOptions, GazeOptions, StereoOptions
from stereo_slam_env.envs.belief_observation import BeliefObservation
from stereo_slam_env.envs.belief_panorama import BeliefPanorama
from stereo_slam_env.envs.rewards import InformationGain, TrueError
from stereo_slam_env.envs.row_wrapper import DirectionOfGaze, SelectedKeys
from stereo_slam_env.envs.rows import Rows, put_state, state_of
from stereo_slam_env.envs.vector_env import RowsVectorEnv, core_rows, limited

_KINDS: Mapping[str, type[StereoOptions]] = {
    "StereoSlam/Drive-v0": DriveOptions,
    "StereoSlam/Gaze-v0": GazeOptions,
    "StereoSlam/DriveGaze-v0": DriveGazeOptions,
}


def rows_of(name: str, num_envs: int, options: Mapping[str, Any], **how: Any) -> Rows:
    """Rows of the environments with an id; `how` is `scenes` and `threads`, see `stereo_vector`."""
    if name not in _KINDS:
        raise ValueError(f"environment must be one of {', '.join(map(repr, _KINDS))}, got {name!r}")
    return core_rows(_KINDS[name], num_envs, options, **how)


def stereo_vector(
    name: str,
    num_envs: int = 1,
    max_episode_steps: int | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    scenes: int | None = None,
    threads: int = 1,
    belief: Mapping[str, Any] | None = None,
    panorama: Mapping[str, Any] | None = None,
    information: Mapping[str, Any] | None = None,
    error: Mapping[str, Any] | None = None,
    keys: Sequence[str] | None = None,
    observation: Literal["dict", "flat"] = "dict",
    pans: int | None = None,
    **options: Any,
) -> RowsVectorEnv:
    """Many environments with an id, and what wrappers do for a single one as arguments.

    Parameters
    ----------
    name : str
        The id.
    num_envs : int
        Number of environments.
    max_episode_steps : int, optional
        Truncate episodes after so many frames; None or -1: never.
    autoreset_mode : AutoresetMode
        See `RowsVectorEnv`.
    scenes : int, optional
        Take the scenes of all episodes from a pool of so many, which each reset with a seed builds anew. None: every
        episode has a scene of its own, as in a single environment.
    threads : int
        Threads over which the environments are spread; results do not depend on it.
    belief : mapping, optional
        A filter in the loop of each environment: arguments of `BeliefObservation`.
    panorama, information, error : mapping, optional
        Arguments of `BeliefPanorama`, of `InformationGain`, of the pose unless it says otherwise, and of `TrueError`.
    keys : sequence of str, optional
        The keys of the observation; None: all. What is not asked for is not computed.
    observation : {"dict", "flat"}
        "flat": one Box of these keys, see `SelectedKeys`.
    pans : int, optional
        The action is the number of one of so many directions, see `DirectionOfGaze`.
    **options
        Of the single environment; `sensor` must be "landmarks", without images. `render_mode` is None or "rgb_array".

    Raises
    ------
    TypeError
        There is no argument of that name.
    ValueError
        An argument is impossible.
    """
    if belief is None and not (panorama is information is error is None):
        raise ValueError("panorama, information and error need a filter in the loop: give belief={}")
    rows = limited(rows_of(name, num_envs, options, scenes=scenes, threads=threads), max_episode_steps)
    if belief is not None:
        rows = BeliefObservation(rows, **belief)
    if panorama is not None:
        rows = BeliefPanorama(rows, **panorama)
    if information is not None:
        rows = InformationGain(rows, **{"of": "pose", **information})
    if error is not None:
        rows = TrueError(rows, **error)
    if pans is not None:
        rows = DirectionOfGaze(rows, pans=pans)
    if keys is not None or observation != "dict":
        rows = SelectedKeys(rows, keys=list(rows.observation_space) if keys is None else keys, observation=observation)
    return RowsVectorEnv(rows, autoreset_mode)


def drive_vector(**arguments: Any) -> RowsVectorEnv:
    """Many `StereoSlam/Drive-v0`, see `stereo_vector`."""
    environments = stereo_vector("StereoSlam/Drive-v0", **arguments)
    environments.metadata["training"] = {
        **STEERING,
        "decisions": 262_144,
        "arguments": {"keys": ["car", "progress", "route"]},
    }
    return environments


def gaze_vector(**arguments: Any) -> RowsVectorEnv:
    """Many `StereoSlam/Gaze-v0`, see `stereo_vector`."""
    return stereo_vector("StereoSlam/Gaze-v0", **arguments)


def drive_gaze_vector(**arguments: Any) -> RowsVectorEnv:
    """Many `StereoSlam/DriveGaze-v0`, see `stereo_vector`."""
    return stereo_vector("StereoSlam/DriveGaze-v0", **arguments)


def vector_of(task: Callable[..., Any]) -> Callable[..., RowsVectorEnv]:
    """Entry of `make_vec` for a task: a function that makes one environment, or rows where it is given `many`.

    `num_envs`, `autoreset_mode`, `scenes` and `threads` are those of `stereo_vector`, `max_episode_steps` counts the
    steps of the task; other arguments are the task's.
    """

    def vector(
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        scenes: int | None = None,
        threads: int = 1,
        **arguments: Any,
    ) -> RowsVectorEnv:
        many = {"num_envs": num_envs, "scenes": scenes, "threads": threads}
        rows = limited(task(many=many, **arguments), max_episode_steps)
        return RowsVectorEnv(rows, autoreset_mode)

    return vector


@dataclass(frozen=True, eq=False)
class Snapshot:
    """State of an environment at an instant; it can be pickled, and stays as it is whatever the environment does."""

    of: str
    """What it is the state of: the wrappers and the environment, with their arguments."""
    state: tuple[Any, ...]
    """Layer by layer, the outermost first."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Snapshot:
        return self  # nobody changes it


def snapshot(env: Any) -> Snapshot:
    """The state of an environment, or of a native vector, with all wrappers around it.

    Filters in the loop, random generators and time limits are part of it. Scenes are shared, all else is copied.

    Parameters
    ----------
    env : gymnasium.Env or gymnasium.vector.VectorEnv
        An environment `StereoSlam/...`, in wrappers of this package and of others.

    Raises
    ------
    ValueError
        The environment inside is none of this package.
    """
    return Snapshot(_named(env), state_of(env))


def restore(env: Any, snapshot: Snapshot) -> None:
    """Let an environment go on from where it was: the same actions give the same bits again.

    Parameters
    ----------
    env : gymnasium.Env or gymnasium.vector.VectorEnv
        That of the snapshot, or another one made and wrapped in the same way, in whatever process.
    snapshot : Snapshot
        It may be used again.

    Raises
    ------
    ValueError
        The environment is another one.
    """
    if _named(env) != snapshot.of:
        raise ValueError(f"snapshot must be one of this environment, {_named(env)}, got one of {snapshot.of}")
    put_state(env, snapshot.state)


def _named(env: Any) -> str:
    """Wrappers and environment with their arguments."""
    names = []
    while True:
        description = getattr(env, "arguments", None) or getattr(env, "options", "")
        rows = getattr(env, "rows", None)
        names.append(f"{type(env).__name__}({description}{_rows_named(rows) if hasattr(env, 'num_envs') else ''})")
        if not hasattr(env, "env"):
            return " of ".join(names)
        env = env.env


def _rows_named(rows: Any) -> str:
    """Rows and what is around them."""
    around = ""
    while hasattr(rows, "rows"):
        around, rows = f"{around}, {type(rows).__name__}", rows.rows
    return f"{around}, {getattr(rows, 'count', '')} rows"


LEVELS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "easy": {"sigma": 0.5, "odometry_sigma_linear": 0.05, "odometry_sigma_angular": 0.005},
        "normal": {},
        "hard": {
            "sigma": 1.25,
            "odometry_sigma_linear": 0.2,
            "odometry_sigma_angular": 0.02,
            "visibility": 25.0,
            "moving_cars": 4,
            "pedestrians": 4,
            "randomise": True,
        },
    }
)
"""Arguments of the environment at each level: noise, fog, traffic, textures and light. "normal": those of the task."""
WORLDS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "white": {"sigma": 1.0},
        "lasting": {"sigma": 0.714, "lasting": 0.7, "lasting_time": 2.0},
        "front-end": {"sigma": 0.036, "lasting": 0.114, "lasting_time": 1.7},
    }
)
"""Arguments of environments whose landmarks have errors of one kind: white; with the same R, half of it lasting; as the
front end has them in rendered images (a standard deviation of 0.12 px, correlations of 0.86 after one frame and 0.68
after five, see the page on the front end)."""
_TRAFFIC = ("moving_cars", "pedestrians")


def of_level(level: str, *, scripted: bool) -> Mapping[str, Any]:
    """Arguments of the environment at a level of `LEVELS`; without traffic where no script drives.

    Traffic keeps time with the script, and an agent that drives is not shown it, so it would be hit without a fault of
    its own. In scripted drives it hides landmarks.
    """
    one_of("level", level, LEVELS)
    return {key: value for key, value in LEVELS[level].items() if scripted or key not in _TRAFFIC}


def of_world(arguments: Mapping[str, Any] | None, others: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of the environment inside a task, from the mapping of that name and those given beside it."""
    world_arguments = {} if arguments is None else arguments
    if not isinstance(world_arguments, Mapping):
        raise ValueError(f"arguments must be a mapping of arguments of the environment, got {world_arguments!r}")
    if twice := sorted(world_arguments.keys() & others.keys()):
        raise ValueError(f"{twice[0]} is given twice, in arguments and beside it: leave one of them out")
    return {**world_arguments, **others}


def arguments_of(wrapper: Any, given: dict[str, Any]) -> dict[str, Any]:
    """Arguments of a wrapper, taken out of those that are given to a task."""
    return {name: given.pop(name) for name in wrapper.__signature__.parameters if name in given}


def inner_environment(
    name: str,
    level: str,
    given: Mapping[str, Any],
    many: Mapping[str, Any] | None,
    filter: str,
    filter_options: Mapping[str, Any] | None,
    **own: Any,
) -> Any:
    """The environment `name` inside a task, with a filter in the loop and a panorama of its belief.

    Its arguments are those of the task (`own`), of the level, and those given; the last ones win. Rows of such where
    `many` has their number, see `rows_of`.
    """
    arguments = {**own, **of_level(level, scripted=name == "StereoSlam/Gaze-v0"), **given}
    inside: Any
    if many is None:
        inside = gym.make(name, max_episode_steps=-1, disable_env_checker=True, **arguments)
    else:
        inside = rows_of(name, options=arguments, **many)
    return BeliefPanorama(BeliefObservation(inside, filter=filter, options=filter_options))
