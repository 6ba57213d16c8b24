"""`gym.make_vec("StereoSlam/...")`: many environments with the landmark sensor in arrays, stepped by compiled kernels."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from operator import index
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from filters.start import Start
from filters.validation import BoolArray, FloatArray, IntArray, finite_array, whole_number
from stereo_slam_env.envs.drive import StereoDriveEnv
from stereo_slam_env.envs.drive_gaze import StereoDriveGazeEnv
from stereo_slam_env.envs.gaze import StereoGazeEnv
from stereo_slam_env.envs.options import StereoOptions
from stereo_slam_env.envs.stereo_env import ARENA, MAX_VELOCITY, START_SIGMAS, StereoEnv, route_ahead
from stereo_slam_env.sensing.pixel_noise import NOISE_MODELS
from stereo_slam_env.vector.frame import FIRST, STEP, WAIT, run_frame
from stereo_slam_env.vector.scenes import SceneArrays, put_scene, scene_arrays, with_room
from stereo_slam_env.vector.state import NO_NOISE, WEIGHTS, Outcome, empty_fleet, empty_outcome, rules_of
from stereo_slam_env.vector.streams import Streams
from stereo_slam_env.world.rays import traversal

Arrays = dict[str, Any]
_POOL = 7
"""Keeps the scenes of a pool apart from those of the episodes of the same seed."""
_FRAMES_AHEAD = 16
"""For so many frames random numbers are drawn ahead."""


class StereoVectorEnv(gym.vector.VectorEnv[Arrays, NDArray[np.float32], NDArray[Any]]):
    """Many environments of one kind, each with a scene, a car, a head, a sensor and random generators of its own.

    Made by `gymnasium.make_vec("StereoSlam/Gaze-v0", num_envs=256)`. The episode of a seed is that of the single
    environment: the same scene and drive, and the same measurements (1e-6 px) as long as the same landmarks are seen.
    What hides landmarks are the same shapes, but exactly: PyBullet's rays hit what they miss by up to a millimetre,
    which makes a difference for less than one in 1,000 landmarks.

    `info` has the keys of the single environment, as arrays with one row for each environment.

    Parameters
    ----------
    num_envs : int
        Number of environments.
    max_episode_steps : int, optional
        Truncate episodes after so many frames; None or -1: never.
    autoreset_mode : AutoresetMode
        NEXT_STEP: the step after the end of an episode is its reset, without an action and a reward. SAME_STEP: the
        reset happens in the last step; the last observation is in `info["final_obs"]`. DISABLED: by
        `reset(options={"reset_mask": mask})`.
    scenes : int, optional
        Take the scenes of all episodes from a pool of so many, which is built with the first reset. None: every episode
        has a scene of its own, as in a single environment.
    threads : int
        Threads over which the environments are spread; results do not depend on it.
    **options
        Of the single environment; `sensor` must be "landmarks", without images, traffic and `render_mode`.

    Raises
    ------
    TypeError
        There is no argument of that name.
    ValueError
        An argument is impossible.
    """

    Single: ClassVar[type[StereoEnv]]
    _workers: ThreadPoolExecutor | None = None  # of the class: Gymnasium closes what could not be made, too

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        scenes: int | None = None,
        threads: int = 1,
        **options: Any,
    ) -> None:
        self.num_envs = whole_number("num_envs", num_envs, 1)
        unlimited = max_episode_steps is None or max_episode_steps == -1  # as `gymnasium.make` has it
        self.max_episode_steps = None if unlimited else whole_number("max_episode_steps", max_episode_steps, 1)
        self._pool_size = None if scenes is None else whole_number("scenes", scenes, 1)
        self.threads = min(whole_number("threads", threads, 1), num_envs)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        if options.pop("render_mode", None) is not None:
            raise ValueError("render_mode must be None in a native vector environment: use vectorization_mode='sync'")
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.single = self.Single(**options)
        """An environment of the same kind, never reset: camera, route, head, noise, options."""
        self.options: StereoOptions = self.single.options
        _check(self.options)
        self._set_spaces(self.single.observation_space, self.single.action_space)

        self._rules = rules_of(self.options, self.single.route, self.single.camera, ARENA)
        most = self._rules.most
        needed = np.array([6, 6, 4 * most, 0])
        self._fleet = empty_fleet(num_envs, 0, 0, max(_FRAMES_AHEAD * 4 * most, 512), 0)
        self._out = empty_outcome(num_envs, most)
        self._streams = Streams(num_envs, needed)
        self._noise = NOISE_MODELS[self.options.noise](self.options.sigma)
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._noise_generators: list[np.random.Generator | None] = [None] * num_envs
        self._pool: list[SceneArrays] = []
        self._rooms = [traversal() for _ in range(self.threads)]
        self._over = np.ones(num_envs, dtype=np.bool_)
        self._everybody = np.ones(num_envs, dtype=np.bool_)

    def _set_spaces(self, observation: gym.Space[Any], action: gym.Space[Any]) -> None:
        self.single_observation_space, self.single_action_space = observation, action
        self.observation_space = batch_space(observation, self.num_envs)
        self.action_space = batch_space(action, self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, Arrays]:
        """Begin an episode in every environment, or in those of `options={"reset_mask": mask}`.

        `seed` is one of the first environment, the others have the following ones, or one for each.
        """
        chosen = self._chosen(options)
        for b, value in zip(np.flatnonzero(chosen).tolist(), self._seeds(seed, chosen), strict=True):
            if value is not None or self._generators[b] is None:
                self._generators[b] = np_random(value)[0]
        self._begin(chosen)
        return self._observation(), self._info()

    def step(self, actions: NDArray[np.float32]) -> tuple[Arrays, FloatArray, BoolArray, BoolArray, Arrays]:
        """Drive for 0.1 s and measure, in every environment."""
        command = self._command(actions)
        over = self._over.copy()
        if over.any():
            if self.autoreset_mode != AutoresetMode.NEXT_STEP:
                raise RuntimeError(f"the episodes of environments {np.flatnonzero(over)[:5].tolist()} are over: reset them")
            self._begin(over)
        rewards = self._advance(command, np.where(over, WAIT, STEP))
        terminated = np.where(over, False, self._out.failed | self._out.success)
        truncated = self._late() & ~over
        self._over = terminated | truncated
        if self.autoreset_mode != AutoresetMode.SAME_STEP or not self._over.any():
            return self._observation(), rewards, terminated, truncated, self._info()
        last, ended = (self._observation(), self._info()), self._over.copy()
        self._begin(ended)
        info = self._info()
        info["final_obs"], info["_final_obs"] = _rows(last[0], ended), ended
        info["final_info"] = {**last[1], **{name: ended for name in last[1] if name.startswith("_")}}
        info["_final_info"] = ended
        return self._observation(), rewards, terminated, truncated, info

    def close_extras(self, **arguments: Any) -> None:
        """Stop the threads."""
        if self._workers is not None:
            self._workers.shutdown()
        self._workers = None

    # --- episodes ---------------------------------------------------------------------------------------------------

    def _begin(self, chosen: BoolArray) -> None:
        """The first frame of an episode of the chosen ones."""
        starts = {}
        for b in np.flatnonzero(chosen).tolist():
            generator = self._generators[b]
            assert generator is not None
            scene_rng, motion, landmark, odometry, start, _ = generator.spawn(6)
            scene = self._scene(scene_rng)
            self._fleet = with_room(self._fleet, scene)
            self._streams.needed[3] = self._fleet.landmarks.shape[1]
            put_scene(self._fleet, b, scene)
            choice, noise = landmark.spawn(2)
            if self._rules.noise == NO_NOISE:  # drawn frame by frame, so nothing of it may be drawn ahead
                self._noise_generators[b], noise = noise, np.random.default_rng(0)
            self._streams.begin(self._fleet, b, [motion, odometry, noise, choice])
            starts[b] = start
        self._run(np.where(chosen, FIRST, WAIT), np.zeros((self.num_envs, *self.single_action_shape)))
        for b, start in starts.items():
            self._started(b, self._start(b, start))
        self._over[chosen] = False

    @property
    def single_action_shape(self) -> tuple[int, ...]:
        """Shape of the action of a frame."""
        return self.single.action_space.shape or ()

    def _started(self, b: int, start: Start) -> None:
        """For what else begins with an episode."""

    def _scene(self, rng: np.random.Generator) -> SceneArrays:
        if self._pool_size is None:
            return scene_arrays(self.options, self.single.route, rng)
        if not self._pool:
            of_pool = np.random.default_rng([_POOL, int(rng.integers(2**31))]).spawn(self._pool_size)
            self._pool = [scene_arrays(self.options, self.single.route, each) for each in of_pool]
        return self._pool[int(rng.integers(len(self._pool)))]

    def _start(self, b: int, rng: np.random.Generator) -> Start:
        """A known pose, and a velocity with an error of the stated covariance."""
        velocity = self._fleet.velocity[b] + START_SIGMAS[6:] * rng.standard_normal(6)
        return Start(linear_velocity=velocity[:3], angular_velocity=velocity[3:], covariance=np.diag(START_SIGMAS**2))

    def _advance(self, command: FloatArray, doing: IntArray) -> FloatArray:
        """A step; the rewards."""
        self._run(doing, command)
        rewards: FloatArray = np.where(doing == STEP, self._out.terms @ self._rules.weights, 0.0)
        return rewards

    def _run(self, doing: IntArray, command: FloatArray) -> None:
        """A frame of those that do something."""
        self._streams.refill(self._fleet, doing != WAIT)
        if self.threads == 1:
            run_frame(self._rules, self._fleet, self._out, self._rooms[0], doing, command, 0, self.num_envs)
        else:
            if self._workers is None:
                self._workers = ThreadPoolExecutor(self.threads)
            edges = [self.num_envs * i // self.threads for i in range(self.threads + 1)]
            runs = [
                self._workers.submit(run_frame, self._rules, self._fleet, self._out, room, doing, command, first, last)
                for room, first, last in zip(self._rooms, edges[:-1], edges[1:], strict=True)
            ]
            for run in runs:
                run.result()
        if self._rules.noise == NO_NOISE:
            for b in np.flatnonzero(doing != WAIT).tolist():
                self._corrupt(b)

    def _corrupt(self, b: int) -> None:
        """Noise of a model without a kernel."""
        count, generator = int(self._out.count[b]), self._noise_generators[b]
        assert generator is not None
        uvd, v_right = self._noise.corrupt(self._out.uvd[b, :count], generator)
        self._out.uvd[b, :count] = uvd
        if v_right is not None:
            self._out.v_right[b, :count] = v_right

    def _late(self) -> BoolArray:
        if self.max_episode_steps is None:
            return np.zeros(self.num_envs, dtype=np.bool_)
        return np.asarray(self._fleet.step >= self.max_episode_steps)

    # --- what is said of them ---------------------------------------------------------------------------------------

    def _observation(self) -> Arrays:
        """The observation of every environment."""
        out, fleet, rows = self._out, self._fleet, self._rules.most
        there = np.arange(rows) < out.count[:, None]
        seen: Arrays = {
            "uvd": np.where(there[..., None], out.uvd, 0.0).astype(np.float32),
            "mask": there.astype(np.int8),
            "odometry": np.clip(out.odometry, -MAX_VELOCITY, MAX_VELOCITY).astype(np.float32),
            "progress": (fleet.farthest / self.single.route.length)[:, None].astype(np.float32),
        }
        if self.options.observe_ids:
            seen["ids"] = out.ids.copy()
        if self._rules.steered:
            seen["car"] = fleet.car[:, :2].astype(np.float32)
            seen["route"] = route_ahead(self.single.route, fleet.nearest, fleet.body[:, :3], fleet.body[:, 3:])
        if self._rules.has_head:
            seen["head"] = fleet.angles.astype(np.float32)
        return {key: seen[key] for key in self.single.observation_space}

    def _info(self) -> Arrays:
        """What the single environment says in `info`, one row each; `_key` says whose rows are valid, which all are."""
        out, fleet = self._out, self._fleet
        measured = self.options.noise != "uvd"
        there = np.arange(self._rules.most) < out.count[:, None]
        info: Arrays = {
            "truth_position": fleet.pose[:, :3].copy(),
            "truth_orientation": fleet.pose[:, 3:].copy(),
            "truth_linear_velocity": fleet.velocity[:, :3].copy(),
            "truth_angular_velocity": fleet.velocity[:, 3:].copy(),
            "time": fleet.step * self._rules.dt,
            "distance": fleet.distance.copy(),
            "collision": out.collision.copy(),
            "is_success": out.success.copy(),
            "v_right": np.where(there & measured, out.v_right, 0.0),
            "v_right_measured": np.full(self.num_envs, measured),
            "R": np.broadcast_to(0.0, (self.num_envs, self._rules.most, 3, 3)),
            "R_measured": np.zeros(self.num_envs, dtype=np.bool_),
        }
        for k, name in enumerate(WEIGHTS):
            if hasattr(self.options, f"{name}_weight"):
                info[f"reward_{name}"] = self._rules.weights[k] * out.terms[:, k]
        everybody = self._everybody.copy()
        return {**info, **{f"_{key}": everybody for key in info}}

    @property
    def outcome(self) -> Outcome:
        """Measurements of the last frame in full precision; do not change them."""
        return self._out

    # --- arguments --------------------------------------------------------------------------------------------------

    def _chosen(self, options: dict[str, Any] | None) -> BoolArray:
        """Environments to be reset."""
        if not options:
            return self._everybody.copy()
        if set(options) != {"reset_mask"}:
            raise ValueError(f"reset takes no options but reset_mask, got {', '.join(map(repr, options))}")
        mask = np.asarray(options["reset_mask"])
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"reset_mask must be ({self.num_envs},) bool with at least one True, got {mask!r}")
        if not (mask | ~np.array([generator is None for generator in self._generators])).all():
            raise ValueError("reset_mask must be all True in the first reset")
        return mask

    def _seeds(self, seed: int | Sequence[int | None] | None, chosen: BoolArray) -> list[int | None]:
        """Seeds of the chosen ones."""
        each: list[int | None]
        try:
            if seed is None:
                each = [None] * self.num_envs
            elif isinstance(seed, (Sequence, np.ndarray)):
                each = [None if value is None else index(value) for value in seed]
            else:
                each = [index(seed) + b for b in range(self.num_envs)]
        except TypeError:
            each = []
        if len(each) != self.num_envs:
            raise ValueError(f"seed must be a whole number or {self.num_envs} of them, got {seed!r}")
        return [each[b] for b in np.flatnonzero(chosen).tolist()]

    def _command(self, actions: Any) -> FloatArray:
        """The actions (B, ...) as the kernels take them."""
        if self._generators[0] is None:
            raise RuntimeError("reset the environments before the first step")
        command = finite_array("actions", actions, (self.num_envs, *self.single_action_shape))
        return np.clip(command, -1.0, 1.0)


class DriveVectorEnv(StereoVectorEnv):
    """Many `StereoSlam/Drive-v0`."""

    Single = StereoDriveEnv


class GazeVectorEnv(StereoVectorEnv):
    """Many `StereoSlam/Gaze-v0`."""

    Single = StereoGazeEnv


class DriveGazeVectorEnv(StereoVectorEnv):
    """Many `StereoSlam/DriveGaze-v0`."""

    Single = StereoDriveGazeEnv


def _check(options: StereoOptions) -> None:
    """Refuse what only single environments have."""
    only = {"sensor": "landmarks", "render_images": False, "moving_cars": 0, "pedestrians": 0}
    for name, value in only.items():
        if getattr(options, name) != value:
            raise ValueError(
                f"{name} must be {value!r} in a native vector environment, got {getattr(options, name)!r}: "
                "use make_vec(..., vectorization_mode='async') for a process each"
            )


def _rows(observation: Arrays, which: BoolArray) -> NDArray[Any]:
    """Observations of single environments, None where they are not asked for."""
    rows = np.full(len(which), None, dtype=object)
    for b in np.flatnonzero(which).tolist():
        rows[b] = {key: value[b].copy() for key, value in observation.items()}
    return rows
