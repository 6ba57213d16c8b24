"""StereoSlam/Drive-v0 with the sensor "images": the same drive, seen through the front end. About 15 s."""

import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence

import stereo_slam_env
from filters.geometry import rotations
from stereo_slam_env.envs.drive import StereoDriveEnv
from stereo_slam_env.envs.recorder import record
from stereo_slam_env.evaluation.filter_run import run_filter

from ..rendering.planes import skip_where_missing

ROOT = Path(__file__).resolve().parents[3]
ID = "StereoSlam/Drive-v0"
DRIVE = {"route": "right-turn", "rig": "qvga", "policy": "route"}
IMAGES = {**DRIVE, "sensor": "images"}
QUICK = {**IMAGES, "surroundings": "corridor"}
"""Little to draw and little to see: for what does not depend on it."""
IDLE = np.zeros(2, dtype=np.float32)


@pytest.fixture
def make():
    made = []

    def _make(**kwargs):
        made.append(StereoDriveEnv(**{**IMAGES, **kwargs}))
        return made[-1]

    yield _make
    for env in made:
        env.close()


@pytest.fixture(scope="module")
def recording():
    """2 s of the drive."""
    return record(IMAGES, seed=1, frames=20)


def rollout(env, seed, steps):
    return [env.reset(seed=seed), *(env.step(IDLE) for _ in range(steps))]


def poses(results):
    return [np.concatenate([r[-1]["truth_position"], r[-1]["truth_orientation"]]) for r in results]


# --- Gymnasium -------------------------------------------------------------------------------------------------------


def test_check_env_passes_without_a_warning():
    env = gym.make(ID, disable_env_checker=True, **QUICK).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=True)


DIGEST = """
import hashlib, sys
import numpy as np
from stereo_slam_env.envs.recorder import record
digest = hashlib.sha256()
for frame in record({arguments}, seed=5, frames=3).frames:
    seen = frame.observation
    for part in (seen.ids, seen.uvd, seen.R, frame.truth.position):
        digest.update(np.ascontiguousarray(part).tobytes())
digest = digest.hexdigest()
print(digest)
"""


def test_same_seed_same_bits_also_in_another_process():
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "17"}
    code, here = DIGEST.format(arguments=IMAGES), {}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    exec(code, here)
    assert done.stdout.split() == [here["digest"]]


def test_an_episode_does_not_depend_on_the_one_before(make):
    env = make(**QUICK)
    first = rollout(env, 5, 2)
    rollout(env, 9, 0)
    assert data_equivalence(first, rollout(env, 5, 2), exact=True)


# --- what is measured ------------------------------------------------------------------------------------------------


def test_covariances_go_with_the_observation(make):
    env = make(sigma=1e-3)  # of the other sensor
    for observation, *_, info in rollout(env, 1, 2):
        assert observation in env.observation_space
        assert observation["mask"].sum() > 10
        assert info["R_measured"]
        seen = stereo_slam_env.stereo_observation(observation, info)
        assert seen.R.shape == (len(seen), 3, 3)
        assert (np.linalg.eigvalsh(seen.R) > 0).all()
        padding = observation["mask"] == 0
        np.testing.assert_array_equal(info["R"][padding], 0.0)
    np.testing.assert_array_equal(seen.R, env.frame.observation.R)
    np.testing.assert_allclose(seen.uvd, env.frame.observation.uvd, rtol=1e-6)


def test_measurements_are_those_of_points_on_surfaces(recording):
    truth, errors = recording.landmarks, []
    assert (np.diff(truth.ids) > 0).all()
    for frame in recording.frames:
        seen = frame.observation
        _, i, j = np.intersect1d(seen.ids, truth.ids, return_indices=True)
        p_c = (truth.positions[j] - frame.truth.position) @ rotations.matrix(frame.truth.orientation)
        errors.append(seen.uvd[i] - recording.camera.project(p_c))
    errors = np.concatenate(errors)
    measured = sum(len(frame.observation) for frame in recording.frames)
    assert len(errors) > 0.4 * measured  # the render does not tell what is at the edges of things
    assert (np.abs(np.median(errors, axis=0)) < 0.1).all()
    assert (np.median(np.abs(errors), axis=0) < 0.3).all()


def test_the_landmark_truth_grows_and_never_changes(make):
    env = make()
    with pytest.raises(RuntimeError, match="reset the environment first"):
        env.landmark_truth()
    env.reset(seed=1)
    before = env.landmark_truth()
    counts = [len(before.ids)]
    for _ in range(5):
        env.step(IDLE)
        now = env.landmark_truth()
        np.testing.assert_array_equal(now.ids[: counts[-1]], before.ids)
        np.testing.assert_array_equal(now.positions[: counts[-1]], before.positions)
        counts.append(len(now.ids))
        before = now
    assert counts[-1] > counts[0] > 10


def test_corners_on_bodies_that_move_are_told_apart_from_landmarks(make):
    env = make(route="straight", moving_cars=12, pedestrians=12)
    rollout(env, 1, 3)
    assert len(env.moving_ids) > 1
    assert (np.diff(env.moving_ids) > 0).all()
    assert not np.isin(env.moving_ids, env.landmark_truth().ids).any()
    still = make(**QUICK)
    still.reset(seed=0)
    assert len(still.moving_ids) == 0


def test_only_images_have_a_front_end_to_look_at(make):
    env = make(sensor="landmarks")
    env.reset(seed=0)
    for look in (lambda: env.tracked, lambda: env.moving_ids):
        with pytest.raises(RuntimeError, match="use sensor='images'"):
            look()
    env = make(**QUICK)
    env.reset(seed=0)
    np.testing.assert_array_equal(env.tracked.observation.ids, env.frame.observation.ids)


def test_a_filter_ends_near_the_truth(recording):
    run = run_filter(recording, "inverse-depth", common_options={"gate": 0.99, "consensus": True}, use_odometry=False)
    assert run.failure is None
    travelled = np.linalg.norm(np.diff(run.true_positions, axis=0), axis=1).sum()
    assert travelled > 7.0
    assert np.linalg.norm(run.positions[-1] - run.true_positions[-1]) < 0.02 * travelled


# --- the drive -------------------------------------------------------------------------------------------------------


def test_the_sensor_changes_neither_the_drive_nor_the_pictures(make):
    seen = make(render_images=True)
    given = make(render_images=True, sensor="landmarks")
    one, two = rollout(seen, 4, 3), rollout(given, 4, 3)
    np.testing.assert_array_equal(poses(one), poses(two))
    for (first, *_), (second, *_) in zip(one, two, strict=True):
        for key in ("left", "right", "odometry"):
            np.testing.assert_array_equal(first[key], second[key])
    for part in ("linear_velocity", "angular_velocity", "covariance"):
        np.testing.assert_array_equal(getattr(seen.start, part), getattr(given.start, part))


def test_randomise_changes_the_pictures_and_not_the_drive(make):
    plain, random = (rollout(make(render_images=True, randomise=way), 4, 2) for way in (False, True))
    np.testing.assert_array_equal(poses(plain), poses(random))
    for (first, *_), (second, *_) in zip(plain, random, strict=True):
        assert np.abs(first["left"].astype(float) - second["left"]).mean() > 2.0


# --- the other renderer ----------------------------------------------------------------------------------------------


def test_gl_sees_the_same_drive_with_other_bits(make):
    skip_where_missing("gl")
    tiny, fast = rollout(make(), 3, 2), rollout(make(renderer="gl"), 3, 2)
    np.testing.assert_array_equal(poses(tiny), poses(fast))
    assert not np.array_equal(tiny[-1][0]["uvd"], fast[-1][0]["uvd"])
    assert data_equivalence(fast, rollout(make(renderer="gl"), 3, 2), exact=True)


def test_a_missing_gl_gets_one_clear_line(make, missing_gl):
    env = make(renderer="gl")
    with pytest.raises((ImportError, RuntimeError), match=re.escape(missing_gl)) as error:
        env.reset(seed=0)
    assert "\n" not in str(error.value)
