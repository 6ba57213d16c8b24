"""Which landmarks are tracked, and what is measured of them."""

import numpy as np
import pytest

from filters import Pose
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from stereo_slam_env.recording.recording import LandmarkTruth
from stereo_slam_env.sensing.pixel_noise import IndependentPixels, IndependentUvd
from stereo_slam_env.sensing.rigs import RIGS
from stereo_slam_env.sensing.sensors import LandmarkSensor, TrackingPolicy

CAMERA = RIGS["reference"]
START = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))


def everything(pose, points):
    return np.ones(len(points), dtype=bool)


def cloud(count, seed=0):
    rng = np.random.default_rng(seed)
    positions = rng.uniform([-30, -5, -20], [30, 3, 170], size=(count, 3))
    return LandmarkTruth(np.arange(count, dtype=np.int64) * 3 + 5, positions)


def sensor_of(landmarks, visible=everything, noise=None, seed=1, **policy):
    return LandmarkSensor(
        CAMERA, noise or IndependentUvd(1e-9), landmarks, visible, TrackingPolicy(**policy), np.random.default_rng(seed)
    )


def test_measurements_are_the_projection_of_the_true_points():
    landmarks = cloud(800)
    pose = Pose(np.array([1.0, -0.3, 6.0]), rotations.exp_quaternion([0.02, 0.3, -0.01]))
    observation = sensor_of(landmarks).observe(pose)
    index = (observation.ids - 5) // 3
    p_c = (landmarks.positions[index] - pose.position) @ rotations.matrix(pose.orientation)
    np.testing.assert_allclose(observation.uvd, CAMERA.project(p_c), atol=1e-6)


def test_everything_measured_is_in_both_images_and_in_range():
    observation = sensor_of(cloud(3000), max_landmarks=2000, refill_below=2000).observe(START)
    assert len(observation) > 200
    assert CAMERA.in_view(observation.uvd, margin=2.0 - 1e-6).all()
    depth = CAMERA.disparity_constant / observation.uvd[:, 2]
    assert depth.min() >= 4.0 - 1e-6
    assert depth.max() <= 150.0 + 1e-6
    assert depth.max() > 120


def test_ids_ascend_and_come_from_the_map():
    landmarks = cloud(800)
    ids = sensor_of(landmarks).observe(START).ids
    assert (np.diff(ids) > 0).all()
    assert np.isin(ids, landmarks.ids).all()


def test_hidden_landmarks_are_not_measured():
    def left_half(pose, points):
        return points[:, 0] < 0

    landmarks = cloud(800)
    observation = sensor_of(landmarks, left_half).observe(START)
    assert len(observation) > 20
    assert (landmarks.positions[(observation.ids - 5) // 3, 0] < 0).all()


def test_tracks_are_kept_and_refilled_only_when_few_are_left():
    sensor = sensor_of(cloud(4000), max_landmarks=90, refill_below=65)
    before = set(sensor.observe(START).ids.tolist())
    assert len(before) == 90
    refills = 0
    for step in range(1, 60):
        now = set(sensor.observe(Pose(np.array([0.0, 0.0, 0.5 * step]), START.orientation)).ids.tolist())
        kept, new = now & before, now - before
        if new:
            refills += 1
            assert len(kept) < 65
            assert len(now) == 90
        else:
            assert len(kept) >= 65
        before = now
    assert refills >= 2


@pytest.mark.parametrize("revisit", [False, True])
def test_a_lost_landmark_returns_only_if_revisits_are_asked_for(revisit):
    sensor = sensor_of(cloud(300), max_landmarks=300, refill_below=300, revisit=revisit)
    first = set(sensor.observe(START).ids.tolist())
    assert first
    away = Pose(np.zeros(3), rotations.exp_quaternion([0.0, np.pi, 0.0]))
    sensor.observe(away)
    again = set(sensor.observe(START).ids.tolist())
    assert (again == first) if revisit else not (again & first)


def test_new_landmarks_are_drawn_in_proportion_to_disparity():
    """Two groups, near with disparity 4 x that of far, one drawn at a time: near wins in 4 of 5 draws. About 1 s."""
    constant = CAMERA.disparity_constant
    near_z, far_z = constant / 40.0, constant / 10.0
    positions = np.array([[0.0, 0.0, near_z]] * 10 + [[0.0, 0.0, far_z]] * 10)
    landmarks = LandmarkTruth(np.arange(20, dtype=np.int64), positions)
    draws = [
        sensor_of(landmarks, seed=seed, max_landmarks=1, refill_below=1).observe(START).ids[0] < 10
        for seed in range(1500)
    ]
    assert np.mean(draws) == pytest.approx(0.8, abs=4 * np.sqrt(0.8 * 0.2 / 1500))


def test_the_choice_of_landmarks_does_not_depend_on_the_noise():
    one, two = (sensor_of(cloud(800), noise=noise).observe(START)
                for noise in (IndependentPixels(1.0), IndependentUvd(3.0)))  # fmt: skip
    np.testing.assert_array_equal(one.ids, two.ids)
    assert one.v_right is not None
    assert two.v_right is None


def test_errors_over_a_drive_have_the_declared_covariance():
    landmarks, noise = cloud(4000), IndependentPixels(1.0)
    sensor = sensor_of(landmarks, noise=noise)
    errors = []
    for step in range(100):
        pose = Pose(np.array([0.0, 0.0, 0.5 * step]), START.orientation)
        observation = sensor.observe(pose)
        errors.append(observation.uvd - sensor.project(pose)[(observation.ids - 5) // 3])
    errors = np.concatenate(errors)
    np.testing.assert_allclose(np.cov(errors.T), noise.stereo_noise.R, atol=5 * 2 / np.sqrt(len(errors)))
    np.testing.assert_allclose(errors.mean(axis=0), 0, atol=5 * 1.5 / np.sqrt(len(errors)))


def test_no_landmarks_is_an_empty_observation():
    assert len(sensor_of(LandmarkTruth(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))).observe(START)) == 0


def test_the_presets_are_plausible_rigs():
    for camera in RIGS.values():
        assert isinstance(camera, StereoCamera)
        assert 0.4 * camera.width < camera.cx < 0.6 * camera.width
