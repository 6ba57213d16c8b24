"""Trajectory metrics against known motions, and against evo on published results (5 s, most of it evo)."""

import copy

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.files.readers import read_poses

from ..real_data import real_data

TURN, SHIFT = Rotation.from_euler("zyx", [20.0, 130.0, -40.0], degrees=True), np.array([3.0, -5.0, 7.0])


def test_alignment_never_mirrors_or_scales():
    path = np.cumsum(np.random.default_rng(0).standard_normal((40, 3)), axis=0)
    for image in (path * [1.0, 1.0, -1.0], 2.0 * path):
        assert metrics.ate_rigid(path, image) > 0.1 * metrics.root_mean_square(path - path.mean(axis=0))


def test_the_residual_on_a_line_is_defined_all_the_same():
    line = np.outer(np.arange(5.0), [0.0, 0.0, 1.0])
    sideways = line[:, [2, 1, 0]] + [0.0, 4.0, 0.0]
    assert metrics.ate_rigid(sideways, line) == pytest.approx(0.0, abs=1e-12)


def test_rigid_error_ignores_a_motion_and_the_unaligned_one_does_not():
    t = np.linspace(0.0, 3.0, 50)
    curve = np.column_stack([10 * np.sin(t), t, 20 * t])
    assert metrics.ate_rigid(TURN.apply(curve) + SHIFT, curve) == pytest.approx(0.0, abs=1e-9)
    assert metrics.ate_unaligned(curve + np.array([3.0, 0.0, 4.0]), curve) == pytest.approx(5.0)


def test_drift_is_the_last_error_over_the_length_of_the_way():
    way = np.column_stack([np.zeros(5), np.zeros(5), 10.0 * np.arange(5)])
    estimate = way + np.outer(np.arange(5) / 4, [0.3, 0.4, 0.0])
    assert metrics.path_length(way) == 40.0
    assert metrics.end_drift_percent(estimate, way) == pytest.approx(100 * 0.5 / 40)
    with pytest.raises(ValueError, match="does not move"):
        metrics.end_drift_percent(estimate, 0 * way)


def test_rotation_errors_are_angles_whatever_the_sign_of_the_quaternion():
    reference = Rotation.from_rotvec([[0.1, 0.2, 0.3], [1.0, 0.0, 0.0]])
    estimate = reference * Rotation.from_rotvec([[0.0, 0.05, 0.0], [0.0, 0.0, -0.2]])
    np.testing.assert_allclose(metrics.rotation_errors(-estimate.as_quat(), reference.as_quat()), [0.05, 0.2])


@pytest.mark.parametrize(
    ("estimate", "complaint"),
    [(np.zeros((4, 3)), "4 and 5 positions"), (np.full((5, 3), np.nan), "finite"), (np.zeros((5, 2)), "shape")],
)
def test_wrong_trajectories_are_refused(estimate, complaint):
    with pytest.raises(ValueError, match=complaint):
        metrics.ate_unaligned(estimate, np.zeros((5, 3)))


def turning_drive(rows=200, speed=0.5):
    """A made-up drive with turns, and an estimate of it that drifts: positions and orientations of both."""
    rng = np.random.default_rng(4)
    yaw = np.cumsum(0.02 * np.sin(np.arange(rows) / 15.0))
    true_turn = Rotation.from_euler("yxz", np.column_stack([yaw, 0.02 * np.sin(yaw), 0.01 * np.cos(yaw)]))
    truth = np.cumsum(speed * true_turn.apply([0.0, 0.0, 1.0]), axis=0)
    turn = true_turn * Rotation.from_rotvec(np.cumsum(2e-3 * rng.standard_normal((rows, 3)), axis=0))
    return truth + np.cumsum(0.02 * rng.standard_normal((rows, 3)), axis=0), turn.as_quat(), truth, true_turn.as_quat()


def test_segments_start_at_every_tenth_row_and_end_just_beyond_their_length():
    way = np.outer(np.arange(31.0), [0.0, 0.0, 1.0])
    lengths, first, last = metrics.segment_pairs(way, (5.0, 12.5))
    np.testing.assert_array_equal(lengths, [5.0, 5.0, 5.0, 12.5, 12.5])
    np.testing.assert_array_equal(first, [0, 10, 20, 0, 10])
    np.testing.assert_array_equal(last, [6, 16, 26, 13, 23])
    p, q, truth, true_q = turning_drive(rows=9)  # shorter than every segment
    assert len(metrics.segment_errors(p, q, truth, true_q)) == 0


def test_lengths_are_those_of_kitti_where_they_fit_and_shorter_ones_elsewhere():
    assert metrics.segment_lengths(3700.0) == tuple(range(100, 900, 100))
    assert metrics.segment_lengths(350.0) == (100.0, 200.0, 300.0)
    assert metrics.segment_lengths(115.0) == (5.0, 10.0, 25.0, 50.0)
    assert metrics.segment_lengths(7.0) == ()
    assert metrics.segment_lengths(metrics.SHORT_PATH) == (100.0,)
    assert metrics.segment_lengths(0.99 * metrics.SHORT_PATH) == (5.0, 10.0, 25.0, 50.0)
    assert metrics.segment_lengths(20.0) == (5.0, 10.0)


def test_a_scale_error_and_a_steady_turn_have_their_relative_errors():
    way = np.outer(np.arange(301.0), [0.0, 0.0, 1.0])
    straight = np.tile([0.0, 0.0, 0.0, 1.0], (301, 1))
    errors = metrics.segment_errors(1.02 * way, straight, way, straight)
    np.testing.assert_array_equal(np.unique(errors.lengths), [100.0, 200.0])
    np.testing.assert_allclose(errors.translation_percent, 2.0 * (errors.lengths + 1) / errors.lengths)
    np.testing.assert_allclose(errors.rotation_deg_per_100m, 0.0, atol=1e-9)
    turning = Rotation.from_rotvec(np.outer(np.deg2rad(0.01 * np.arange(301)), [0.0, 1.0, 0.0])).as_quat()
    errors = metrics.segment_errors(way, turning, way, straight)
    np.testing.assert_allclose(errors.rotation_deg_per_100m, (errors.lengths + 1) / errors.lengths)


def test_relative_errors_do_not_see_where_the_drive_began():
    p, q, truth, true_q = turning_drive()
    moved = metrics.segment_errors(TURN.apply(p) + SHIFT, (TURN * Rotation.from_quat(q)).as_quat(), truth, true_q)
    errors = metrics.segment_errors(p, q, truth, true_q)
    np.testing.assert_allclose(moved.translation_percent, errors.translation_percent, rtol=1e-9)
    np.testing.assert_allclose(moved.rotation_deg_per_100m, errors.rotation_deg_per_100m, rtol=1e-9)


def assert_evo_agrees(p, q, truth, true_q):
    """Absolute errors with and without alignment, rotation angles, and relative errors of the same pairs: to 1e-6."""
    pytest.importorskip("evo", reason="needs the extra evo")
    from evo.core import lie_algebra, trajectory
    from evo.core import metrics as evo

    def path(positions, orientations):
        return trajectory.PosePath3D(positions, np.roll(orientations, 1, axis=1))  # evo: wxyz

    def ape(relation, align=False):
        estimate, reference = copy.deepcopy(path(p, q)), path(truth, true_q)
        if align:
            estimate.align(reference, correct_scale=False)
        error = evo.APE(relation)
        error.process_data((reference, estimate))
        return error.get_statistic(evo.StatisticsType.rmse)

    angles = metrics.rotation_errors(q, true_q)
    assert metrics.ate_unaligned(p, truth) == pytest.approx(ape(evo.PoseRelation.translation_part), abs=1e-6)
    assert metrics.ate_rigid(p, truth) == pytest.approx(ape(evo.PoseRelation.translation_part, align=True), abs=1e-6)
    assert metrics.root_mean_square(angles) == pytest.approx(ape(evo.PoseRelation.rotation_angle_rad), abs=1e-6)
    reference, estimate = path(truth, true_q), path(p, q)
    assert metrics.path_length(truth) == pytest.approx(reference.path_length, rel=1e-9)

    lengths, first, last = metrics.segment_pairs(truth, metrics.segment_lengths(metrics.path_length(truth)))
    translation, rotation = metrics.relative_errors(p, q, truth, true_q, first, last)
    some = slice(None, None, 1 + len(first) // 400)  # evo takes a millisecond a pair
    theirs = [
        evo.RPE.rpe_base(*(poses[row] for poses in (reference.poses_se3, estimate.poses_se3) for row in (i, j)))
        for i, j in zip(first[some], last[some], strict=True)
    ]
    assert len(lengths) > 20
    np.testing.assert_allclose(translation[some], [np.linalg.norm(E[:3, 3]) for E in theirs], atol=1e-6)
    np.testing.assert_allclose(rotation[some], [lie_algebra.so3_log_angle(E[:3, :3]) for E in theirs], atol=1e-6)


def test_evo_agrees_on_a_made_up_drive():
    assert_evo_agrees(*turning_drive())


@pytest.mark.parametrize(
    ("name", "ate", "t_rel", "r_rel"), [("KITTI_00_ORB", 1.303, 0.700, 0.253), ("KITTI_00_SPTAM", 3.738, 1.487, 0.558)]
)
def test_published_results_have_their_published_errors_and_evo_agrees(name, ate, t_rel, r_rel):
    estimate = read_poses(real_data("kitti00_published_results") / f"{name}.txt")
    reference = read_poses(real_data("kitti_poses") / "00.txt")
    assert metrics.ate_rigid(estimate[0], reference[0]) == pytest.approx(ate, abs=5e-4)
    errors = metrics.segment_errors(*estimate, *reference)
    assert errors.translation_percent.mean() == pytest.approx(t_rel, abs=5e-4)
    assert errors.rotation_deg_per_100m.mean() == pytest.approx(r_rel, abs=5e-4)
    assert_evo_agrees(*estimate, *reference)
