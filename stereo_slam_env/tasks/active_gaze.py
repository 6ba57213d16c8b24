"""`StereoSlam/ActiveGaze-v0`: decide where to look."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from stereo_slam_env.policies.gaze_task import GazeTask
from stereo_slam_env.tasks.levels import of_level, of_world
from stereo_slam_env.wrappers.vectors import vector_of


def active_gaze(
    render_mode: str | None = None,
    *,
    level: str = "normal",
    arguments: Mapping[str, Any] | None = None,
    many: Mapping[str, Any] | None = None,
    **task: Any,
) -> Any:
    """`StereoSlam/ActiveGaze-v0`: decide where to look so that the estimate of the pose is as true as it can be.

    The head of `StereoSlam/Gaze-v0` is turned to one of nine directions (`Discrete(9)`, from the farthest left to the
    farthest right), for five steps. The observation has `belief_sigmas` (6,), `head` (2,) and `panorama` (12, 6), the
    landmarks of the filter's map around the car, see `BeliefPanorama`; the reward is minus the squared true error of
    the position after the decision (`TrueError`), or with `reward="information"` the decrease of the log determinant of
    the covariance of the pose (`InformationGain`). `info` is that of `StereoSlam/Gaze-v0` and of these
    wrappers.

    Parameters
    ----------
    render_mode : str, optional
        That of `StereoSlam/Gaze-v0`.
    level : {"easy", "normal", "hard"}
        Difficulty, see `LEVELS`.
    arguments : mapping, optional
        Of `StereoSlam/Gaze-v0`; JSON-able.
    many : mapping, optional
        Arguments of `GazeTask.make_rows`: that many in rows, instead of one environment.
    **task
        Others of `GazeTask`: `filter`, `filter_options`, `reward`, `criterion`, `belief`, `nees_gate`, `resolution`,
        `hold`, `pans`; and arguments of `StereoSlam/Gaze-v0`, as in `arguments`. JSON-able.

    Raises
    ------
    TypeError
        There is no argument of that name.
    """
    bare = {"render_mode": render_mode, "max_episode_steps": -1, "disable_env_checker": True}  # the task has its own
    gaze = gaze_task(level, arguments, **task)
    gaze = replace(gaze, arguments={**bare, **gaze.arguments})
    return gaze.make_for_learning() if many is None else gaze.make_rows(**many)


def gaze_task(level: str = "normal", arguments: Mapping[str, Any] | None = None, **task: Any) -> GazeTask:
    """The task of `active_gaze`, with its arguments."""
    own = {name: task.pop(name) for name in [field.name for field in fields(GazeTask)] if name in task}
    return GazeTask(arguments={**of_level(level, scripted=True), **of_world(arguments, task)}, **own)


active_gaze_vector = vector_of(active_gaze)
