"""Filters in the loop of many environments, in lock-step, and what their beliefs add to the observations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from filters.catalogue.registry import make_filter
from filters.contract.known_names import require_known
from filters.contract.start import Start
from filters.engine.batch import FilterBatch, RelativeLandmarks
from filters.engine.engine import Observations, Odometry
from filters.engine.stereo_ekf import StereoEKF
from filters.validation import BoolArray, FloatArray, IntArray, finite_number
from stereo_slam_env.envs.stereo_env import StereoEnv
from stereo_slam_env.sensing.padding import NO_LANDMARK
from stereo_slam_env.vector.frame import STEP, WAIT
from stereo_slam_env.vector.panorama import panoramas
from stereo_slam_env.vector.state import Outcome
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama
from stereo_slam_env.wrappers.belief_observation import assumed_noise
from stereo_slam_env.wrappers.belief_panorama import FORGOTTEN, share_in_view
from stereo_slam_env.wrappers.information import InformationCriterion

Arrays = dict[str, Any]


class LockstepBelief:
    """A filter for each environment, all of one recipe.

    Parameters
    ----------
    single : StereoEnv
        An environment like all of them.
    count : int
        Number of environments.
    belief : mapping
        Arguments of `wrappers.BeliefObservation`.
    panorama : mapping, optional
        Arguments of `wrappers.BeliefPanorama`; None: there is none.
    threads : int
        Threads over which the filters are spread.
    """

    def __init__(
        self,
        single: StereoEnv,
        count: int,
        belief: Mapping[str, Any],
        panorama: Mapping[str, Any] | None,
        threads: int,
    ) -> None:
        template = BeliefObservation(single, **belief)
        self.observation_space: gym.spaces.Dict = template.observation_space  # type: ignore[assignment]
        arguments = template.arguments
        self._rows, self._use_odometry = int(arguments["max_landmarks"]), bool(arguments["use_odometry"])
        self.hold = int(arguments["hold"])
        """Frames of a step."""
        self._camera, self._noise = single.camera, single.noise
        self._assumed = assumed_noise(arguments["noise"], single.noise)
        options = dict(arguments["options"] or {})

        def make() -> StereoEKF:
            made = make_filter(arguments["filter"], camera=single.camera, noise=self._assumed, **options)
            if not isinstance(made, StereoEKF):
                raise ValueError(f"filter must be a StereoEKF with kernels, {arguments['filter']!r} is none")
            return made

        self.filters = FilterBatch(make, count, threads)
        self._frames = np.zeros(count, dtype=np.int64)
        self._odometry_covariance = np.diag(
            np.repeat([single.options.odometry_sigma_linear, single.options.odometry_sigma_angular], 3) ** 2
        )
        self._with_right = single.options.noise != "uvd"
        self._most = int(single.options.max_landmarks)
        self._panorama: BeliefPanorama | None = None
        if panorama is not None:
            self._panorama = BeliefPanorama(template, **panorama)
            self.observation_space = self._panorama.observation_space  # type: ignore[assignment]
            self._last_seen = np.full((count, self._panorama.sectors), -np.inf)
        self.nis, self.nis_dof = np.zeros(count), np.zeros(count, dtype=np.int64)

    def begin(self, b: int, start: Start) -> None:
        """Start the filter of an environment again."""
        self.filters[b].reset(start)
        self._frames[b] = 0
        if self._panorama is not None:
            self._last_seen[b] = -np.inf

    def use_frame(self, doing: IntArray, out: Outcome) -> None:
        """Let the filters use the frame of those environments that had one; others stay."""
        seen, moved = doing != WAIT, doing == STEP
        there = (np.arange(out.ids.shape[1]) < out.seen[:, None]) & seen[:, None]
        offsets = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
        observations = Observations(
            seen, offsets, out.ids[there], out.uvd[there], self._assumed.R, seen & self._with_right, out.v_right[there]
        )
        odometry = Odometry(moved & self._use_odometry, out.odometry, self._odometry_covariance)
        outcome = self.filters.engine.step(np.where(moved, FRAME_PERIOD, 0.0), observations, odometry)
        self._frames[moved] += 1
        self.nis[seen], self.nis_dof[seen] = outcome.nis[seen], outcome.dof[seen]
        poses = self.filters.poses
        if not np.isfinite(poses).all():
            b = int(np.flatnonzero(~np.isfinite(poses).all(axis=1))[0])
            raise RuntimeError(
                f"the filter of environment {b} returned NaN or infinity in its pose in frame {self._frames[b]}"
            )

    def read(self, angles: FloatArray, keys: Sequence[str]) -> Arrays:
        """What the beliefs add to the observations, of the `keys`; angles (B, 2) are of the heads, rad."""
        boxes: Any = self.observation_space
        P = self.filters.pose_covariances
        poses = self.filters.poses
        maps = self.filters.relative_landmarks()
        values: Arrays = {
            "belief_position": poses[:, :3],
            "belief_orientation": poses[:, 3:],
            "belief_covariance": P,
        }
        if any(key.startswith(("belief_landmark", "belief_mask")) for key in keys):
            values |= _nearest(maps, len(poses), self._rows)
        if self._panorama is not None:
            values["belief_sigmas"] = np.sqrt(np.einsum("bii->bi", P))
            values["panorama"] = self._seen_around(maps, angles)
        clipped = {key: np.clip(values[key], boxes[key].low, boxes[key].high) for key in keys if key in values}
        return {key: value.astype(boxes[key].dtype) for key, value in clipped.items()}

    def info(self) -> Arrays:
        """What the beliefs add to `info`."""
        sizes = self.filters.engine.storage.counts[:, 0]
        return {"belief_nis": self.nis.copy(), "belief_nis_dof": self.nis_dof.copy(), "belief_map_size": sizes.copy()}

    def _seen_around(self, maps: RelativeLandmarks, angles: FloatArray) -> FloatArray:
        assert self._panorama is not None
        sectors, reach = self._panorama.sectors, self._panorama.reach
        map_part = panoramas(maps, angles, self._camera, self._noise, sectors, self._most, reach)
        in_view = share_in_view(self._camera, angles[:, :1], sectors)
        now = self._frames[:, None] * FRAME_PERIOD
        self._last_seen = np.where(in_view >= 0.5, now, self._last_seen)
        unseen = 1.0 - np.exp((self._last_seen - now) / FORGOTTEN)
        return np.concatenate([map_part, in_view[..., None], unseen[..., None]], axis=2)


class PoseInformation:
    """The reward of `wrappers.InformationGain` of the pose, of many environments: the decrease of a potential.

    Parameters
    ----------
    arguments : mapping
        `criterion`, `resolution`, `prior_sigma`, `weight` and `keep_reward` of `InformationGain`.

    Raises
    ------
    ValueError
        There is another argument, or a value is impossible.
    """

    def __init__(self, arguments: Mapping[str, Any]) -> None:
        require_known(
            "information has no key", arguments, ("criterion", "resolution", "prior_sigma", "weight", "keep_reward")
        )
        given = dict(arguments)
        self._weight = finite_number("weight", given.pop("weight", 1.0))
        self.keeps_reward = bool(given.pop("keep_reward", False))
        given["resolution"] = tuple(given.get("resolution", (0.0, 0.0)))
        self._criterion = InformationCriterion(given.pop("criterion", "log-det"), of="pose", **given)
        self.potential = np.zeros(0)
        self.reward = np.zeros(0)

    def begin(self, covariances: FloatArray, fresh: BoolArray) -> None:
        """Begin the `fresh` episodes (B,), from the covariances (B, 6, 6) of all poses; the others stay as they are."""
        now = self._criterion.pose_potentials(covariances)
        if not len(self.potential):
            self.potential, self.reward = now, np.zeros(len(now))
        self.potential, self.reward = np.where(fresh, now, self.potential), np.where(fresh, 0.0, self.reward)

    def use(self, covariances: FloatArray, going: BoolArray) -> FloatArray:
        """Rewards (B,) of a step, from the covariances (B, 6, 6) of the poses; 0 for those that did not go on."""
        now = self._criterion.pose_potentials(covariances)
        self.reward = np.where(going, self._weight * (self.potential - now), 0.0)
        self.potential = now
        return self.reward

    def info(self) -> Arrays:
        """What it adds to `info`."""
        return {"reward_information": self.reward.copy(), "information_potential": self.potential.copy()}


def _nearest(maps: RelativeLandmarks, count: int, rows: int) -> Arrays:
    """The landmarks of each map that are nearest to the camera, padded."""
    owner = np.repeat(np.arange(count), np.diff(maps.offsets))
    index = np.flatnonzero(maps.located)
    squares = np.einsum("ni,ni->n", maps.points_c[index], maps.points_c[index])
    order = index[np.lexsort((squares, owner[index]))]
    rank = np.arange(len(order)) - np.searchsorted(owner[order], np.arange(count))[owner[order]]
    shown = np.sort(order[rank < rows])
    b = owner[shown]
    column = np.arange(len(shown)) - np.searchsorted(b, np.arange(count))[b]
    found: Arrays = {
        "belief_landmark_ids": np.full((count, rows), NO_LANDMARK),
        "belief_landmarks": np.zeros((count, rows, 3)),
        "belief_landmark_covariances": np.zeros((count, rows, 3, 3)),
        "belief_mask": np.zeros((count, rows), dtype=np.int8),
    }
    found["belief_landmark_ids"][b, column] = maps.ids[shown]
    found["belief_landmarks"][b, column] = maps.points_c[shown]
    found["belief_landmark_covariances"][b, column] = maps.covariances[shown]
    found["belief_mask"][b, column] = 1
    return found
