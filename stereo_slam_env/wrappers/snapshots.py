"""Snapshots: the state of an environment or a vector, with the wrappers around it, as a copy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stereo_slam_env.envs.rows import put_state, state_of


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
        told = getattr(env, "arguments", None) or getattr(env, "options", "")
        rows = getattr(env, "rows", None)
        names.append(f"{type(env).__name__}({told}{_rows_named(rows) if hasattr(env, 'num_envs') else ''})")
        if not hasattr(env, "env"):
            return " of ".join(names)
        env = env.env


def _rows_named(rows: Any) -> str:
    """Rows and what is around them."""
    around = ""
    while hasattr(rows, "rows"):
        around, rows = f"{around}, {type(rows).__name__}", rows.rows
    return f"{around}, {getattr(rows, 'count', '')} rows"
