"""`gym.make_vec("StereoSlam/...")`: many environments with the landmark sensor, stepped by compiled kernels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from filters.contract.known_names import require_known
from filters.contract.start import Start
from filters.engine.batch import FilterBatch
from filters.validation import BoolArray, FloatArray, IntArray, finite_array, whole_number
from stereo_slam_env.envs.drive import StereoDriveEnv
from stereo_slam_env.envs.drive_gaze import StereoDriveGazeEnv
from stereo_slam_env.envs.gaze import StereoGazeEnv
from stereo_slam_env.envs.options import StereoOptions
from stereo_slam_env.envs.stereo_env import ARENA, MAX_VELOCITY, START_SIGMAS, StereoEnv, route_ahead
from stereo_slam_env.policies.interface import directions, require_head
from stereo_slam_env.sensing.pixel_noise import NOISE_MODELS
from stereo_slam_env.vector.arguments import require_native, reset_mask, rows_of, seeds_of
from stereo_slam_env.vector.belief import LockstepBelief, PoseInformation
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
        Take the scenes of all episodes from a pool of so many, which each reset with a seed builds anew. None: every
        episode has a scene of its own, as in a single environment.
    threads : int
        Threads over which the environments are spread; results do not depend on it.
    belief : mapping, optional
        A filter in the loop of each environment: arguments of `wrappers.BeliefObservation`, which adds the same keys.
        With `hold` a step has so many frames.
    panorama : mapping, optional
        Arguments of `wrappers.BeliefPanorama`.
    information : mapping, optional
        The reward is information about the pose: `criterion`, `resolution`, `prior_sigma`, `weight` and `keep_reward`
        of `wrappers.InformationGain`.
    keys : sequence of str, optional
        The keys of the observation; None: all.
    pans : int, optional
        The action is the number of one of so many directions to look in, see `training.task.DirectionOfGaze`.
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
        belief: Mapping[str, Any] | None = None,
        panorama: Mapping[str, Any] | None = None,
        information: Mapping[str, Any] | None = None,
        keys: Sequence[str] | None = None,
        pans: int | None = None,
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
        require_native(self.options)
        self._belief = None if belief is None else LockstepBelief(self.single, num_envs, belief, panorama, self.threads)
        if belief is None and (panorama is not None or information is not None):
            raise ValueError("panorama and information need a filter in the loop: give belief={}")
        self._information = None if information is None else PoseInformation(information)
        self._hold = 1 if self._belief is None else self._belief.hold
        self._directions = None if pans is None else self._actions_of(directions(whole_number("pans", pans, 2)))
        self._set_spaces(keys)

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

    def _set_spaces(self, keys: Sequence[str] | None) -> None:
        whole: Any = self.single.observation_space if self._belief is None else self._belief.observation_space
        if keys is not None:
            require_known("the observation has no key", keys, whole.spaces)
        self._keys = list(whole.spaces) if keys is None else list(keys)
        self.single_observation_space = gym.spaces.Dict({key: whole[key] for key in self._keys})
        self.single_action_space: gym.Space[Any] = self.single.action_space
        if self._directions is not None:
            self.single_action_space = gym.spaces.Discrete(len(self._directions))
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, Arrays]:
        """Begin an episode in every environment, or in those of `options={"reset_mask": mask}`.

        `seed` is one of the first environment, the others have the following ones, or one for each.
        """
        if seed is not None:
            self._pool = []  # episodes depend on their seeds alone
        chosen = reset_mask(options, np.array([generator is not None for generator in self._generators]))
        for b, value in enumerate(seeds_of(seed, self.num_envs)):
            if chosen[b] and (value is not None or self._generators[b] is None):
                self._generators[b] = np_random(value)[0]
        self._begin(chosen)
        return self._observation(), self._info()

    def step(self, actions: NDArray[np.float32]) -> tuple[Arrays, FloatArray, BoolArray, BoolArray, Arrays]:
        """Drive for 0.1 s and measure, in every environment."""
        command = self._command(actions)
        over = self._over.copy()
        if over.any():
            if self.autoreset_mode != AutoresetMode.NEXT_STEP:
                raise RuntimeError(
                    f"the episodes of environments {np.flatnonzero(over)[:5].tolist()} are over: reset them"
                )
            self._begin(over)
        rewards = self._advance(command, ~over)
        terminated = np.where(over, False, self._out.failed | self._out.success)
        truncated = self._late() & ~over
        self._over = terminated | truncated
        if self.autoreset_mode != AutoresetMode.SAME_STEP or not self._over.any():
            return self._observation(), rewards, terminated, truncated, self._info()
        last, ended = (self._observation(), self._info()), self._over.copy()
        self._begin(ended)
        info = self._info()
        info["final_obs"], info["_final_obs"] = rows_of(last[0], ended), ended
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
            self._streams.needed[3] = self._fleet.landmarks.shape[2]
            put_scene(self._fleet, b, scene)
            choice, noise = landmark.spawn(2)
            if self._rules.noise == NO_NOISE:  # drawn frame by frame, so nothing of it may be drawn ahead
                self._noise_generators[b], noise = noise, np.random.default_rng(0)
            self._streams.begin(self._fleet, b, [motion, odometry, noise, choice])
            starts[b] = start
        self._run(np.where(chosen, FIRST, WAIT), np.zeros((self.num_envs, *self.single_action_shape)))
        self._over[chosen] = False
        if self._belief is not None:
            for b, start in starts.items():
                self._belief.begin(b, self._start(b, start))
            self._belief.use_frame(np.where(chosen, FIRST, WAIT), self._out)
            if self._information is not None:
                self._information.begin(self._belief.filters.pose_covariances, chosen)

    @property
    def single_action_shape(self) -> tuple[int, ...]:
        """Shape of the action of a frame."""
        return self.single.action_space.shape or ()

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

    def _advance(self, command: FloatArray, going: BoolArray) -> FloatArray:
        """A step of those that go on; the rewards."""
        rewards, still = np.zeros(self.num_envs), going.copy()
        for _ in range(self._hold):
            doing = np.where(still, STEP, WAIT)
            self._run(doing, command)
            if self._belief is not None:
                self._belief.use_frame(doing, self._out)
            rewards[still] += (self._out.terms @ self._rules.weights)[still]
            still &= ~(self._out.failed | self._out.success | self._late())
        if self._belief is not None and self._information is not None:
            gained = self._information.use(self._belief.filters.pose_covariances, going)
            rewards = rewards + gained if self._information.keeps_reward else gained
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
        count, generator = int(self._out.seen[b]), self._noise_generators[b]
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
        there = np.arange(rows) < out.seen[:, None]
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
        if self._belief is not None:
            seen |= self._belief.read(fleet.angles, self._keys)
        return {key: seen[key] for key in self._keys}

    def _info(self) -> Arrays:
        """What the single environment says in `info`, one row each; `_key` says whose rows are valid, which all are."""
        out, fleet = self._out, self._fleet
        measured = self.options.noise != "uvd"
        there = np.arange(self._rules.most) < out.seen[:, None]
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
        if self._belief is not None:
            info |= self._belief.info()
        if self._information is not None:
            info |= self._information.info()
        everybody = self._everybody.copy()
        return {**info, **{f"_{key}": everybody for key in info}}

    @property
    def filters(self) -> FilterBatch:
        """The filters in the loop."""
        if self._belief is None:
            raise RuntimeError("there is no filter in the loop: give belief={}")
        return self._belief.filters

    @property
    def nbytes(self) -> int:
        """Memory of the state of all environments, without the filters."""
        return sum(array.nbytes for array in (*self._fleet, *self._out))

    @property
    def outcome(self) -> Outcome:
        """Measurements of the last frame in full precision; do not change them."""
        return self._out

    # --- arguments --------------------------------------------------------------------------------------------------

    def _actions_of(self, looks: FloatArray) -> FloatArray:
        """Actions that look somewhere (pan and tilt as shares of the largest) and do nothing else."""
        require_head(self.single)
        return np.concatenate([np.zeros((len(looks), self.single_action_shape[0] - 2)), looks], axis=1)

    def _command(self, actions: Any) -> FloatArray:
        """The actions (B, ...) as the kernels take them."""
        if self._generators[0] is None:
            raise RuntimeError("reset the environments before the first step")
        if self._directions is not None:
            if not self.action_space.contains(np.asarray(actions)):
                raise ValueError(
                    f"actions must be {self.num_envs} numbers from 0 to {len(self._directions) - 1}, got {actions!r}"
                )
            return np.asarray(self._directions[np.asarray(actions)])
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
