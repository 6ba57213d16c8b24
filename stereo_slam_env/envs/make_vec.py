"""`gymnasium.make_vec` with a filter in the loop, and snapshots of environments and vectors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from gymnasium.vector import AutoresetMode

from stereo_slam_env.envs.arguments import DriveGazeOptions, DriveOptions, GazeOptions, StereoOptions
from stereo_slam_env.envs.belief_observation import BeliefObservation
from stereo_slam_env.envs.belief_panorama import BeliefPanorama
from stereo_slam_env.envs.rewards import InformationGain, TrueError
from stereo_slam_env.envs.row_wrapper import DirectionOfGaze, SelectedKeys
from stereo_slam_env.envs.rows import put_state, state_of
from stereo_slam_env.envs.vector_env import RowsVectorEnv, core_rows, limited

KINDS: Mapping[str, type[StereoOptions]] = {
    "StereoSlam/Drive-v0": DriveOptions,
    "StereoSlam/Gaze-v0": GazeOptions,
    "StereoSlam/DriveGaze-v0": DriveGazeOptions,
}
"""Options of the worlds by id."""


def kind_of(name: str) -> type[StereoOptions]:
    """Options of the environments with an id; a `ValueError` where it is no world."""
    if name not in KINDS:
        raise ValueError(f"environment must be one of {', '.join(map(repr, KINDS))}, got {name!r}")
    return KINDS[name]


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
        Take the scenes of the episodes from a pool of so many, each of which makes place for a new one after ten
        episodes: for learning, where building scenes takes most of the time. None: every episode has a scene of its
        own, as in a single environment.
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
    rows = limited(
        core_rows(kind_of(name), options, num_envs=num_envs, scenes=scenes, threads=threads), max_episode_steps
    )
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


drive_vector, gaze_vector, drive_gaze_vector = (partial(stereo_vector, name) for name in KINDS)


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
