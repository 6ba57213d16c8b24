"""Poses: composition, inverse, logarithm and points, against 4x4 matrices and matrix functions."""

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from filters import Pose

EXACT = {"rtol": 0, "atol": 1e-12}


def random_pose(seed, angle=2.0):
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    return Pose(rng.uniform(-5, 5, 3), Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_quat())


def homogeneous(pose):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat(pose.orientation).as_matrix(), pose.position
    return T


def hat(tangent):
    (a, b, c), (x, y, z) = tangent[:3], tangent[3:]
    return np.array([[0, -z, y, a], [z, 0, -x, b], [-y, x, 0, c], [0, 0, 0, 0]])


@pytest.mark.parametrize("seed", range(5))
def test_composition_and_inverse_are_those_of_matrices(seed):
    a, b = random_pose(seed), random_pose(seed + 100, angle=0.7)
    np.testing.assert_allclose(homogeneous(a @ b), homogeneous(a) @ homogeneous(b), **EXACT)
    np.testing.assert_allclose(homogeneous(a.inverse()), np.linalg.inv(homogeneous(a)), **EXACT)
    np.testing.assert_allclose(homogeneous(a @ a.inverse()), np.eye(4), **EXACT)
    np.testing.assert_allclose(homogeneous(Pose()), np.eye(4), **EXACT)


@pytest.mark.parametrize("shape", [(3,), (7, 3), (2, 4, 3)])
def test_points_are_taken_from_the_camera_to_the_world_and_back(shape):
    T_wc, p_c = random_pose(1), np.random.default_rng(2).uniform(-9, 9, shape)
    expected = np.einsum("ij,...j->...i", homogeneous(T_wc), np.concatenate([p_c, np.ones((*shape[:-1], 1))], axis=-1))
    np.testing.assert_allclose(T_wc @ p_c, expected[..., :3], **EXACT)
    np.testing.assert_allclose(T_wc.to_camera(T_wc @ p_c), p_c, **EXACT)
    np.testing.assert_allclose(T_wc.inverse() @ (T_wc @ p_c), p_c, **EXACT)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.5, 2.0, 3.1])
def test_the_logarithm_is_that_of_the_matrix_and_the_exponential_its_inverse(angle):
    pose = random_pose(3, angle)
    np.testing.assert_allclose(hat(pose.log()), np.real(logm(homogeneous(pose))), rtol=0, atol=1e-8)
    np.testing.assert_allclose(homogeneous(Pose.exp(pose.log())), homogeneous(pose), **EXACT)
    np.testing.assert_allclose(homogeneous(Pose.exp(pose.log())), expm(hat(pose.log())), rtol=0, atol=1e-11)


def test_lists_are_taken_as_arrays_and_computed_values_keep_their_bits():
    listed = Pose([1, 2, 3], [0, 0, 0, 1])
    assert listed.inverse().position.tolist() == [-1.0, -2.0, -3.0]
    assert (listed @ [1.0, 0.0, 0.0]).tolist() == [2.0, 2.0, 3.0]
    nearly = np.array([0.0, 0.0, 0.0, 1.0 + 1e-8])
    assert Pose(np.zeros(3), nearly).orientation is nearly
    assert Pose([0, 0, 0], [0, 0, 0, 1.0005]).orientation.tolist() == [0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("position", "orientation", "argument"),
    [
        *(
            (at, [0.0, 0.0, 0.0, 1.0], "position")
            for at in ([1.0, 2.0], [1.0, 2.0, np.nan], np.array([1.0, np.inf, 0.0]))
        ),
        *(([1.0, 2.0, 3.0], turn, "orientation") for turn in ([0.0, 0.0, 0.0, 2.0], np.full(4, np.nan), np.eye(3))),
    ],
)
def test_what_is_no_pose_or_point_is_refused_by_name(position, orientation, argument):
    with pytest.raises(ValueError, match=f"^{argument} must"):
        Pose(position, orientation)
    with pytest.raises(ValueError, match=r"^points must have shape \(\.\.\., 3\), got \(4,\)"):
        Pose() @ np.ones(4)
