"""Potentials of the joint covariance: what information gain is made of (1 s)."""

import numpy as np
import pytest

from stereo_slam_env.envs import InformationCriterion
from stereo_slam_env.envs.information import CRITERIA, FARTHEST, log_det

SIGMA = 10.0
SIZES = (0, 1, 4, 9)


def random_map(rng, count, spread=2.0):
    """A covariance of pose and landmarks with standard deviations over orders of magnitude, strongly correlated."""
    size = 6 + 3 * count
    root = rng.standard_normal((size, size)) + 3.0 * rng.standard_normal((size, 1))
    sigmas = 10.0 ** rng.uniform(-spread, spread, size)
    return sigmas[:, None] * (root @ root.T / size + 1e-3 * np.eye(size)) * sigmas


def discovered(rng, joint):
    """The map with one more landmark, started from the pose as filters do: J P, and noise of its own."""
    J = np.hstack([rng.standard_normal((3, 6)), np.zeros((3, len(joint) - 6))])
    root = 10.0 ** rng.uniform(-2, 2) * rng.standard_normal((3, 3))
    cross = J @ joint
    return np.block([[joint, cross.T], [cross, cross @ J.T + root @ root.T + 1e-6 * np.eye(3)]])


def corrected(rng, joint, rows=2):
    """The map after a measurement of something linear in all of it."""
    H = rng.standard_normal((rows, len(joint))) / np.sqrt(np.diag(joint))
    K = joint @ H.T @ np.linalg.inv(H @ joint @ H.T + 0.1 * np.eye(rows))
    smaller = joint - K @ H @ joint
    return 0.5 * (smaller + smaller.T)


def dense_log_det(joint, sigma):
    """By its definition: landmarks fused with their priors, relative to the priors alone."""
    count = (len(joint) - 6) // 3
    D = np.diag(np.repeat([0.0, sigma**-2], [6, 3 * count]))
    return -np.linalg.slogdet(np.linalg.inv(joint) + D)[1] - 3 * count * np.log(sigma**2)


def dense_blocks(joint, sigma, variance):
    value = variance(joint[:3, :3]) + sigma**2 * variance(joint[3:6, 3:6])
    for first in range(6, len(joint), 3):
        own = slice(first, first + 3)
        value += variance(np.linalg.inv(np.linalg.inv(joint[own, own]) + np.eye(3) / sigma**2)) - sigma**2
    return value


@pytest.mark.parametrize("count", SIZES)
def test_log_det_is_its_definition_with_dense_matrices(count):
    rng = np.random.default_rng(count)
    for _ in range(20):
        joint = random_map(rng, count, spread=1.0)
        value = InformationCriterion("log-det", "map", SIGMA).potential(joint)
        assert value == pytest.approx(dense_log_det(joint, SIGMA), rel=1e-8)
        assert InformationCriterion("entropy", "map", SIGMA).potential(joint) == 0.5 * value


@pytest.mark.parametrize(
    ("name", "variance"),
    [
        ("a-optimality", lambda B: np.trace(B) / 3),
        ("d-optimality", lambda B: np.linalg.det(B) ** (1 / 3)),
        ("e-optimality", lambda B: np.linalg.eigvalsh(B)[-1]),
    ],
)
def test_the_others_are_sums_over_blocks(name, variance):
    rng = np.random.default_rng(1)
    for count in SIZES:
        joint = random_map(rng, count, spread=1.0)
        wanted = dense_blocks(joint, SIGMA, variance)
        assert InformationCriterion(name, "map", SIGMA).potential(joint) == pytest.approx(wanted, rel=1e-8)


@pytest.mark.parametrize("name", CRITERIA)
def test_discovery_is_never_punished(name):
    """Whatever the map and whatever the landmark: far or near, well seen or badly."""
    for seed in range(30):
        rng = np.random.default_rng([3, seed])
        joint = random_map(rng, int(rng.integers(0, 8)), spread=1.5)
        criterion = InformationCriterion(name, "map", 10.0 ** rng.uniform(-1, 2))
        assert criterion.potential(discovered(rng, joint)) < criterion.potential(joint)


@pytest.mark.parametrize("name", CRITERIA)
@pytest.mark.parametrize("of", ["map", "pose"])
def test_a_measurement_is_never_punished(name, of):
    rng = np.random.default_rng(4)
    criterion = InformationCriterion(name, of, SIGMA)
    for _ in range(20):
        joint = random_map(rng, 4, spread=1.0)
        assert criterion.potential(corrected(rng, joint)) < criterion.potential(joint)


@pytest.mark.parametrize("name", CRITERIA)
@pytest.mark.parametrize("variance", [1e6, 1e9, 1e30, np.inf, np.nan])
def test_a_landmark_of_which_nothing_is_known_counts_nothing(name, variance):
    """Also where rounding would have the last word: far away along a ray that is no axis."""
    rng = np.random.default_rng(8)
    joint = random_map(rng, 3, spread=1.0)
    ray = np.array([0.48, 0.6, 0.64])
    own = variance * np.outer(ray, ray) + 1e4 * np.eye(3)
    far = np.block([[joint, np.zeros((len(joint), 3))], [np.zeros((3, len(joint))), own]])
    criterion = InformationCriterion(name, "map", 1.0)
    unknown = {"log-det": 3e-4, "entropy": 3e-4}.get(name, 1e-3)
    assert criterion.potential(far) == pytest.approx(criterion.potential(joint), abs=unknown)


def test_far_landmarks_leave_the_log_det_exact():
    """Variances of 1e6 m^2 beside those of micrometres, on a diagonal."""
    variances = np.concatenate([[1e-12] * 3, [1e-14] * 3, [1e6, 1e-2, 1e-2], [1e-6] * 3])
    wanted = np.log(variances).sum() - np.log(variances[6:] + SIGMA**2).sum()
    found = InformationCriterion("log-det", "map", SIGMA).potential(np.diag(variances))
    assert found == pytest.approx(wanted, rel=1e-12)


def test_what_lies_beyond_the_limit_would_have_said_nothing():
    """Direction known to 1/721 rad, as pixels are: where a landmark is cut off, fusing it changes little."""
    depth_sigma = 0.99 * FARTHEST * SIGMA
    lateral = 6500.0 / 721.5  # m; a sigma of depth of 1e5 m is reached at 6.5 km
    joint = np.diag(np.concatenate([np.full(6, 1e-4), [lateral**2, lateral**2, depth_sigma**2]]))
    nothing = joint[:6, :6]
    criterion = InformationCriterion("log-det", "map", SIGMA)
    assert criterion.potential(nothing) - criterion.potential(joint) < 2.0


@pytest.mark.parametrize("name", CRITERIA)
def test_the_pose_alone_does_not_ask_the_map(name):
    rng = np.random.default_rng(9)
    joint = random_map(rng, 3)
    criterion = InformationCriterion(name, "pose", SIGMA)
    assert criterion.potential(joint) == criterion.potential(joint[:6, :6])
    if name == "log-det":
        assert criterion.potential(joint) == pytest.approx(np.linalg.slogdet(joint[:6, :6])[1], rel=1e-9)


def test_log_det_spans_the_whole_range_of_floats():
    sigmas = 10.0 ** np.linspace(-100, 100, 40)
    correlated = np.eye(40) + 0.3
    wanted = np.linalg.slogdet(correlated)[1] + 2 * np.log(sigmas).sum()
    assert log_det(sigmas[:, None] * correlated * sigmas) == pytest.approx(wanted, abs=1e-9)


def test_what_is_no_covariance_is_refused():
    with pytest.raises(ArithmeticError, match="a covariance has a variance of -1"):
        log_det(np.diag([1.0, -1.0]))
    with pytest.raises(ArithmeticError, match="no Cholesky factor"):
        log_det(np.array([[1.0, 2.0], [2.0, 1.0]]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "t-optimality"}, "criterion must be one of 'log-det', 'entropy'.*got 't-optimality'"),
        ({"of": "car"}, "of must be one of 'map', 'pose', got 'car'"),
        ({"prior_sigma": 0.0}, "prior_sigma must be a finite number > 0"),
    ],
)
def test_unknown_words_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        InformationCriterion(**arguments)
