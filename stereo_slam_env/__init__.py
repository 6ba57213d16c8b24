"""A simulated world with a stereo camera, and the evaluation of stereo SLAM filters in it.

Importing this package registers the Gymnasium environments.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium as _gym

if TYPE_CHECKING:
    from stereo_slam_env.envs.drive import StereoDriveEnv
    from stereo_slam_env.sensing.padding import stereo_observation

__all__ = ["StereoDriveEnv", "stereo_observation"]


def _register(name: str, entry_point: str, max_episode_steps: int) -> None:
    if name not in _gym.registry:
        _gym.register(name, entry_point=entry_point, max_episode_steps=max_episode_steps)


_register("StereoSlam/Drive-v0", "stereo_slam_env.envs.drive:StereoDriveEnv", 3000)


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for: the physics engine and scipy take their time."""
    if name == "StereoDriveEnv":
        from stereo_slam_env.envs.drive import StereoDriveEnv

        return StereoDriveEnv
    if name == "stereo_observation":
        from stereo_slam_env.sensing.padding import stereo_observation

        return stereo_observation
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
