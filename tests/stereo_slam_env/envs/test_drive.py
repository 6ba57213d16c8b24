"""StereoSlam/Drive-v0 as Gymnasium, and as the source of truthful frames. About 40 s."""

import copy
import json
import pickle
import subprocess
import sys
import warnings
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence

import stereo_slam_env
from filters.contract.inputs import StereoObservation
from filters.contract.noise import StereoNoise
from filters.geometry import rotations
from stereo_slam_env.envs.arguments import DriveOptions
from stereo_slam_env.envs.drive import StereoDriveEnv
from stereo_slam_env.world.routes import FRAME_PERIOD, ROUTES

ROOT = Path(__file__).parents[3]
ID = "StereoSlam/Drive-v0"
QUICK = {"route": "right-turn", "rig": "qvga"}
IDLE = np.zeros(2, dtype=np.float32)


@pytest.fixture
def make():
    made = []

    def _make(**kwargs):
        made.append(StereoDriveEnv(**{"policy": "route", **kwargs}))
        return made[-1]

    yield _make
    for env in made:
        env.close()


def rollout(env, seed, steps, actions=None):
    results = [env.reset(seed=seed)]
    for k in range(steps):
        results.append(env.step(IDLE if actions is None else actions[k]))
        if results[-1][2]:
            break
    return results


# --- Gymnasium -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("policy", "render_images"), [("route", False), ("agent", False), ("route", True)])
def test_check_env_passes_without_a_warning(policy, render_images):
    env = gym.make(ID, disable_env_checker=True, policy=policy, render_images=render_images, **QUICK).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=policy == "agent" or render_images)


def test_registration_is_idempotent_and_json_able():
    stereo_slam_env._register(ID, "envs.somewhere", "Else", 1)
    spec = gym.spec(ID)
    assert spec.entry_point == "stereo_slam_env.envs.drive:StereoDriveEnv"
    assert spec.max_episode_steps == 1200
    env = gym.make(f"stereo_slam_env:{ID}", **QUICK)
    assert gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json())).spec == env.spec
    env.close()


def test_an_id_with_its_package_needs_no_import():
    code = f"import gymnasium as gym; gym.make('stereo_slam_env:{ID}', route='right-turn', rig='qvga').close()"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=200)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("policy", ["route", "agent"])
def test_same_seed_same_bits(make, policy):
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 2)).astype(np.float32)
    one, two = (rollout(make(policy=policy, **QUICK), 5, 20, actions) for _ in range(2))
    assert data_equivalence(one, two, exact=True)
    other = rollout(make(policy=policy, **QUICK), 6, 20, actions)
    assert not data_equivalence(one, other, exact=True)


def test_resetting_does_not_depend_on_what_was_before(make):
    env = make(**QUICK)
    first = rollout(env, 5, 5)
    rollout(env, 9, 3)
    assert data_equivalence(first, rollout(env, 5, 5), exact=True)


@pytest.mark.parametrize(("mode", "how"), [("sync", {}), ("async", {"context": "forkserver"})])
def test_vector_environments_give_the_same_bits(make, mode, how):
    vector = gym.make_vec(ID, num_envs=2, vectorization_mode=mode, vector_kwargs=how, policy="route", **QUICK)
    try:
        observation, info = vector.reset(seed=[11, 12])
        frames = [(observation, info)]
        for _ in range(3):
            observation, _, _, _, info = vector.step(np.zeros((2, 2), dtype=np.float32))
            frames.append((copy.deepcopy(observation), info))
    finally:
        vector.close()
    for index, seed in enumerate([11, 12]):
        alone = rollout(make(**QUICK), seed, 3)
        for (observation, info), single in zip(frames, alone, strict=True):
            for key, value in single[0].items():
                np.testing.assert_array_equal(observation[key][index], value)
            for key, value in single[-1].items():
                np.testing.assert_array_equal(info[key][index], value)


def test_reset_and_step_have_the_same_info_keys_and_shapes(make):
    results = rollout(make(noise="uvd", **QUICK), 1, 2)
    shapes = [{k: (np.shape(v), type(v)) for k, v in r[-1].items()} for r in results]
    assert shapes[0] == shapes[1] == shapes[2]


def test_pickle_and_deepcopy_make_a_fresh_environment(make):
    env = make(noise="uvd", **QUICK)
    expected = rollout(env, 3, 2)
    for clone in (pickle.loads(pickle.dumps(env)), copy.deepcopy(env)):
        assert clone.options == env.options
        assert data_equivalence(rollout(clone, 3, 2), expected, exact=True)
        clone.close()


def test_close_unused_and_twice(make):
    make(**QUICK).close()
    env = make(**QUICK)
    env.reset(seed=0)
    env.close()
    env.close()
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(IDLE)


def test_memory_is_flat_over_resets(make):
    def resident_mb():
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * 4096 / 1e6

    env = make(render_mode="rgb_array", **QUICK)
    for seed in range(2):
        env.reset(seed=seed)
        env.render()
    before = resident_mb()
    for seed in range(4):
        env.reset(seed=seed)
    env.render()
    assert resident_mb() - before < 20


# --- arguments -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        (
            {"route": "moon"},
            r"route must be one of 'straight', 'right-turn', 'town', .*'random-grid' or a KITTI pose file, got 'moon'",
        ),
        ({"rig": "imax"}, r"rig must be one of 'reference', 'vga', .*'oak-d' or a calibration file .*, got 'imax'"),
        ({"noise": "cauchy"}, r"noise must be one of 'pixels', 'uvd', 'heavy-tailed', 'quantised', got 'cauchy'"),
        ({"policy": "me"}, r"policy must be one of 'agent', 'route', got 'me'"),
        ({"sensor": "lidar"}, r"sensor must be one of 'landmarks', 'images', got 'lidar'"),
        ({"sigma": 0.0}, r"sigma must be a finite number > 0, got 0.0"),
        ({"sigma": "big"}, r"sigma must be a number > 0, got 'big'"),
        ({"max_landmarks": 0}, r"max_landmarks must be a whole number from 1 to 10000, got 0"),
        ({"max_landmarks": 10, "refill_below": 11}, r"refill_below must be a whole number from 0 to 10, got 11"),
        ({"odometry_sigma_angular": -1}, r"odometry_sigma_angular must be a finite number >= 0, got -1"),
        ({"render_images": "yes"}, r"render_images must be one of True, False, got 'yes'"),
        ({"blank_from": -1.0}, r"blank_from must be a finite number >= 0, got -1.0"),
        ({"supersample": 2.0}, r"supersample must be a whole number from 1 to 4, got 2.0"),
        ({"render_mode": "ansi"}, r"render_mode must be None, 'rgb_array' or 'human', got 'ansi'"),
        ({"sgima": 1.0}, r"unexpected keyword argument 'sgima', did you mean 'sigma'\? Known: route, "),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_a_wrong_argument_gets_one_clear_line(kwargs, message):
    with pytest.raises(ValueError, match=message) as error:
        StereoDriveEnv(**kwargs)
    assert "\n" not in str(error.value)


def test_an_unknown_argument_is_a_type_error_too():
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
        StereoDriveEnv(frameskip=4)


def test_reset_options_are_refused(make):
    with pytest.raises(ValueError, match="reset takes no options but scene, and for vectors reset_mask, got 'seed'"):
        make(**QUICK).reset(options={"seed": 3})


def test_the_documentation_names_every_argument_key_and_info():
    page = StereoDriveEnv.__doc__
    env = StereoDriveEnv(render_images=True, **QUICK)
    for name, default in DriveOptions().as_dict().items():
        shown = f'"{default}"' if isinstance(default, str) else str(default)
        assert f"| `{name}` | `{shown}` |" in page
    for key in env.observation_space:
        assert f"`{key}`" in page
    _, info = StereoDriveEnv(**QUICK).reset(seed=0)
    for key in info:
        assert key in page
    json.dumps(env.options.as_dict())


# --- truth -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("policy", ["route", "agent"])
def test_the_truth_obeys_equation_6_and_starts_at_the_origin_of_w(make, policy):
    env = make(policy=policy, **QUICK)
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (30, 2))
    infos = [result[-1] for result in rollout(env, 2, 30, actions)]
    np.testing.assert_array_equal(infos[0]["truth_position"], 0)
    np.testing.assert_array_equal(infos[0]["truth_orientation"], [0, 0, 0, 1])
    for before, after in pairwise(infos):
        moved = before["truth_position"] + after["truth_linear_velocity"] * FRAME_PERIOD
        np.testing.assert_allclose(after["truth_position"], moved, atol=1e-12)
        turn = rotations.exp_quaternion(after["truth_angular_velocity"] * FRAME_PERIOD)
        turned = rotations.multiply(before["truth_orientation"], turn)
        np.testing.assert_allclose(after["truth_orientation"], turned, atol=1e-12)


def test_observations_are_the_projection_of_true_landmarks_plus_declared_noise(make):
    env = make(route="right-turn", sigma=0.5)
    errors = []
    env.reset(seed=1)
    over = False
    landmarks = env.landmark_truth()
    while not over:
        frame = env.frame
        rows = np.searchsorted(landmarks.ids, frame.observation.ids)
        p_c = (landmarks.positions[rows] - frame.truth.position) @ rotations.matrix(frame.truth.orientation)
        errors.append(frame.observation.uvd - env.camera.project(p_c))
        over = env.step(IDLE)[2]
    errors = np.concatenate(errors)
    assert len(errors) > 4000
    assert env.noise == StereoNoise.independent_pixels(0.5)
    np.testing.assert_allclose(np.cov(errors.T), env.noise.R, atol=5 * 0.5 / np.sqrt(len(errors)))


def test_the_frame_is_the_observation_in_full_precision(make):
    env = make(**QUICK)
    observation, info = env.reset(seed=1)
    observation, *_, info = env.step(IDLE)
    seen = stereo_slam_env.stereo_observation(observation, info)
    assert isinstance(seen, StereoObservation)
    np.testing.assert_array_equal(seen.ids, env.frame.observation.ids)
    np.testing.assert_allclose(seen.uvd, env.frame.observation.uvd, rtol=1e-6)
    np.testing.assert_array_equal(seen.v_right, env.frame.observation.v_right)
    odometry = env.frame.odometry
    np.testing.assert_allclose(observation["odometry"], np.concatenate([odometry.linear, odometry.angular]), rtol=1e-6)
    assert env.frame.timestamp == info["time"] == FRAME_PERIOD


def test_odometry_is_the_body_velocity_of_the_step(make):
    env = make(odometry_sigma_linear=0.0, odometry_sigma_angular=0.0, **QUICK)
    env.reset(seed=1)
    assert env.frame.odometry is None
    for _ in range(20):
        before = env.frame.truth
        env.step(IDLE)
        odometry, velocity = env.frame.odometry, env.frame.truth_velocity
        half_way = rotations.matrix(before.orientation) @ rotations.exp(0.05 * velocity.angular)
        np.testing.assert_allclose(half_way @ odometry.linear, velocity.linear, atol=1e-12)
        np.testing.assert_allclose(odometry.angular, velocity.angular, atol=1e-12)


def test_the_start_is_told_with_the_errors_it_declares(make):
    env = make(**QUICK)
    errors = []
    for seed in range(12):
        _, info = env.reset(seed=seed)
        start = env.start
        np.testing.assert_array_equal(start.position, info["truth_position"])
        linear = start.linear_velocity - info["truth_linear_velocity"]
        errors.append(np.concatenate([linear, start.angular_velocity - info["truth_angular_velocity"]]))
    sigmas = np.sqrt(np.diag(start.covariance))
    np.testing.assert_allclose(sigmas, np.repeat([1e-6, 1e-6, 0.5, 0.05], 3))
    normalised = np.array(errors) / sigmas[6:]
    assert (normalised**2).mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / normalised.size))


def test_the_sensor_does_not_change_the_street_or_the_drive(make):
    one, two = make(route="right-turn"), make(noise="uvd", sigma=3.0, max_landmarks=10, **QUICK)
    truths = [[r[-1]["truth_position"] for r in rollout(env, 4, 10)] for env in (one, two)]
    np.testing.assert_array_equal(*truths)
    np.testing.assert_array_equal(one.landmark_truth().positions, two.landmark_truth().positions)


def test_solids_hide_landmarks(make):
    """Of the landmarks in the field of view many are behind houses, and those are never reported."""
    env = make(route="right-turn", max_landmarks=3000, refill_below=3000, sigma=1e-6)
    env.reset(seed=1)
    landmarks = env.landmark_truth()
    uvd = env.camera.project(landmarks.positions)
    depth = env.camera.disparity_constant / uvd[:, 2]
    in_view = env.camera.in_view(uvd, 2.0) & (depth > 4) & (depth < 150)
    seen = np.isin(landmarks.ids, env.frame.observation.ids)
    assert not (seen & ~in_view).any()
    assert 0.1 < seen[in_view].mean() < 0.7


@pytest.mark.slow
def test_visible_landmarks_are_where_the_renderer_draws_a_surface(make):
    """The depth image agrees with the true depth of the landmarks the rays call visible. About 2 s."""
    env = make(route="right-turn", render_mode="rgb_array", rig="vga")
    env.reset(seed=1)
    depth = env.rows.world.images(0).depth
    landmarks, observation = env.landmark_truth(), env.frame.observation
    positions = landmarks.positions[np.searchsorted(landmarks.ids, observation.ids)]
    u, v, _ = np.rint(env.camera.project(positions)).astype(int).T
    error = np.abs(depth[v, u] / positions[:, 2] - 1)
    assert np.median(error) < 0.01
    assert (error < 0.05).mean() > 0.85


# --- the drive -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("route", sorted(ROUTES))
def test_a_scripted_drive_ends_at_the_end_of_its_route_without_a_collision(make, route):
    env = make(route=route)
    results = rollout(env, 0, 3000)
    nominal = env.unwrapped.route
    assert len(results) == nominal.frames
    _, _, terminated, truncated, info = results[-1]
    assert terminated
    assert not truncated
    assert not any(r[-1]["collision"] for r in results)
    assert info["distance"] == pytest.approx(nominal.length, rel=0.03)
    np.testing.assert_allclose(info["truth_position"], nominal.positions[-1], atol=1.0)
    tracked = np.array([r[0]["mask"].sum() for r in results])
    assert np.median(tracked) >= 60
    assert tracked.min() >= 30
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(IDLE)


def test_the_ups_and_downs_of_a_scripted_drive_are_no_collision(make):
    """In this one the camera sinks by 0.28 m after 2.4 s."""
    env = make(route="straight", policy="route", rig="qvga")
    env.reset(seed=57)
    collisions = [env.step(np.zeros(2, dtype=np.float32))[-1]["collision"] for _ in range(30)]
    assert not any(collisions)


def test_an_agent_that_steers_into_the_parked_cars_collides(make):
    env = make(route="straight", policy="agent", rig="qvga")
    results = rollout(env, 0, 200, [np.array([0.5, 0.25], dtype=np.float32)] * 200)
    _, reward, terminated, _, info = results[-1]
    assert terminated
    assert info["collision"]
    assert info["reward_collision"] == -10
    assert reward < -9


def test_an_agent_that_keeps_its_lane_reaches_the_end(make):
    env = make(route="straight", policy="agent", rig="qvga", slowest=0.0)
    results = rollout(env, 0, 300)
    assert results[-1][2]
    assert not results[-1][-1]["collision"]
    progress = sum(r[-1]["reward_progress"] for r in results)
    assert progress == pytest.approx(0.1 * ROUTES["straight"]().length, rel=0.01)


def test_the_reward_is_the_sum_of_its_terms(make):
    for _, reward, _, _, info in rollout(make(**QUICK), 0, 5)[1:]:
        assert isinstance(reward, float)
        assert reward == sum(value for key, value in info.items() if key.startswith("reward_"))


@pytest.mark.parametrize("action", [[np.nan, 0.0], [0.0], "left"])
def test_a_wrong_action_is_refused_and_changes_nothing(make, action):
    env = make(policy="agent", **QUICK)
    env.reset(seed=0)
    frame = env.frame
    with pytest.raises(ValueError, match="action must"):
        env.step(action)
    assert env.frame is frame


def test_the_action_is_not_changed(make):
    env = make(policy="agent", **QUICK)
    env.reset(seed=0)
    action = np.array([3.0, -2.0], dtype=np.float32)
    env.step(action)
    np.testing.assert_array_equal(action, [3.0, -2.0])


# --- pictures --------------------------------------------------------------------------------------------------------


def test_rendered_images_are_in_the_observation(make):
    env = make(render_images=True, **QUICK)
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    assert observation["left"].shape == (240, 320, 3)
    assert not np.array_equal(observation["left"], observation["right"])
    assert observation["left"].std() > 20
    later = env.step(IDLE)[0]
    assert not np.array_equal(observation["left"], later["left"])


def test_rgb_array_shows_both_views_with_the_landmarks(make):
    env = make(render_mode="rgb_array", render_images=True, **QUICK)
    observation, _ = env.reset(seed=0)
    picture = env.render()
    assert picture.dtype == np.uint8
    assert picture.shape == (260, 644, 3)
    drawn = (picture[-240:, :320] != observation["left"]).any(axis=2)
    u, v = np.rint(env.frame.observation.uvd[:, :2]).astype(int).T
    inside = (u >= 0) & (u < 320) & (v >= 0) & (v < 240)
    assert drawn[v[inside], u[inside]].mean() > 0.95
    assert 0.01 < drawn.mean() < 0.35
    np.testing.assert_array_equal(picture, env.render())


def test_a_loop_is_driven_to_its_end_and_every_metre_counts_once(make):
    env = make(route="loop", rig="qvga", max_landmarks=5)
    env.reset(seed=0)
    rewards, over, steps = [], False, 0
    while not over:
        _, _, over, _, info = env.step(IDLE)
        rewards.append(info["reward_progress"])
        steps += 1
    assert steps == env.route.frames - 1
    assert sum(rewards) == pytest.approx(0.1 * env.route.length, rel=1e-6)
    assert max(np.abs(rewards)) < 0.1
