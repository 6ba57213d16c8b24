"""`InformationGain`: the reward is the information that the step gained."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np

from filters.contract.known_names import one_of
from filters.motions.constant_velocity import ConstantVelocity
from filters.validation import IntArray, finite_number, whole_number
from stereo_slam_env.evaluation.consistency import mean_band
from stereo_slam_env.evaluation.cramer_rao import ReferenceBelief
from stereo_slam_env.wrappers.information import Criterion, InformationCriterion, Subject
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper

BeliefOf = Literal["filter", "reference"]
"""Belief that is paid for: that of the filter in the loop, or the reference belief."""


class InformationGain(RecordedWrapper):
    """The reward of a step is the decrease of a potential, the uncertainty of pose and map.

    So the return telescopes: it is the potential at reset minus the potential at the end, times `weight`, whatever
    happened between and however long it took. The potentials are those of `wrappers.information`; there every unseen
    landmark stands at a prior, so that discovering one is never punished. A landmark that leaves the map falls back to
    the prior: its information is lost, and costs what it had earned. (The named filters drop landmarks as soon as
    they are out of sight; `BeliefObservation(env, options={"drop_unseen": False})` keeps them.)

    Driving costs information: the first step most (some 90 nats of the pose), because the start is known as if exactly.

    **Over-confidence.** A covariance is the filter's claim, and an over-confident filter earns more. Two guards:

    - `belief="reference"`: the potential is that of the best estimator, linearised at the truth and fed with the same
      frames (approximately the posterior Cramer-Rao bound): the same for all filters, and without one.
    - `nees_gate=0.95`: while the pose NEES (position and rotation) exceeds the upper end of the two-sided chi-square
      band of that probability, nothing is credited: the potential stays where it was, or rises with the filter's. The
      reward of such a step is never positive. What the filter claimed meanwhile is credited once it is consistent
      again. The return still telescopes, but to the *credited* potential; that one depends on the truth and on the
      past, not on the belief alone, so it is no potential-based shaping of the belief-space task, and a policy cannot
      know it from the belief. A consistent filter exceeds the band in 2.5 % of the steps, too.

    `info` gains `reward_information` (0 at reset) and `information_potential` (credited, if there is a gate); with
    `report_both` also `reward_information_claimed` and `reward_information_reference`, of filter and reference, before
    any gate. A filter whose claims exceed the reference over many episodes is over-confident; in one episode noise and
    the landmarks that its gate refused move them either way.

    Parameters
    ----------
    env : gymnasium.Env
        With `BeliefObservation` inside, where the filter's belief is needed.
    criterion : {"log-det", "entropy", "d-optimality", "a-optimality", "e-optimality"}
        Potential; nats for the first two, else m^2.
    of : {"map", "pose"}
        Of pose and map together, or of the pose alone.
    prior_sigma : float
        Standard deviation of the position of an unseen landmark, m, each axis.
    resolution : (2,) sequence of float
        To know position, m, and rotation, rad, better than this is worth next to nothing, see `InformationCriterion`.
    belief : {"filter", "reference"}
        Belief whose potential counts.
    nees_gate : float, optional
        Probability of the chi-square band; only with `belief="filter"`. None: no gate.
    weight : float
        Of the reward.
    keep_reward : bool
        Add it to the reward of the environment, instead of replacing that.
    max_age : int, optional
        Frames without a sighting after which a landmark leaves the reference belief; 0, like the named filters, at
        once; None: never, which costs more and more.
    use_odometry : bool
        Whether the reference is given the odometry.
    report_both : bool
        Run both, the filter's and the reference belief, whichever the reward is made of.

    Raises
    ------
    ValueError
        An argument is unknown or impossible, or there is no filter in the loop where one is needed.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        criterion: Criterion = "log-det",
        of: Subject = "map",
        prior_sigma: float = 10.0,
        resolution: Sequence[float] = (0.0, 0.0),
        belief: BeliefOf = "filter",
        nees_gate: float | None = None,
        weight: float = 1.0,
        keep_reward: bool = False,
        max_age: int | None = 0,
        use_odometry: bool = True,
        report_both: bool = False,
    ) -> None:
        super().__init__(env)
        one_of("belief", belief, get_args(BeliefOf))
        if nees_gate is not None and belief == "reference":
            raise ValueError("nees_gate must be None with belief='reference', which claims nothing to be judged")
        if max_age is not None:
            whole_number("max_age", max_age, 0)
        self._criterion = InformationCriterion(criterion, of, prior_sigma, tuple(resolution))
        self._limit = np.inf if nees_gate is None else mean_band(6, 1, nees_gate)[1]
        self._belief, self._weight, self._keep_reward = belief, finite_number("weight", weight), keep_reward
        self._both, self._use_odometry = report_both, use_odometry
        self._recent: deque[IntArray] | None = None if max_age is None else deque(maxlen=max_age + 1)
        if belief == "filter" or report_both:
            self.inner("slam")
        self._reference: ReferenceBelief | None = None
        self._potentials: dict[str, float] = {}
        self._credited = 0.0

    @property
    def reference(self) -> ReferenceBelief:
        """The reference belief after the current frame, where one is run."""
        if self._reference is None:
            raise RuntimeError("there is no reference belief: use belief='reference' or report_both, and reset first")
        return self._reference

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; nothing is gained yet."""
        observation, info = self.env.reset(seed=seed, options=options)
        if self._both or self._belief == "reference":
            camera, noise, start = (self.inner(name) for name in ("camera", "noise", "start"))
            self._reference = ReferenceBelief(
                camera, noise, ConstantVelocity(), start, self.inner("frame").truth, use_odometry=self._use_odometry
            )
        if self._recent is not None:
            self._recent.clear()
        self._use_frame()
        self._potentials = self._now()
        self._credited = self._potentials[self._belief]
        return observation, self._with_gains(info, 0.0, dict.fromkeys(self._potentials, 0.0))

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the environment; the reward is the information gained."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._use_frame()
        before, self._potentials = self._potentials, self._now()
        claims = self._potentials[self._belief]
        credited = claims if self._is_consistent() else max(self._credited, claims)
        gain = self._weight * (self._credited - credited)
        self._credited = credited
        gains = {name: self._weight * (before[name] - now) for name, now in self._potentials.items()}
        total = float(reward) + gain if self._keep_reward else gain
        return observation, total, terminated, truncated, self._with_gains(info, gain, gains)

    def _use_frame(self) -> None:
        """Feed the current frame to the reference belief, if there is one; landmarks leave it by age."""
        frame = self.inner("frame")
        if self._reference is not None:
            self._reference.step(frame, self.inner("landmark_truth")())
            if self._recent is not None:
                self._recent.append(frame.observation.ids)
                self._reference.keep(np.concatenate(self._recent))

    def _now(self) -> dict[str, float]:
        """The potential of each belief that is needed."""
        potential, alone = self._criterion.potential, self._criterion.of == "pose"
        now = {}
        if self._both or self._belief == "filter":
            belief = self.inner("belief")
            now["filter"] = potential(belief.pose.covariance if alone else belief.joint_covariance)
        if self._reference is not None:
            best = self._reference
            now["reference"] = potential(best.pose_covariance if alone else best.joint_covariance())
        return now

    def _is_consistent(self) -> bool:
        if self._limit == np.inf:
            return True
        return bool(self.inner("belief").nees(self.inner("frame").truth)[2] <= self._limit)

    def _with_gains(self, info: dict[str, Any], gain: float, gains: dict[str, float]) -> dict[str, Any]:
        added = {"reward_information": gain, "information_potential": self._credited}
        if self._both:
            added["reward_information_claimed"] = gains["filter"]
            added["reward_information_reference"] = gains["reference"]
        return {**info, **{name: np.float64(value) for name, value in added.items()}}
