"""`gymnasium.make_vec` for the environments: rows with a filter in the loop, if one is asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gymnasium.vector import AutoresetMode

from stereo_slam_env.envs.how_to_learn import STEERING
from stereo_slam_env.envs.options import DriveGazeOptions, DriveOptions, GazeOptions, StereoOptions
from stereo_slam_env.envs.rows import Rows
from stereo_slam_env.envs.vector_env import RowsVectorEnv, core_rows, limited
from stereo_slam_env.wrappers.belief_observation import BeliefObservation
from stereo_slam_env.wrappers.belief_panorama import BeliefPanorama
from stereo_slam_env.wrappers.direction_of_gaze import DirectionOfGaze
from stereo_slam_env.wrappers.rewards import InformationGain, TrueError
from stereo_slam_env.wrappers.selected_keys import SelectedKeys

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
        rows = BeliefObservation.around(rows, **belief)
    if panorama is not None:
        rows = BeliefPanorama.around(rows, **panorama)
    if information is not None:
        rows = InformationGain.around(rows, **{"of": "pose", **information})
    if error is not None:
        rows = TrueError.around(rows, **error)
    if pans is not None:
        rows = DirectionOfGaze.around(rows, pans=pans)
    if keys is not None:
        rows = SelectedKeys.around(rows, keys=keys)
    return RowsVectorEnv(rows, autoreset_mode)


def drive_vector(**arguments: Any) -> RowsVectorEnv:
    """Many `StereoSlam/Drive-v0`, see `stereo_vector`."""
    made = stereo_vector("StereoSlam/Drive-v0", **arguments)
    made.metadata["training"] = {**STEERING, "decisions": 262_144, "arguments": {"keys": ["car", "progress", "route"]}}
    return made


def gaze_vector(**arguments: Any) -> RowsVectorEnv:
    """Many `StereoSlam/Gaze-v0`, see `stereo_vector`."""
    return stereo_vector("StereoSlam/Gaze-v0", **arguments)


def drive_gaze_vector(**arguments: Any) -> RowsVectorEnv:
    """Many `StereoSlam/DriveGaze-v0`, see `stereo_vector`."""
    return stereo_vector("StereoSlam/DriveGaze-v0", **arguments)


def vector_of(task: Callable[..., Any]) -> Callable[..., RowsVectorEnv]:
    """What `make_vec` calls for a task: a function that makes one environment, or rows where it is given `many`.

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
