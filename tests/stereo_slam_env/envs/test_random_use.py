"""Any sequence of calls to an environment, legal or not, keeps its promises (hypothesis draws the sequences; 10 s)."""

from __future__ import annotations

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import stereo_slam_env  # noqa: F401 (registers the environments)
from stereo_slam_env.envs import BeliefObservation, InformationGain

QUICK = {"route": "right-turn", "rig": "qvga", "surroundings": "groves", "max_landmarks": 12}
MAKERS = {
    "drive": lambda: gym.make("StereoSlam/Drive-v0", disable_env_checker=True, policy="agent", **QUICK).unwrapped,
    "route": lambda: gym.make("StereoSlam/Drive-v0", disable_env_checker=True, policy="route", **QUICK).unwrapped,
    "gaze": lambda: gym.make("StereoSlam/Gaze-v0", disable_env_checker=True, **QUICK).unwrapped,
    "drive and gaze": lambda: gym.make("StereoSlam/DriveGaze-v0", disable_env_checker=True, **QUICK).unwrapped,
    "belief": lambda: BeliefObservation(MAKERS["gaze"](), max_landmarks=12),
    "information": lambda: InformationGain(BeliefObservation(MAKERS["drive and gaze"](), filter="shared-anchor")),
}

numbers = st.floats(-1e6, 1e6, width=32) | st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-30, 3.4e38])
calls = st.one_of(
    st.tuples(st.just("step"), st.lists(numbers, min_size=4, max_size=4), st.integers(1, 12)),
    st.tuples(st.just("step"), st.lists(numbers, min_size=4, max_size=4), st.just(1)),
    st.tuples(st.just("reset"), st.none() | st.integers(0, 2**31)),
    st.tuples(st.just("close")),
    st.tuples(st.just("remake"), st.sampled_from(["pickle", "deepcopy"])),
    st.tuples(st.just("refuse"), st.integers(0, 7)),
    st.tuples(st.just("look")),
)
sequences = st.lists(calls, min_size=4, max_size=20)


class Session:
    """An environment, and what is known of the episode in it: seed and actions, or that there is none."""

    def __init__(self, make) -> None:
        self.make = make
        self.env = make()
        self.seed: int | None = None
        self.actions: list[np.ndarray] = []
        self.running = self.reset_before = False
        self.keys: set[str] = set()
        self.last: object = None

    @property
    def size(self) -> int:
        return self.env.action_space.shape[0]

    def reset(self, seed: int | None) -> None:
        observation, info = self.env.reset(seed=seed)
        # Without a seed the generator goes on from where it was, which a fresh environment does not know.
        self.seed, self.actions, self.running, self.reset_before = seed, [], True, True
        self.look_at(observation, info)

    def step(self, command: list[float], times: int) -> None:
        action = np.array(command[: self.size], dtype=np.float32)
        before = action.copy()
        for _ in range(times):
            if not self.running:
                with pytest.raises(RuntimeError, match="reset"):
                    self.env.step(action)
                return
            observation, reward, terminated, truncated, info = self.env.step(action)
            np.testing.assert_array_equal(action, before)
            self.actions.append(before)
            assert np.isfinite(reward)
            assert truncated is False
            self.running = not terminated
            self.look_at(observation, info)

    def look_at(self, observation, info) -> None:
        assert self.env.observation_space.contains(observation)
        self.keys = self.keys or set(info)
        assert set(info) == self.keys
        for name, value in info.items():
            assert np.isfinite(value).all() or name.startswith("truth"), name
        self.last = observation

    def close(self) -> None:
        self.env.close()
        self.running = False

    def remake(self, how: str) -> None:
        """The copy is a fresh environment with the same arguments; the original goes on."""
        twin = pickle.loads(pickle.dumps(self.env)) if how == "pickle" else copy.deepcopy(self.env)
        try:
            assert twin.observation_space == self.env.observation_space
            with pytest.raises(RuntimeError, match="reset"):
                twin.step(np.zeros(self.size, dtype=np.float32))
        finally:
            twin.close()

    def refuse(self, which: int) -> None:
        """A call with bad input raises `ValueError`, in one line, and changes nothing."""
        bad_actions = (
            np.full(self.size, np.nan, dtype=np.float32),
            np.full(self.size, np.inf, dtype=np.float32),
            np.zeros(self.size + 1, dtype=np.float32),
            np.zeros((self.size, 1), dtype=np.float32),
            None,
            "left",
        )
        attempts = [*(lambda action=action: self.env.step(action) for action in bad_actions)]
        attempts += [
            lambda: self.env.reset(options={"weather": "rain"}),
            lambda: self.env.reset(seed=3, options={"a": 1}),
        ]
        if not self.running and which < len(bad_actions):
            return  # refused for another reason
        state = self.env.unwrapped.np_random.bit_generator.state if self.reset_before else None
        with pytest.raises(ValueError, match=r"\A[^\n]+\Z"):
            attempts[which]()
        if state is not None:
            assert self.env.unwrapped.np_random.bit_generator.state == state

    def look(self) -> None:
        """Properties say what they know or that a reset is missing; looking changes nothing."""
        core = self.env.unwrapped
        if not self.reset_before:
            with pytest.raises(RuntimeError, match="reset"):
                _ = core.frame
            return
        truth = core.frame.truth
        assert np.isfinite([*truth.position, *truth.orientation, *core.head_angles]).all()
        assert (np.diff(core.landmark_truth().ids) > 0).all()

    def run(self, sequence: list[tuple]) -> None:
        try:
            for name, *arguments in sequence:
                getattr(self, name)(*arguments)
            self.replay()
        finally:
            self.env.close()
            self.env.close()

    def replay(self) -> None:
        """What a session left behind makes no difference: a fresh environment comes to the same observation."""
        if self.seed is None or self.last is None:
            return
        fresh = self.make()
        try:
            observation, _ = fresh.reset(seed=self.seed)
            for action in self.actions:
                observation = fresh.step(action)[0]
            assert data_equivalence(observation, self.last)
        finally:
            fresh.close()


drawn = settings(
    deadline=None, derandomize=True, suppress_health_check=list(HealthCheck), database=None, print_blob=False
)


@pytest.mark.parametrize("name", sorted(MAKERS))
@settings(drawn, max_examples=12)
@given(sequence=sequences)
def test_random_sequences_of_calls(name: str, sequence: list[tuple]) -> None:
    Session(MAKERS[name]).run(sequence)
