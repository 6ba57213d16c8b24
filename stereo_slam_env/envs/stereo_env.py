"""One environment: a row of the simulator with pictures, a window, and the interface of Gymnasium."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, cast

import gymnasium as gym
import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from filters.contract.inputs import Start
from filters.contract.noise import StereoNoise
from filters.contract.validation import finite_array
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from stereo_slam_env.envs.arguments import StereoOptions
from stereo_slam_env.envs.core_rows import CoreRows, keeps_scene
from stereo_slam_env.envs.row_pictures import modes_here, window_for
from stereo_slam_env.envs.rows import Rows, checked_actions
from stereo_slam_env.frontend.tracks import TrackedPair
from stereo_slam_env.recording.recording import Frame, LandmarkTruth
from stereo_slam_env.simulator.state import Kept
from stereo_slam_env.world.routes import Route
from stereo_slam_env.world.vehicle import Head

Observation = dict[str, Any]
_ALL = np.ones(1, dtype=np.bool_)


def row_of(arrays: Any, b: int) -> Any:
    """Part that belongs to row b, of each key where there are keys."""
    if isinstance(arrays, dict):
        return {key: row_of(value, b) for key, value in arrays.items()}
    value = arrays[b]
    # Gymnasium's vectors gather Python's bool in an array of bool, but NumPy's in an array of objects.
    return bool(value) if isinstance(value, np.bool_) else value


class StereoEnv(gym.Env[Observation, NDArray[np.float32]], EzPickle, Kept):
    """A car with a stereo camera; subclasses give their `Options`, which say what the agent moves."""

    changes = ("rows", "_begun", "_over")
    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 10}  # noqa: RUF012 (Gymnasium's contract)
    Options: ClassVar[type[StereoOptions]]

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        EzPickle.__init__(self, render_mode=render_mode, **options)
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode must be None, 'rgb_array' or 'human', got {render_mode!r}")
        self.render_mode = render_mode
        self.metadata = modes_here(self.metadata)
        self._window = window_for(render_mode, self.metadata["render_fps"])
        self.rows = self._made(options, draws=render_mode is not None)
        core = self.rows.world
        assert isinstance(core, CoreRows)
        self._core, self.options = core, cast("Any", core.options)
        self.observation_space, self.action_space = self.rows.observation_space, self.rows.action_space
        self._frame: Frame | None = None
        self._begun, self._over, self._closed = False, True, False

    def _made(self, options: Mapping[str, Any], draws: bool) -> Rows:
        return CoreRows(self.Options.checked(options), 1, draws=draws)

    def __getattr__(self, name: str) -> Any:
        rows = self.__dict__.get("rows")
        while rows is not None:
            if name in getattr(rows, "shared", ()):
                return getattr(rows, name)
            rows = getattr(rows, "rows", None)
        raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")

    @property
    def world_id(self) -> str:
        """Id of the world that the car drives in."""
        return self.spec.id if self.spec else "StereoSlam/Drive-v0"

    @property
    def camera(self) -> StereoCamera:
        """Stereo camera of the rig."""
        return self._core.camera

    @property
    def head(self) -> Head | None:
        """Head that carries the cameras; None: they are fixed to the car."""
        return self._core.head

    @property
    def noise(self) -> StereoNoise:
        """Covariance to assume of a measurement that does not come with its own."""
        return self._core.noise

    @property
    def route(self) -> Route:
        """Nominal drive of the episode, without errors."""
        return self._core.route

    def reroute(self, route: Route) -> None:
        """Let the script follow another route from now on, whose steps are the same up to this frame."""
        self._core.reroute(0, route)

    @property
    def frame(self) -> Frame:
        """The current frame in full precision: observation, odometry, truth."""
        if not self._begun:
            raise RuntimeError("there is no frame yet: reset the environment first")
        if self._frame is None:
            self._frame = self._core.frame(0)
        return self._frame

    @property
    def start(self) -> Start:
        """Start of a filter, before the first frame."""
        return self._core.start(0) if self._begun else Start()

    @property
    def head_angles(self) -> FloatArray:
        """Pan and tilt of the head now, rad; (2,)."""
        angles: FloatArray = self._core.simulator.fleet.angles[0].copy()
        return angles

    @property
    def body(self) -> Pose:
        """Pose of the left camera if the head looked straight ahead: the drive without the gaze."""
        return self._core.body(0)

    def landmark_truth(self) -> LandmarkTruth:
        """All landmarks of the scene, in W; with the sensor "images" those found so far."""
        if not self._begun:
            raise RuntimeError("there are no landmarks yet: reset the environment first")
        return self._core.landmark_truth(0)

    @property
    def tracked(self) -> TrackedPair:
        """Tracks of the front end in the current frame, with the sensor "images"."""
        tracked = self._core.image_sensor(0).tracked
        assert tracked is not None
        return tracked

    @property
    def moving_ids(self) -> IntArray:
        """Ids that the front end gave to corners of moving bodies so far, with the sensor "images"; ascending."""
        return self._core.image_sensor(0).moving_ids

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go back to a state, see `stereo_slam_env.envs.restore`."""
        super().restore(state)
        self._frame = None
        generator = self._core.generators[0]
        if generator is not None:
            self.np_random = generator

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Build a new scene, unless `options={"scene": "keep"}`, and put the car at the beginning of the route."""
        keeps_scene(options or {})  # refused before anything changes
        super().reset(seed=seed)
        self._core.generators[0] = self.np_random
        self.rows.reset(_ALL, [None], options or {})
        self._begun, self._over, self._closed = True, False, False
        return self._look()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for 0.1 s and measure."""
        if self._over:
            what = "the environment is closed: reset opens it again" if self._closed else "the episode is over"
            raise RuntimeError(f"{what}: call reset before the next step")
        space = self.action_space
        if isinstance(space, gym.spaces.Box):
            actions = np.clip(finite_array("action", action, space.shape), -1.0, 1.0)[None]
        else:
            actions = checked_actions("action", np.asarray(action)[None], space, 1)
        rewards, terminated, truncated = self.rows.step(actions, _ALL)
        self._over = bool(terminated[0])
        observation, info = self._look()
        return observation, float(rewards[0]), self._over, bool(truncated[0]), info

    def render(self) -> NDArray[np.uint8] | None:
        """Both views with the observed landmarks, (H, W, 3) uint8; with "human" they are in the window already."""
        if self.render_mode is None:
            gym.logger.warn("render() needs a render_mode: make the environment with render_mode='rgb_array'")
            return None
        return self._core.picture(0) if self._window is None else None

    def close(self) -> None:
        """Stop the physics engine; may be called at any time, also twice."""
        self.rows.close()
        if self._window is not None:
            self._window.close()
        self._over = self._closed = True

    def _look(self) -> tuple[Observation, dict[str, Any]]:
        self._frame = None
        if self._window is not None:
            self._window.show(self._core.picture(0))
        observation, info = self.rows.observe()
        return row_of(observation, 0), row_of(info, 0)
