"""One episode: what was measured, what the policy was told, and what happens when somebody fails (5 s)."""

import gymnasium as gym
import numpy as np
import pytest

from stereo_slam_env.envs import BeliefObservation, BeliefPanorama
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.policies import make_policy
from stereo_slam_env.policies.policy_rows import run_episode
from stereo_slam_env.recording.archive import packed_recording, unpacked_recording

OPTIONS = {"drop_unseen": False, "motion": "velocity-driven", "gate": None}
FRAMES = 12


class Watches:
    """Sweeps, and keeps what it was told."""

    def __init__(self):
        self.sweep, self.told, self.poses, self.chance = make_policy("sweep"), [], [], None

    def reset(self, env, rng):
        self.sweep.reset(env, rng)
        self.env, self.chance = env, rng.random()

    def act(self, observation):
        self.told.append(observation)
        self.poses.append(self.env.get_wrapper_attr("slam").pose)
        return self.sweep.act(observation)


@pytest.fixture
def env():
    env = gym.make("StereoSlam/Gaze-v0", route="right-turn", rig="qvga")
    yield BeliefPanorama(BeliefObservation(env, filter="shared-anchor", options=OPTIONS))
    env.close()


def test_a_run_over_the_recording_is_bit_for_bit_what_the_policy_heard(env):
    policy = Watches()
    episode = run_episode(env, policy, 3, frames=FRAMES)
    assert episode.failure is None
    assert len(episode.recording) == FRAMES
    assert {"uvd", "head", "belief_covariance", "panorama", "belief_sigmas"} <= set(policy.told[0])
    assert all(env.observation_space.contains(observation) for observation in policy.told)
    run = run_filter(unpacked_recording(packed_recording(episode.recording)), "shared-anchor", OPTIONS)
    np.testing.assert_array_equal(run.positions[:-1], [pose.position for pose in policy.poses])
    np.testing.assert_array_equal(run.pose_covariances[:-1], [pose.covariance for pose in policy.poses])
    np.testing.assert_array_equal(run.positions[-1], env.get_wrapper_attr("slam").pose.position)


def test_the_recording_knows_where_the_head_was(env):
    episode = run_episode(env, Watches(), 3, frames=FRAMES)
    pans = [frame.head[0] for frame in episode.recording.frames]
    assert pans[0] == 0.0
    assert pans[-1] > 0.5
    core = env.unwrapped
    for frame, body in zip(episode.recording.frames, episode.drive, strict=True):
        np.testing.assert_allclose(core.head.camera_pose(body, frame.head).position, frame.truth.position, atol=1e-12)


def test_same_seed_same_drive_and_same_chance_whoever_looks(env):
    watches = Watches()
    sweeping, straight = run_episode(env, watches, 4, frames=5), run_episode(env, make_policy("fixed"), 4, frames=5)
    again, other = Watches(), Watches()
    assert sweeping.drive_digest == straight.drive_digest == run_episode(env, again, 4, frames=5).drive_digest
    assert sweeping.drive_digest != run_episode(env, other, 5, frames=5).drive_digest
    assert watches.chance == again.chance != other.chance
    last = [episode.recording.frames[-1].truth.position for episode in (sweeping, straight)]
    assert 1e-3 < np.linalg.norm(last[0] - last[1]) < 0.6  # the arm of the head


def test_an_episode_ends_with_the_drive(env):
    told = []
    episode = run_episode(env, make_policy("fixed"), 0, progress=lambda done, of: told.append((done, of)))
    assert len(episode.recording) == env.unwrapped.route.frames
    assert told[0] == (1, 80)
    assert told[-1] == (80, 80)


def test_a_policy_that_fails_is_a_failure_with_its_frame_and_the_drive_goes_on(env):
    class Raises(Watches):
        def act(self, observation):
            if len(self.told) == 3:
                raise LookupError("nothing to look at\nat all")
            return super().act(observation)

    class Nothing(Watches):
        def act(self, observation):
            return np.full(2, np.nan, dtype=np.float32)

    episode = run_episode(env, Raises(), 3, frames=FRAMES)
    assert episode.failure == "frame 3: policy: LookupError: nothing to look at"
    assert episode.drive_digest == run_episode(env, Watches(), 3, frames=FRAMES).drive_digest
    assert run_episode(env, Nothing(), 3, frames=2).failure.startswith("frame 0: environment: ValueError: action")
    with pytest.raises(ValueError, match="must be one of the environments of this package"):
        run_episode(gym.make("CartPole-v1"), make_policy("fixed"), 0)


def test_a_filter_that_does_not_survive_is_a_failure_too():
    env = gym.make("StereoSlam/Gaze-v0", route="right-turn", rig="qvga")
    blind = BeliefObservation(env, filter="shared-anchor", options=OPTIONS, use_odometry=False)
    episode = run_episode(blind, make_policy("fixed"), 3, frames=FRAMES)
    env.close()
    assert episode.failure.startswith("frame 0: environment: RuntimeError: filter 'shared-anchor' failed in frame 1")
    assert len(episode.recording) == FRAMES
