"""Trajectory metrics against known motions, and against evo on published results (5 s, most of it evo)."""

import copy

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.benchmark import trajectory_metrics as metrics
from stereo_slam_env.datasets.tables import read_poses

from ..real_data import real_data


@pytest.fixture
def curve():
    t = np.linspace(0.0, 3.0, 50)
    return np.column_stack([10 * np.sin(t), t, 20 * t])


@pytest.fixture
def motion():
    return Rotation.from_euler("zyx", [20.0, 130.0, -40.0], degrees=True), np.array([3.0, -5.0, 7.0])


def test_alignment_finds_a_rigid_motion(curve, motion):
    turn, shift = motion
    R, t = metrics.align_rigid(curve, turn.apply(curve) + shift)
    np.testing.assert_allclose(R, turn.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(t, shift, atol=1e-10)


def test_alignment_never_mirrors_or_scales(curve):
    R, _ = metrics.align_rigid(curve, 2.0 * curve * [1.0, 1.0, -1.0])
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


@pytest.mark.parametrize("positions", [np.outer(np.arange(9.0), [1.0, 2.0, 3.0]), np.zeros((9, 3))])
def test_alignment_refuses_what_does_not_determine_it(positions):
    with pytest.raises(ValueError, match="on one line or one point"):
        metrics.align_rigid(positions, positions)


def test_the_residual_on_a_line_is_defined_all_the_same():
    line = np.outer(np.arange(5.0), [0.0, 0.0, 1.0])
    sideways = line[:, [2, 1, 0]] + [0.0, 4.0, 0.0]
    assert metrics.ate_rigid(sideways, line) == pytest.approx(0.0, abs=1e-12)


def test_rigid_error_ignores_a_motion_and_the_unaligned_one_does_not(curve, motion):
    turn, shift = motion
    assert metrics.ate_rigid(turn.apply(curve) + shift, curve) == pytest.approx(0.0, abs=1e-9)
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


@pytest.mark.parametrize(("name", "published"), [("KITTI_00_ORB", 1.303), ("KITTI_00_SPTAM", 3.738)])
def test_published_results_have_their_published_error_and_evo_agrees(name, published):
    core = pytest.importorskip("evo.core", reason="needs pip install evo")
    from evo.core import metrics as evo_metrics
    from evo.core import trajectory

    assert core is not None
    estimate, _ = read_poses(real_data("kitti00_published_results") / f"{name}.txt")
    reference, _ = read_poses(real_data("kitti_poses") / "00.txt")
    ours = metrics.ate_rigid(estimate, reference)
    assert ours == pytest.approx(published, abs=5e-4)

    unit = np.tile([1.0, 0.0, 0.0, 0.0], (len(estimate), 1))
    evo_reference = trajectory.PosePath3D(reference, unit)
    evo_estimate = trajectory.PosePath3D(copy.deepcopy(estimate), unit)
    evo_estimate.align(evo_reference, correct_scale=False)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data((evo_reference, evo_estimate))
    assert ours == pytest.approx(ape.get_statistic(evo_metrics.StatisticsType.rmse), abs=1e-6)
    assert metrics.path_length(reference) == pytest.approx(evo_reference.path_length, rel=1e-9)
