"""A filter in the loop, and its belief in the observation (2 s)."""

from dataclasses import replace

import numpy as np
import pytest
from gymnasium.envs.classic_control import CartPoleEnv

from filters import ColouredNoise, LandmarkDrift, make_filter
from filters.engine.batch import goes_in_a_batch
from filters.geometry import rotations
from stereo_slam_env.envs import BeliefObservation, belief_observation
from stereo_slam_env.envs.belief_observation import assumed_noise
from stereo_slam_env.evaluation.filter_run import run_filter

from ..benchmark.small_recordings import small_recording
from .replayed import ReplayEnv, episode

MOTION = {"sigma_acceleration": 2.0, "sigma_angular_acceleration": 0.5}


@pytest.mark.parametrize(
    "name", ["shared-anchor", "right-invariant", "euclidean", "submaps", "dead-reckoning", "coloured-noise"]
)
def test_it_runs_the_filter_as_the_benchmark_does(name):
    recording = small_recording(frames=12)
    options = {} if name == "dead-reckoning" else {"motion": MOTION}
    if name == "coloured-noise":
        R = recording.noise.R
        recording = replace(recording, noise=ColouredNoise(R, 0.3 * R, LandmarkDrift(pixels=(0.2, 0.2, 0.1))))
    run = run_filter(recording, name, options)
    assert run.failure is None
    env = BeliefObservation(ReplayEnv(recording), name, options=options)
    seen, _, _ = episode(env)
    assert goes_in_a_batch(env.slam) or name != "coloured-noise"
    for key, values in (("position", run.positions), ("orientation", run.orientations)):
        np.testing.assert_array_equal([o[f"belief_{key}"] for o in seen], values.astype(np.float32))
    np.testing.assert_array_equal([o["belief_covariance"] for o in seen], run.pose_covariances.astype(np.float32))


def test_odometry_noise_and_options_reach_it():
    recording = small_recording(frames=6)
    own = np.array([o["belief_covariance"] for o in episode(BeliefObservation(ReplayEnv(recording)))[0]])
    for arguments in ({"use_odometry": False}, {"noise": 2.0}, {"options": {"motion": MOTION}}):
        other = [o["belief_covariance"] for o in episode(BeliefObservation(ReplayEnv(recording), **arguments))[0]]
        assert not np.allclose(other, own, rtol=1e-3, atol=0)


def test_noise_can_be_a_number_or_a_matrix():
    of_the_sensor = ReplayEnv().noise
    assert assumed_noise(None, of_the_sensor) is of_the_sensor
    np.testing.assert_array_equal(assumed_noise(2.0, of_the_sensor).R, [[4, 0, 4], [0, 4, 0], [4, 0, 8]])
    np.testing.assert_array_equal(assumed_noise(np.eye(3).tolist(), of_the_sensor).R, np.eye(3))


def test_landmarks_are_in_the_camera_frame_with_the_covariance_they_have_there():
    env = BeliefObservation(ReplayEnv(), max_landmarks=40)
    seen = episode(env, steps=8)[0][-1]
    slam, count = env.slam, int(seen["belief_mask"].sum())
    landmarks, pose = slam.landmarks, slam.pose
    R_wc = rotations.matrix(pose.orientation)
    assert count == len(landmarks.ids) > 20
    np.testing.assert_array_equal(seen["belief_landmark_ids"][:count], landmarks.ids)
    np.testing.assert_allclose(
        seen["belief_landmarks"][:count], (landmarks.positions - pose.position) @ R_wc, rtol=1e-5
    )
    J = np.zeros((3, 9))
    J[:, :3], J[:, 6:] = -R_wc.T, R_wc.T
    for k, i in enumerate(landmarks.ids):
        J[:, 3:6] = rotations.skew((landmarks.positions[k] - pose.position) @ R_wc)
        wanted = J @ slam.joint_covariance([i]) @ J.T
        np.testing.assert_allclose(seen["belief_landmark_covariances"][k], wanted, rtol=1e-4, atol=1e-5 * wanted.max())


def test_of_too_many_landmarks_the_nearest_are_shown():
    recording = small_recording(frames=4)
    everything = episode(BeliefObservation(ReplayEnv(recording), max_landmarks=40))[0][-1]
    few = episode(BeliefObservation(ReplayEnv(recording), max_landmarks=5))[0][-1]
    count = int(everything["belief_mask"].sum())
    distances = np.linalg.norm(everything["belief_landmarks"][:count], axis=1)
    nearest = np.sort(np.argsort(distances)[:5])
    assert few["belief_mask"].tolist() == [1] * 5
    for key in ("belief_landmark_ids", "belief_landmarks", "belief_landmark_covariances"):
        np.testing.assert_allclose(few[key], everything[key][nearest], rtol=1e-5)


def test_padding_and_a_filter_without_a_map():
    seen, _, infos = episode(BeliefObservation(ReplayEnv(), "dead-reckoning", max_landmarks=3), steps=2)
    for observation, info in zip(seen, infos, strict=True):
        assert observation["belief_landmark_ids"].tolist() == [-1, -1, -1]
        assert not any(observation[f"belief_{key}"].any() for key in ("mask", "landmarks", "landmark_covariances"))
        assert info["belief_map_size"] == 0


def test_the_report_of_the_frame_is_told():
    env = BeliefObservation(ReplayEnv())
    _, _, infos = episode(env, steps=3)
    assert infos[0]["belief_nis_dof"] == 0
    assert infos[-1]["belief_nis_dof"] == env.report.nis_dof == 3 * len(env.report.updated)
    assert infos[-1]["belief_nis"] == env.report.nis > 0
    assert infos[-1]["belief_map_size"] == len(env.slam.landmarks.ids)
    assert [info["time"] for info in infos] == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_what_is_beyond_the_bounds_is_clipped_and_what_is_at_infinity_left_out():
    env = BeliefObservation(ReplayEnv(), max_landmarks=40)
    env.reset(seed=0)
    state = env.slam.state
    state.blocks[state.parameter_block[:4], 2] = [1e-6, 0.0, -0.01, 1e-9]
    env.slam.state = state
    seen = env.step(env.action_space.sample())[0]
    assert env.observation_space.contains(seen)
    assert env.report.nis_dof < 3 * len(state.ids)


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("raise", "filter 'shared-anchor' failed in frame 3: ZeroDivisionError: division of something"),
        (
            "nan",
            "filter 'shared-anchor' failed in frame 3: ArithmeticError: the filter returned NaN or infinity in its",
        ),
    ],
)
def test_a_filter_that_breaks_down_is_named_with_frame_and_cause(monkeypatch, what, message):
    def made(*given, **options):
        slam = make_filter(*given, **options)
        update, frames = slam.update, []

        def breaking(observation):
            frames.append(0)
            if len(frames) == 4 and what == "raise":
                raise ZeroDivisionError("division of something\nby zero")
            if len(frames) == 4:
                state = slam.state
                slam.state = replace(state, camera=replace(state.camera, position=np.full(3, np.nan)))
            return update(observation)

        monkeypatch.setattr(slam, "update", breaking)
        return slam

    monkeypatch.setattr(belief_observation, "make_filter", made)
    with pytest.raises(RuntimeError) as caught:
        episode(BeliefObservation(ReplayEnv()))
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"filter": "shared-anker"}, "did you mean 'shared-anchor'"),
        ({"options": {"gat": 0.9}}, "option 'gat' is not one of filter 'shared-anchor', did you mean 'gate'"),
        ({"options": {"motion": {"sigma": 1.0}}}, "motion 'constant-velocity' has no setting 'sigma'"),
        ({"max_landmarks": 0}, "max_landmarks must be a whole number >= 1, got 0"),
        ({"noise": -1.0}, "noise must be a finite number > 0"),
        ({"noise": [[1.0]]}, r"R must have shape \(3, 3\)"),
    ],
)
def test_arguments_are_checked_when_it_is_made(arguments, message):
    with pytest.raises(ValueError, match=message):
        BeliefObservation(ReplayEnv(), **arguments)


def test_before_reset_there_is_nothing_to_ask():
    with pytest.raises(ValueError, match="BeliefObservation needs 'camera'"):
        BeliefObservation(CartPoleEnv())
    env = BeliefObservation(ReplayEnv())
    for name in ("belief", "report"):
        with pytest.raises(RuntimeError, match="reset the environment first"):
            getattr(env, name)


def test_a_held_action_is_that_of_every_frame_and_the_belief_that_of_the_last():
    seen, rewards, _ = episode(BeliefObservation(ReplayEnv()), steps=9)
    held, sums, _ = episode(BeliefObservation(ReplayEnv(), hold=3), steps=3)
    for every_third, observation in zip(seen[::3], held, strict=True):
        np.testing.assert_array_equal(observation["belief_covariance"], every_third["belief_covariance"])
        np.testing.assert_array_equal(observation["belief_landmarks"], every_third["belief_landmarks"])
    np.testing.assert_allclose(sums[1:], np.reshape(rewards[1:], (3, 3)).sum(axis=1), rtol=1e-12)
