"""A simulated world with a stereo camera, and the evaluation of stereo SLAM filters in it.

Importing this package registers the Gymnasium environments. `__init__.pyi` lists the public names; each is imported
when it is first used. The rooms that users work in have public names of their own: `stereo_slam_env.envs`,
`.policies`, `.frontend`, `.datasets`, `.world`, `.sensing`, `.rendering`, `.evaluation`, `.benchmark`,
`.viewer`.
"""

from __future__ import annotations

from importlib.util import find_spec as _find_spec
from pathlib import Path as _Path
from typing import Any as _Any

import gymnasium as _gym
import lazy_loader as _lazy_loader


def _refuse_other_filters() -> None:
    """Raise an `ImportError` where `filters` is not the package that comes with this one, without importing it."""
    ours = (_Path(__file__).parent.parent / "filters" / "__init__.py").resolve()
    spec = _find_spec("filters")
    place = (spec.origin or next(iter(spec.submodule_search_locations or ()), None)) if spec else None
    # A package of that name that was installed after ours has overwritten it in the same place.
    if place is None or _Path(place).resolve() != ours or b"Stereo EKF-SLAM filters" not in ours.read_bytes():
        raise ImportError(
            f"stereo_slam_env needs its own package filters, but Python finds {place or 'none'}: rename that or run "
            "from another folder; if pip installed it, pip uninstall filters and install stereo-slam-env again"
        )


_refuse_other_filters()


def _register(
    name: str, module: str, made: str, max_episode_steps: int, best: float | None = None, **arguments: object
) -> None:
    """An id: one environment, and its vector by the name in small letters; `best` is the best mean return known."""
    if name in _gym.registry:
        return
    vectors = "make_vec" if made.startswith("Stereo") else module  # a task makes its own
    task = name.split("/")[1].split("-")[0]
    small = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in task).strip("_")
    _gym.register(
        name,
        entry_point=f"stereo_slam_env.envs.{module}:{made}",
        max_episode_steps=max_episode_steps,
        reward_threshold=best,
        vector_entry_point=f"stereo_slam_env.envs.{vectors}:{small}_vector",
        kwargs=arguments,
    )


_register("StereoSlam/Drive-v0", "drive", "StereoDriveEnv", 1200, 32.2)
_register("StereoSlam/Gaze-v0", "gaze", "StereoGazeEnv", 3000)
_register("StereoSlam/DriveGaze-v0", "drive_gaze", "StereoDriveGazeEnv", 1200)
for _task, _module, _most, _best in (
    ("ActiveGaze", "active_gaze", 600, -1.51),
    ("Explore", "explore", 1200, 6.15),
    ("Revisit", "revisit", 100, 8.29),
    ("ClosedLoop", "closed_loop", 1200, 20.9),
    ("Branches", "branches", 1000, 31.4),
    ("Follow", "follow", 200, 18.75),
):
    _register(f"StereoSlam/{_task}-v0", _module, _task, _most, _best)
    for _level in ("easy", "hard"):
        _register(f"StereoSlam/{_task}-{_level}-v0", _module, _task, _most, level=_level)

_load, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> _Any:
    try:
        return _load(name)
    except ModuleNotFoundError as error:
        from filters.contract.extras import explained

        raise explained(error) from None
