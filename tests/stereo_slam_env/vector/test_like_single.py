"""A native vector of three environments gives what three single ones give (5 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.vector.belief import LockstepBelief

QUICK = {"route": "right-turn", "rig": "qvga", "max_landmarks": 20}
STEPS, COUNT = 25, 3
TOLERANCES = {"uvd": 1e-6, "v_right": 1e-6}
"""px; numbers are otherwise equal to `EXACT`, those of single precision to its last digit."""
EXACT = 1e-12
SEEN = {"uvd", "ids", "mask", "v_right", "reward_tracking"}
"""What depends on the landmarks that are seen."""
CASES = {
    "drive": ("Drive", {}),
    "scripted drive": ("Drive", {"policy": "route"}),
    "corridor": ("Drive", {"surroundings": "corridor", "observe_ids": False}),
    "gaze": ("Gaze", {}),
    "street": ("Gaze", {"surroundings": "street"}),
    "field": ("Gaze", {"surroundings": "field", "revisit": False}),
    "uvd": ("Gaze", {"noise": "uvd"}),
    "quantised": ("Gaze", {"noise": "quantised"}),
    "heavy-tailed": ("Gaze", {"noise": "heavy-tailed"}),
    "heavy-tailed drive": ("Drive", {"noise": "heavy-tailed", "randomise": True}),
    "drive and gaze": ("DriveGaze", {}),
    "scripted drive and gaze": ("DriveGaze", {"policy": "route", "max_landmarks": 60}),
    "other weights": ("DriveGaze", {"progress_weight": 2.0, "effort_weight": 1.0, "tracking_weight": 3.0}),
}


class Comparison:
    """Three episodes side by side. Where an environment once saw other landmarks, only its motion is compared on."""

    def __init__(self, name, options):
        self.vector = gym.make_vec(name, num_envs=COUNT, max_episode_steps=STEPS - 5, **options)
        self.singles = [gym.make(name, max_episode_steps=STEPS - 5, **options) for _ in range(COUNT)]
        self.over = [False] * COUNT
        self.same = [True] * COUNT

    def reset(self, seed):
        observation, info = self.vector.reset(seed=seed)
        for b, single in enumerate(self.singles):
            self._compare(b, observation, info, *single.reset(seed=seed + b))

    def step(self, actions):
        observation, rewards, *flags, info = self.vector.step(actions)
        for b, single in enumerate(self.singles):
            if self.over[b]:
                self.same[b] = True
                expected = (*single.reset(), 0.0, False, False)
                self._compare(b, observation, info, *expected[:2])
            else:
                seen, *rest, said = single.step(actions[b])
                self._compare(b, observation, info, seen, said)
                expected = (seen, said, *rest)
            if self.same[b]:
                assert rewards[b] == pytest.approx(expected[2], abs=EXACT)
            assert [flag[b] for flag in flags] == list(expected[3:])
            self.over[b] = expected[3] or expected[4]

    def _compare(self, b, observation, info, seen, said):
        assert observation.keys() == seen.keys()
        assert {key for key in info if not key.startswith("_")} == said.keys()
        self.same[b] &= np.array_equal(observation["mask"][b], seen["mask"])
        self.same[b] &= "ids" not in seen or np.array_equal(observation["ids"][b], seen["ids"])
        for ours, single in ((observation, seen), (info, said)):
            for key, value in single.items():
                assert ours[key][b].shape == value.shape
                assert ours[key].dtype == value.dtype
                if self.same[b] or key not in SEEN:
                    last_digit = 1e-6 if value.dtype == np.float32 else 0.0
                    limit = TOLERANCES.get(key, EXACT)
                    np.testing.assert_allclose(ours[key][b], value, rtol=last_digit, atol=limit, err_msg=key)
        for key in said:
            assert info[f"_{key}"].all()


@pytest.mark.parametrize("case", CASES)
def test_a_vector_is_like_single_environments(case):
    name, options = CASES[case]
    pair = Comparison(f"StereoSlam/{name}-v0", {**QUICK, **options})
    pair.reset(seed=5)
    rng = np.random.default_rng(0)
    agreeing = 0
    for _ in range(STEPS):
        pair.step(rng.uniform(-0.6, 0.6, pair.vector.action_space.shape).astype(np.float32))
        agreeing += sum(pair.same)
    for single in pair.singles:
        single.close()
    assert agreeing >= STEPS * COUNT / 3  # one grazing ray may make an episode another one


def test_collisions_and_the_end_of_the_route():
    """Until the car hits something, or leaves the arena, or arrives."""
    for name, action in (("Drive", (1.0, 0.1)), ("DriveGaze", (1.0, -0.2, 1.0, -1.0)), ("Gaze", (0.3, 0.1))):
        options = {**QUICK, "surroundings": "street"}
        vector = gym.make_vec(f"StereoSlam/{name}-v0", num_envs=COUNT, **options)
        vector.reset(seed=0)
        ends = [None] * COUNT
        actions = np.tile(np.array(action, dtype=np.float32), (COUNT, 1))
        for k in range(1, 1000):
            _, rewards, terminated, _, info = vector.step(actions)
            for b in np.flatnonzero(terminated):
                ends[b] = ends[b] or (k, info["collision"][b], info["is_success"][b], rewards[b])
            if all(ends):
                break
        for b, end in enumerate(ends):
            single = gym.make(f"StereoSlam/{name}-v0", **options)
            single.reset(seed=b)
            steps = ((k, *single.step(actions[b])) for k in range(1, 1000))
            k, _, reward, *_, info = next(step for step in steps if step[3])
            assert end[:3] == (k, info["collision"], info["is_success"])
            assert end[3] == pytest.approx(reward, abs=0.05)  # but for a landmark more or less
            single.close()


def test_the_start_of_a_filter_is_the_same(monkeypatch):
    starts = []
    begin = LockstepBelief.begin
    monkeypatch.setattr(
        LockstepBelief, "begin", lambda self, b, start: (starts.append(start), begin(self, b, start))[1]
    )
    vector = gym.make_vec("StereoSlam/Gaze-v0", num_envs=2, belief={"filter": "inverse-depth"}, **QUICK)
    vector.reset(seed=8)
    assert len(starts) == 2
    for b, start in enumerate(starts):
        single = gym.make("StereoSlam/Gaze-v0", **QUICK).unwrapped
        single.reset(seed=8 + b)
        assert np.linalg.norm(start.linear_velocity) > 1.0
        np.testing.assert_allclose(start.linear_velocity, single.start.linear_velocity, atol=EXACT)
        np.testing.assert_allclose(start.angular_velocity, single.start.angular_velocity, atol=EXACT)
        np.testing.assert_array_equal(start.covariance, single.start.covariance)
        single.close()
