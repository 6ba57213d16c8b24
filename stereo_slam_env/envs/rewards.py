"""Rewards of what a filter learns: the information gained in the step (`InformationGain`), or its true error."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

import numpy as np

from filters.contract.validation import finite_number, one_of, whole_number
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.motions.constant_velocity import ConstantVelocity
from stereo_slam_env.envs.filter_rows import FilterRows
from stereo_slam_env.envs.information import Criterion, InformationCriterion, Subject
from stereo_slam_env.envs.row_wrapper import PaidRows, RowsWrapper
from stereo_slam_env.envs.rows import Arrays, Seeds, Step
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.evaluation.cramer_rao import ReferenceBelief

BeliefOf = Literal["filter", "reference"]
"""Belief that is paid for: that of the filter in the loop, or the reference belief."""


class InformationGain(RowsWrapper):
    """The reward of a step is the decrease of a potential, the uncertainty of pose and map.

    So the return telescopes: it is the potential at reset minus the potential at the end, times `weight`, whatever
    happened between and however long it took. The potentials are those of `envs.information`; there every unseen
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

    shared = ("reference",)

    def __init__(
        self,
        env: Any,
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
        frames_kept = 1 if max_age is None else whole_number("max_age", max_age, 0) + 1
        self._criterion = InformationCriterion(criterion, of, prior_sigma, tuple(resolution))
        self._limit = np.inf if nees_gate is None else mean_band(6, 1, nees_gate)[1]
        self._paid, self._weight, self._keep_reward = belief, finite_number("weight", weight), keep_reward
        self._both, self._use_odometry = report_both, use_odometry
        self._ages = max_age is not None
        self._recent: list[deque[IntArray]] = [deque(maxlen=frames_kept) for _ in range(self.num_envs)]
        self._beliefs: FilterRows | None = None
        if belief == "filter" or report_both:
            self._beliefs = self.needed("beliefs")
        self.references: list[ReferenceBelief | None] = [None] * self.num_envs
        """The reference beliefs after the current frames, where they are run."""
        names = [name for name in get_args(BeliefOf) if report_both or name == belief]
        self._potentials, self._gains = ({name: np.zeros(self.num_envs) for name in names} for _ in range(2))
        self._credited, self._gain = np.zeros(self.num_envs), np.zeros(self.num_envs)

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """Start without a gain."""
        self.rows.reset(chosen, seeds, options)
        if "reference" in self._potentials:
            camera, noise = self.needed("camera"), self.needed("noise")
            for b in np.flatnonzero(chosen).tolist():
                start, truth = self.world.start(b), self.world.frame(b).truth
                assert truth is not None
                self.references[b] = ReferenceBelief(
                    camera, noise, ConstantVelocity(), start, truth, use_odometry=self._use_odometry
                )
                self._recent[b].clear()
        for name, now in self._now(chosen).items():
            self._potentials[name][chosen], self._gains[name][chosen] = now[chosen], 0.0
        self._credited[chosen], self._gain[chosen] = self._potentials[self._paid][chosen], 0.0

    def step(self, actions: Any, going: BoolArray) -> Step:
        """The reward is the information gained."""
        rewards, terminated, truncated = self.rows.step(actions, going)
        for name, now in self._now(going).items():
            before = self._potentials[name]
            self._gains[name] = np.where(going, self._weight * (before - now), self._gains[name])
            self._potentials[name] = np.where(going, now, before)
        claims = self._potentials[self._paid]
        credited = np.where(self._are_consistent(going), claims, np.maximum(self._credited, claims))
        self._gain = np.where(going, self._weight * (self._credited - credited), self._gain)
        self._credited = np.where(going, credited, self._credited)
        gained = np.where(going, self._gain, 0.0)
        return rewards + gained if self._keep_reward else gained, terminated, truncated

    def observe(self) -> tuple[Arrays, Arrays]:
        observation, info = self.rows.observe()
        added = {"reward_information": self._gain.copy(), "information_potential": self._credited.copy()}
        if self._both:
            added["reward_information_claimed"] = self._gains["filter"].copy()
            added["reward_information_reference"] = self._gains["reference"].copy()
        return observation, {**info, **added}

    def _now(self, which: BoolArray) -> dict[str, FloatArray]:
        """The potentials (B,) of each belief that is needed, of some rows after their frame."""
        return {name: self._of_filters(which) if name == "filter" else self._of_references(which)
                for name in self._potentials}  # fmt: skip

    def _of_filters(self, which: BoolArray) -> FloatArray:
        assert self._beliefs is not None
        if self._criterion.of == "pose":
            return self._criterion.pose_potentials(self._beliefs.pose_covariances)
        now = np.zeros(self.num_envs)
        for b in np.flatnonzero(which).tolist():
            now[b] = self._criterion.potential(self._beliefs.belief(b).joint_covariance)
        return now

    def _of_references(self, which: BoolArray) -> FloatArray:
        """Potentials of the reference beliefs, which are fed the frames; landmarks leave them by age."""
        now = np.zeros(self.num_envs)
        for b in np.flatnonzero(which).tolist():
            best, frame, recent = self.references[b], self.world.frame(b), self._recent[b]
            assert best is not None
            best.step(frame, self.world.landmark_truth(b))
            if self._ages:
                recent.append(frame.observation.ids)
                best.keep(np.concatenate(recent))
            alone = self._criterion.of == "pose"
            now[b] = self._criterion.potential(best.pose_covariance if alone else best.joint_covariance())
        return now

    def _are_consistent(self, which: BoolArray) -> BoolArray:
        consistent = np.ones(self.num_envs, dtype=np.bool_)
        if self._limit == np.inf:
            return consistent
        assert self._beliefs is not None
        for b in np.flatnonzero(which).tolist():
            truth = self.world.frame(b).truth
            assert truth is not None
            consistent[b] = self._beliefs.belief(b).nees(truth)[2] <= self._limit
        return consistent

    @property
    def reference(self) -> ReferenceBelief:
        """The reference belief of one environment after the current frame, where it is run."""
        reference = self.references[self.only_row("reference")]
        if reference is None:
            raise RuntimeError("there is no reference belief: use belief='reference' or report_both, and reset first")
        return reference


class TrueError(PaidRows):
    """The reward of a step is minus the squared true error of the filter's position, m^2.

    A filter cannot earn by claiming more than it knows, as it can by `InformationGain`. The reward needs the truth,
    which every simulator has: the observation does not contain it, and a policy that was trained on it runs without.

    `info` gains `reward_error`, at reset that of the start.

    Parameters
    ----------
    env : gymnasium.Env
        With `BeliefObservation` inside.
    weight : float
        Of the reward.
    keep_reward : bool
        Add it to the reward of the environment, instead of replacing that.

    Raises
    ------
    ValueError
        There is no filter in the loop, or the weight is not finite.
    """

    def __init__(self, env: Any, weight: float = 1.0, keep_reward: bool = False) -> None:
        super().__init__(env, ["error"])
        self._beliefs: FilterRows = self.needed("beliefs")
        self._weight, self._keep_reward = finite_number("weight", weight), keep_reward

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        super().reset(chosen, seeds, options)
        self.paid(chosen, {"error": -self._weight * self._squares()})

    def step(self, actions: Any, going: BoolArray) -> Step:
        """The reward is the error after the step."""
        rewards, terminated, truncated = self.rows.step(actions, going)
        paid = self.paid(going, {"error": -self._weight * self._squares()})
        return rewards + paid if self._keep_reward else paid, terminated, truncated

    def _squares(self) -> FloatArray:
        """Squared errors of all rows, m^2; (B,)."""
        errors = self._beliefs.poses[:, :3] - self.world.true_positions()
        return np.asarray(np.einsum("bi,bi->b", errors, errors))
