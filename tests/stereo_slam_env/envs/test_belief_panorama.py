"""Where around the car the map is (2 s)."""

import numpy as np
import pytest

from filters import StereoNoise
from filters.engine.batch import RelativeLandmarks
from filters.geometry import rotations
from stereo_slam_env.envs import BeliefObservation, BeliefPanorama
from stereo_slam_env.envs.active_gaze import GazeTask
from stereo_slam_env.envs.belief_panorama import panoramas, share_in_view

from ..benchmark.small_recordings import CAMERA
from .replayed import ROWS, ReplayEnv, episode

SECTORS = 24


def looking(head=None, sectors=SECTORS, **belief):
    """The wrapped environment after a few frames, and its last observation."""
    env = BeliefPanorama(BeliefObservation(ReplayEnv(head=head), **belief), sectors)
    return env, episode(env, steps=6)[0][-1]


def one_by_one(belief, pan, tilt, sectors):
    """The same, a landmark at a time."""
    R_bc = rotations.exp([0.0, pan, 0.0]) @ rotations.exp([tilt, 0.0, 0.0])
    seen, inside = np.zeros((sectors, 4)), [[] for _ in range(sectors)]
    for k, p_c in enumerate(belief.points_c):
        x, y, z = R_bc @ p_c
        place = int((np.arctan2(x, z) + np.pi) / (2 * np.pi) * sectors) % sectors
        distance, C = np.linalg.norm(p_c), belief.relative_covariances[k]
        sight = p_c / distance
        along = sight @ C @ sight
        across = (np.trace(C) - along) / 2
        deep, wide = distance**2 * np.sqrt(2) / (CAMERA.fx * CAMERA.baseline), distance / CAMERA.fx  # of 1 px each eye
        told = 0.5 * np.log(1 + along / deep**2) + np.log(1 + across / wide**2)
        inside[place].append((told, np.arctan2(-y, np.hypot(x, z)), np.linalg.norm(p_c)))
    for row, found in zip(seen, inside, strict=True):
        if found:
            told, elevations, distances = map(np.array, zip(*found, strict=True))
            row[:2] = len(found) / ROWS, 0.1 * np.log(1 + told.sum())
            row[2:] = elevations.mean() / (np.pi / 2), 1 / (1 + distances.min() / 10)
    return seen


@pytest.mark.parametrize(("pan", "tilt"), [(0.0, 0.0), (0.7, 0.0), (-2.9, 0.3), (3.0, -0.2)])
@pytest.mark.parametrize("sectors", [3, 24])
def test_it_is_what_a_loop_over_landmarks_finds(pan, tilt, sectors):
    env, seen = looking(head=(pan, tilt), sectors=sectors)
    head = seen.get("head")
    wanted = one_by_one(env.get_wrapper_attr("belief"), float(head[0]), float(head[1]), sectors)
    assert np.count_nonzero(wanted[:, 0]) > (1 if sectors == 24 else 0)
    np.testing.assert_allclose(seen["panorama"][:, :4], wanted, rtol=1e-5, atol=1e-6)


def test_without_a_head_the_camera_looks_straight_ahead():
    _, seen = looking()
    _, same = looking(head=(0.0, 0.0))
    np.testing.assert_array_equal(seen["panorama"], same["panorama"])
    occupied = np.flatnonzero(seen["panorama"][:, 0])
    assert (np.abs(occupied + 0.5 - SECTORS / 2) < SECTORS / 4).all()  # all is ahead, in the middle rows


def test_what_is_in_view_is_the_horizontal_field_of_view():
    _, seen = looking()
    in_view = seen["panorama"][:, 4]
    width = 2 * np.pi / SECTORS
    angle = np.arctan((CAMERA.width - 1 - CAMERA.cx) / CAMERA.fx) + np.arctan(CAMERA.cx / CAMERA.fx)
    assert in_view.sum() * width == pytest.approx(angle, rel=1e-5)
    assert in_view[SECTORS // 2] == in_view[SECTORS // 2 - 1] == 1.0
    assert not in_view[[0, -1]].any()
    behind = share_in_view(CAMERA, np.pi, SECTORS)
    assert behind[0] == behind[-1] == 1.0
    assert share_in_view(CAMERA, 0.0, 3)[1] == pytest.approx(angle / (2 * np.pi / 3))


def test_what_was_in_view_is_remembered_for_some_seconds():
    env = BeliefPanorama(BeliefObservation(ReplayEnv(head=(0.0, 0.0))), SECTORS)
    seen = env.reset()[0]["panorama"]
    ahead = seen[:, 4] >= 0.5
    assert 0 < ahead.sum() < SECTORS
    np.testing.assert_array_equal(seen[:, 5], ~ahead)
    env.unwrapped.head = (np.pi / 2, 0.0)
    for _ in range(10):
        seen = env.step(env.action_space.sample())[0]["panorama"]
    assert env.unwrapped.frame.timestamp == pytest.approx(1.0)
    np.testing.assert_allclose(seen[ahead, 5], 1 - np.exp(-1.0 / 5.0), rtol=1e-6)
    assert seen[SECTORS * 3 // 4, 5] == 0.0
    np.testing.assert_array_equal(env.reset()[0]["panorama"][ahead, 5], 1.0)


def test_what_is_out_of_reach_does_not_count():
    env, seen = looking()
    belief = env.get_wrapper_attr("belief")
    distances = np.linalg.norm(belief.points_c, axis=1)
    middle = float(np.median(distances))
    near = episode(BeliefPanorama(BeliefObservation(ReplayEnv()), SECTORS, middle), steps=6)[0][-1]
    assert near["panorama"][:, 0].sum() * ROWS == pytest.approx((distances <= middle).sum())
    assert (near["panorama"][:, 1] <= seen["panorama"][:, 1]).all()
    np.testing.assert_array_equal(near["panorama"][:, 3], seen["panorama"][:, 3] * (near["panorama"][:, 3] > 0))


def test_without_a_reach_it_is_that_of_the_sensor():
    env = GazeTask(arguments={"visibility": 25.0}).make()
    env.reset(seed=0)
    for step in range(120):
        pan = np.sign(np.sin(0.1 * step))
        seen = env.step(np.array([pan, 0.0], dtype=np.float32))[0]
    belief = env.get_wrapper_attr("belief")
    within = np.linalg.norm(belief.points_c, axis=1) <= 25.0
    assert seen["panorama"][:, 0].sum() * len(seen["mask"]) == pytest.approx(within.sum())
    assert 0 < within.sum() < len(within)
    env.close()


def test_a_sharper_camera_has_more_to_tell_and_what_is_known_relative_to_it_little():
    env, _ = looking()
    points, covariances = env.get_wrapper_attr("belief").points_c, env.get_wrapper_attr("belief").relative_covariances
    count = len(points)
    maps = RelativeLandmarks(np.array([0, count]), np.arange(count), points, covariances, np.ones(count, dtype=bool))
    rough, fine = (
        panoramas(maps, np.zeros((1, 2)), CAMERA, StereoNoise.independent_pixels(sigma), SECTORS, ROWS, np.inf)[0]
        for sigma in (100.0, 1.0)
    )
    assert fine[:, 1].sum() > 2 * rough[:, 1].sum() > 0


def test_the_sigmas_are_those_of_the_pose():
    env, seen = looking()
    wanted = np.sqrt(np.diag(env.get_wrapper_attr("slam").pose.covariance))
    np.testing.assert_allclose(seen["belief_sigmas"], wanted, rtol=1e-6)


def test_every_observation_is_in_the_space_also_without_a_map():
    for name in ("shared-anchor", "dead-reckoning"):
        env = BeliefPanorama(BeliefObservation(ReplayEnv(), name))
        for seen in episode(env)[0]:
            assert env.observation_space.contains(seen)
    assert not seen["panorama"][:, :4].any()


def test_arguments_are_checked_when_it_is_made():
    with pytest.raises(ValueError, match="sectors must be a whole number >= 3, got 2"):
        BeliefPanorama(BeliefObservation(ReplayEnv()), 2)
    with pytest.raises(ValueError, match="reach must be a finite number > 0, got -1"):
        BeliefPanorama(BeliefObservation(ReplayEnv()), reach=-1.0)
    with pytest.raises(ValueError, match="BeliefPanorama needs 'slam': wrap BeliefObservation with it"):
        BeliefPanorama(ReplayEnv())
