"""Which landmarks are tracked, and what is measured of them."""

import numpy as np
import pytest

from filters import StereoNoise
from filters.geometry import rotations
from stereo_slam_env.sensing.corruptions import IndependentPixels
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT
from stereo_slam_env.simulator.rays import obstacles, visible
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.scene import Box
from stereo_slam_env.world.vehicle import Head

from .vehicles import CAMERA, GREY, drive, scene_of, vehicle

SPINNING = Head(0.571, max_angles=(np.pi, 0.4), max_rates=(1000.0, 1000.0))
"""A head that looks anywhere at once."""


def cloud(count, seed=0):
    return np.random.default_rng(seed).uniform([-30, -5, -20], [30, 1.6, 170], size=(count, 3))


def seen_in(points, steps=0, *solids, commands=None, **options):
    """Observations and poses of a drive past points."""
    simulator = vehicle(scene_of(*solids, points_w=points), **options)
    frames = drive(simulator, [[0, 0]] * steps if commands is None else commands)
    return [frame.observation for frame in frames], [frame.truth for frame in frames]


def test_measurements_are_the_projection_of_the_true_points():
    points = cloud(800)
    observations, poses = seen_in(points, head=SPINNING, commands=[[0.3, -0.2], [-0.1, 0.5]], perturbation=1.0)
    for observation, pose in zip(observations, poses, strict=True):
        assert len(observation) > 20
        p_c = (points[observation.ids] - pose.position) @ rotations.matrix(pose.orientation)
        np.testing.assert_allclose(observation.uvd, CAMERA.project(p_c), atol=1e-6)


def test_tracks_are_kept_and_refilled_only_when_few_are_left():
    observations, _ = seen_in(cloud(4000), 120, policy={"max_landmarks": 90, "refill_below": 65})
    before, refills = set(observations[0].ids.tolist()), 0
    assert len(before) == 90
    for observation in observations[1:]:
        now = set(observation.ids.tolist())
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
    policy = {"max_landmarks": 300, "refill_below": 300, "revisit": revisit}
    ahead, away = [0.0, 0.0], [1.0, 0.0]
    (first, elsewhere, again), _ = seen_in(cloud(600), head=SPINNING, commands=[away, ahead], policy=policy)
    assert len(first) > 20
    assert not set(first.ids.tolist()) & set(elsewhere.ids.tolist())
    returned = set(first.ids.tolist()) & set(again.ids.tolist())
    assert len(returned) > 20 if revisit else not returned


def test_the_choice_of_landmarks_does_not_depend_on_the_noise():
    (one,), _ = seen_in(cloud(800), noise="pixels", sigma=1.0)
    (two,), _ = seen_in(cloud(800), noise="uvd", sigma=3.0)
    np.testing.assert_array_equal(one.ids, two.ids)
    assert one.v_right is not None
    assert two.v_right is None


@pytest.mark.parametrize("noise", ["pixels", "heavy-tailed", "quantised", "uvd"])
def test_errors_over_a_drive_have_the_declared_covariance(noise):
    simulator = vehicle(scene_of(points_w=cloud(6000)), noise=noise, sigma=1.0)
    points, errors = simulator.scenes[0].landmarks, []
    for frame in drive(simulator, [[0, 0]] * 190):
        p_c = (points[frame.observation.ids] - frame.truth.position) @ frame.truth.R_wc
        errors.append(frame.observation.uvd - CAMERA.project(p_c))
    errors, R = np.concatenate(errors), simulator._noise.stereo_noise.R
    kurtosis = 12.0 if noise == "heavy-tailed" else 3.0
    np.testing.assert_allclose(np.cov(errors.T), R, atol=5 * 2 * np.sqrt(kurtosis / 3 / len(errors)) * 1.1)
    np.testing.assert_allclose(errors.mean(axis=0), 0, atol=5 * 1.5 / np.sqrt(len(errors)))


def lasting_errors(frames=190, **rules):
    """Errors of each landmark in the frames it was measured in, [(n, 3)], px; what does not last is almost nothing."""
    simulator = vehicle(scene_of(points_w=cloud(6000)), noise="pixels", sigma=1e-9, lasting=0.7, **rules)
    points, errors = simulator.scenes[0].landmarks, {}
    for frame in drive(simulator, [[0, 0]] * frames):
        p_c = (points[frame.observation.ids] - frame.truth.position) @ frame.truth.R_wc
        for i, error in zip(frame.observation.ids.tolist(), frame.observation.uvd - CAMERA.project(p_c), strict=True):
            errors.setdefault(i, []).append(error)
    return [np.array(found) for found in errors.values()]


def test_errors_that_never_change_are_one_draw_for_each_landmark():
    errors = lasting_errors()
    assert max(np.ptp(each, axis=0).max() for each in errors) < 1e-6
    each = np.array([found[0] for found in errors])
    R = StereoNoise.independent_pixels(0.7).R
    assert len(each) > 200
    np.testing.assert_allclose(np.cov(each.T), R, atol=5 * 2 * 0.49 * np.sqrt(2 / len(each)))
    np.testing.assert_allclose(each.mean(axis=0), 0.0, atol=5 * 0.7 * np.sqrt(2 / len(each)))


def test_errors_with_a_time_are_a_gauss_markov_process():
    """Neighbouring frames correlate by exp(-dt / time); the variance is the same from the first sight on."""
    found = lasting_errors(lasting_time=0.5)
    then, now = (np.concatenate([each[part, :2] for each in found]).ravel() for part in (slice(-1), slice(1, None)))
    np.testing.assert_allclose((now @ then) / (then @ then), np.exp(-0.1 / 0.5), atol=5 / np.sqrt(len(now)))
    first = np.array([each[0] for each in found])[:, :2].ravel()
    np.testing.assert_allclose([first.std(), now.std()], 0.7, rtol=5 / np.sqrt(2 * len(first)))


@pytest.mark.parametrize("away", [1, 4])
def test_errors_with_a_time_go_on_while_a_landmark_is_out_of_sight(away):
    """The head looks elsewhere for some frames: what is left of an error is that of the whole time."""
    points, commands = cloud(6000), [[1.0, 0.0]] * away + [[0.0, 0.0]]
    options = {"head": SPINNING, "noise": "pixels", "lasting": 0.7, "lasting_time": 0.5}
    policy = {"max_landmarks": 3000, "refill_below": 3000, "revisit": True}
    observations, poses = seen_in(points, commands=commands, policy=policy, **options)
    before, after = {}, {}
    for errors, seen, pose in ((before, observations[0], poses[0]), (after, observations[-1], poses[-1])):
        found = seen.uvd - CAMERA.project((points[seen.ids] - pose.position) @ pose.R_wc)
        errors.update(zip(seen.ids.tolist(), found, strict=True))
    both = sorted(before.keys() & after.keys())
    then, now = (np.array([errors[i][:2] for i in both]).ravel() for errors in (before, after))
    assert len(both) > 300
    tolerance = 4.0 / np.sqrt(len(then))
    np.testing.assert_allclose((now @ then) / (then @ then), np.exp(-0.1 * (away + 1) / 0.5), atol=tolerance)
    np.testing.assert_allclose(now.std(), 0.7, rtol=tolerance)


def test_new_landmarks_are_drawn_in_proportion_to_the_disparity_from_where_the_camera_is():
    """It has driven 9.8 m, looking elsewhere; from there the near ones have 4 x the disparity of the far ones."""
    constant, steps = CAMERA.disparity_constant, 20
    z = 0.49 * steps + np.repeat([constant / 40.0, constant / 10.0], 1000)
    points = np.column_stack([np.zeros((2000, 2)), z])
    commands = [[1.0, 0.0]] * (steps - 1) + [[0.0, 0.0]]
    policy = {"max_landmarks": 40, "refill_below": 40}
    near = []
    for seed in range(12):
        observations, _ = seen_in(points, head=SPINNING, commands=commands, policy=policy, seed=seed)
        assert len(observations[-1]) == 40
        near += (observations[-1].ids < 1000).tolist()
    assert np.mean(near) == pytest.approx(0.8, abs=3.5 * np.sqrt(0.8 * 0.2 / len(near)))


def test_those_with_the_least_exponentials_by_their_disparity_are_drawn():
    """Weighted sampling without replacement: the keys of all that are in view, in their order."""
    points = cloud(3000)
    (everything,), _ = seen_in(points, policy={"max_landmarks": 3000, "refill_below": 3000})
    for most in (7, 40, 150):
        simulator = vehicle(scene_of(points_w=points), policy={"max_landmarks": most, "refill_below": most})
        keys = simulator.fleet.exponentials[0, : len(everything)] * points[everything.ids, 2]
        expected = np.sort(everything.ids[np.argsort(keys)[:most]])
        assert simulator.frame(0).observation.ids.tolist() == expected.tolist()


@pytest.mark.parametrize(("limit", "ids"), [("nearest", [0, 2]), ("farthest", [0, 1])])
def test_limits_of_range_belong_to_the_range(limit, ids):
    points = np.array([[0.0, 0.0, 20.0], [0.0, 0.0, 20.0 - 1e-6], [0.0, 0.0, 20.0 + 1e-6]])
    assert seen_in(points, policy={limit: 20.0})[0][0].ids.tolist() == ids


@pytest.mark.parametrize(
    ("axis", "edge", "inwards"),
    [(0, 2.0, 1.0), (0, CAMERA.width - 3.0, -1.0), (1, 2.0, 1.0), (1, CAMERA.height - 3.0, -1.0)],
    ids=["left", "right", "top", "bottom"],
)
def test_landmarks_keep_a_margin_to_all_edges_of_both_images(axis, edge, inwards):
    """A hundredth of a pixel within the 2 px is measured, beyond it not; the right eye sees what is left last."""
    d = CAMERA.disparity_constant / 5.0
    uvd = np.tile([CAMERA.cx, CAMERA.cy, d], (2, 1))
    uvd[:, axis] = edge + np.array([0.01, -0.01]) * inwards + (d if (axis, inwards) == (0, 1.0) else 0.0)
    assert seen_in(CAMERA.backproject(uvd))[0][0].ids.tolist() == [0]


def test_what_is_seen_is_in_view_and_hidden_by_nothing_wherever_the_head_looks_from():
    """From a camera that sways in all six degrees and turns, by the projection and the rays of its two eyes."""
    rng = np.random.default_rng(2)
    solids = [
        Box((z, x, 2.0), (0.5, 4.0, 4.0), yaw, GREY) for z, x, yaw in rng.uniform((5, -9, -2), (40, 9, 2), (25, 3))
    ]
    scene, frame = scene_of(*solids, points_w=cloud(2500)), WorldFrame(CAMERA_HEIGHT)
    policy = {"max_landmarks": 2500, "refill_below": 2500, "revisit": True}
    simulator = vehicle(scene, head=SPINNING, perturbation=40.0, policy=policy)
    points, hidden = simulator.scenes[0].landmarks, 0
    for seen in drive(simulator, rng.uniform(-0.3, 0.3, (8, 2))):
        p_c = (points - seen.truth.position) @ seen.truth.R_wc
        inside = CAMERA.in_view(CAMERA.project(p_c), margin=2.0) & (p_c[:, 2] >= 4.0) & (p_c[:, 2] <= 150.0)
        eyes = seen.truth.position + np.array([[0.0, 0.0, 0.0], [CAMERA.baseline, 0.0, 0.0]]) @ seen.truth.R_wc.T
        clear = visible(obstacles(solids), frame.to_scene(eyes), frame.to_scene(points))
        assert seen.observation.ids.tolist() == np.flatnonzero(inside & clear).tolist()
        hidden += (inside & ~clear).sum()
    assert hidden > 100
    assert np.abs(simulator.body(0).position[1]) > 0.1


def test_the_models_of_noise_that_are_compiled_draw_the_same_numbers():
    """`sensing.pixel_noise` is the model; the generator of the noise is the second that the landmarks' one spawns."""
    simulator = vehicle(scene_of(points_w=cloud(800)), noise="pixels", sigma=2.0)
    seen = simulator.frame(0).observation
    _, landmark, *_ = np.random.default_rng(1).spawn(4)
    true = CAMERA.project(simulator.scenes[0].landmarks[seen.ids])
    measured, v_right = IndependentPixels(2.0).corrupt(true, landmark.spawn(2)[1])
    np.testing.assert_allclose(seen.uvd, measured, rtol=1e-12)
    np.testing.assert_allclose(seen.v_right, v_right, rtol=1e-12)


def test_no_landmarks_is_an_empty_observation():
    assert len(seen_in(np.zeros((0, 3)))[0][0]) == 0
