"""StereoSlam/Drive-v0 as Gymnasium, and as the source of truthful frames. About 40 s."""

import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence

import stereo_slam_env
from filters.contract.inputs import StereoObservation
from filters.contract.noise import StereoNoise
from filters.geometry import rotations
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


def test_same_seed_same_bits(make):
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 2)).astype(np.float32)
    one, two, other = (rollout(make(policy="agent", **QUICK), seed, 20, actions) for seed in (5, 5, 6))
    assert data_equivalence(one, two, exact=True)
    assert not data_equivalence(one, other, exact=True)


# --- arguments -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"route": "moon"}, r"route must be one of 'straight', .*'random-grid' or a KITTI pose file, got 'moon'"),
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


# --- truth -----------------------------------------------------------------------------------------------------------


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


def test_the_sensor_does_not_change_the_street_or_the_drive(make):
    one, two = make(route="right-turn"), make(noise="uvd", sigma=3.0, max_landmarks=10, **QUICK)
    truths = [[r[-1]["truth_position"] for r in rollout(env, 4, 10)] for env in (one, two)]
    np.testing.assert_array_equal(*truths)
    np.testing.assert_array_equal(one.landmark_truth().positions, two.landmark_truth().positions)


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
    results, nominal = rollout(env, 0, 3000), env.route
    assert len(results) == nominal.frames
    _, _, terminated, truncated, info = results[-1]
    assert terminated
    assert not truncated
    assert not any(r[-1]["collision"] for r in results)
    assert sum(r[-1]["reward_progress"] for r in results) == pytest.approx(0.1 * nominal.length, abs=0.05)
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
    assert not any(env.step(IDLE)[-1]["collision"] for _ in range(30))


def test_an_agent_that_steers_into_the_parked_cars_collides(make):
    env = make(route="straight", policy="agent", rig="qvga")
    results = rollout(env, 0, 200, [np.array([0.5, 0.25], dtype=np.float32)] * 200)
    _, reward, terminated, _, info = results[-1]
    assert terminated
    assert info["collision"]
    assert info["reward_collision"] == -10
    assert reward < -9


# --- pictures --------------------------------------------------------------------------------------------------------


def test_both_views_are_in_the_observation_and_rendered_with_the_landmarks(make):
    env = make(render_mode="rgb_array", render_images=True, **QUICK)
    observation, _ = env.reset(seed=0)
    assert observation["left"].shape == (240, 320, 3)
    assert observation["left"].std() > 20
    assert not np.array_equal(observation["left"], observation["right"])
    picture = env.render()
    assert (picture.dtype, picture.shape) == (np.uint8, (260, 644, 3))
    drawn = (picture[-240:, :320] != observation["left"]).any(axis=2)
    u, v = np.rint(env.frame.observation.uvd[:, :2]).astype(int).T
    inside = (u >= 0) & (u < 320) & (v >= 0) & (v < 240)
    assert drawn[v[inside], u[inside]].mean() > 0.95
    assert 0.01 < drawn.mean() < 0.35
    np.testing.assert_array_equal(picture, env.render())
    assert not np.array_equal(observation["left"], env.step(IDLE)[0]["left"])
