"""The picture of the map shows what the filter knows, from above, in the frame of the car (5 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from filters.geometry import rotations
from stereo_slam_env.envs import BeliefObservation, LandmarkMap, restore, snapshot
from stereo_slam_env.envs.landmark_map import DENSITY, PATH, SEEN, SIGMA

SIZE, REACH = 48, 30.0
BELIEF = {"options": {"drop_unseen": False, "motion": "velocity-driven"}}
WORLD = {"route": "loop", "surroundings": "street", "visibility": 40.0}
TURN = np.array([0.6, 0.3], np.float32)


def single():
    return LandmarkMap(BeliefObservation(gym.make("StereoSlam/Gaze-v0", **WORLD), **BELIEF), SIZE, REACH)


def after(env, steps, seed=3):
    observation, _ = env.reset(seed=seed)
    action = TURN if not hasattr(env, "num_envs") else np.tile(TURN, (env.num_envs, 1))
    for _ in range(steps):
        observation = env.step(action)[0]
    return observation["map"]


def pixels_of(points_w, env):
    """Row and column of points in the picture, one after the other."""
    slam, angles = env.get_wrapper_attr("slam"), env.unwrapped.head_angles
    R_cw = rotations.matrix(slam.pose.orientation).T
    turn_b = rotations.exp(np.array([0.0, angles[0], 0.0])) @ rotations.exp(np.array([angles[1], 0.0, 0.0]))
    found = set()
    for point in points_w:
        right, _, ahead = turn_b @ R_cw @ (point - slam.pose.position)
        row, column = (int(np.floor(0.5 * SIZE * (1.0 + along / REACH))) for along in (-ahead, right))
        if 0 <= row < SIZE and 0 <= column < SIZE:
            found.add((row, column))
    return found


def lit(channel):
    return set(zip(*(axis.tolist() for axis in np.nonzero(channel)), strict=True))


def test_landmarks_are_where_the_filter_has_them_in_the_frame_of_the_car():
    env = single()
    picture = after(env, 60)
    slam, frame = env.get_wrapper_attr("slam"), env.unwrapped.frame
    landmarks = slam.landmarks
    assert lit(picture[..., DENSITY]) == lit(picture[..., SIGMA]) == pixels_of(landmarks.positions, env)
    assert len(lit(picture[..., DENSITY])) > 15
    in_view = landmarks.positions[np.isin(landmarks.ids, frame.observation.ids)]
    assert lit(picture[..., SEEN]) == pixels_of(in_view, env)
    assert 0 < len(lit(picture[..., SEEN])) < len(lit(picture[..., DENSITY]))
    env.close()


def test_the_path_leads_from_behind_to_the_car():
    env = single()
    path = after(env, 60)[..., PATH]
    rows = sorted(row for row, _ in lit(path))
    assert abs(rows[0] - SIZE // 2) <= 1
    assert rows[-1] == SIZE - 1 or rows[-1] > 0.9 * SIZE  # 29 m were driven
    env.close()


def test_one_is_as_many_and_a_snapshot_has_the_path():
    env = single()
    vector = LandmarkMap(gym.make_vec("StereoSlam/Gaze-v0", num_envs=2, belief=BELIEF, **WORLD), SIZE, REACH)
    many = after(vector, 20)
    np.testing.assert_array_equal(after(env, 20), many[0])
    assert not np.array_equal(many[0], many[1])
    kept = snapshot(env)
    ahead = env.step(TURN)[0]["map"]
    restore(env, kept)
    np.testing.assert_array_equal(env.step(TURN)[0]["map"], ahead)
    env.close()
    vector.close()


@pytest.mark.parametrize(
    ("wrong", "message"), [({"size": 4}, "size must be"), ({"reach": 0.0}, "reach must be"), ({"path": 0}, "path must")]
)
def test_an_impossible_argument_gets_one_clear_line(wrong, message):
    env = BeliefObservation(gym.make("StereoSlam/Gaze-v0"), **BELIEF)
    with pytest.raises(ValueError, match=message):
        LandmarkMap(env, **wrong)
    with pytest.raises(ValueError, match="LandmarkMap needs 'slam'"):
        LandmarkMap(gym.make("StereoSlam/Gaze-v0"))
