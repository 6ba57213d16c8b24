"""The start state of a filter."""

import numpy as np
import pytest

from filters import Start

INDEFINITE = np.diag([-1.0, *np.ones(11)])
ASYMMETRIC = np.eye(12) + np.eye(12, k=1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"position": (1, 2)}, "position must have shape"),
        ({"position": (np.nan, 0, 0)}, "position must be finite"),
        ({"orientation": (0, 0, 0, 2)}, "orientation must be a unit quaternion"),
        ({"orientation": (0, 0, 1)}, "orientation must have shape"),
        ({"linear_velocity": (np.inf, 0, 0)}, "linear_velocity must be finite"),
        ({"angular_velocity": "fast"}, "angular_velocity must be numeric"),
        ({"covariance": INDEFINITE}, "covariance must be positive"),
        ({"covariance": ASYMMETRIC}, "covariance must be symmetric"),
        ({"covariance": np.eye(13)}, "covariance must have shape"),
        ({"covariance": np.full((12, 12), np.nan)}, "covariance must be finite"),
    ],
)
def test_an_impossible_start_is_refused_by_name(arguments, message):
    with pytest.raises(ValueError, match=message):
        Start(**arguments)


def test_without_a_covariance_the_pose_is_known_and_the_velocity_is_not():
    sigmas = np.sqrt(np.diag(Start().assumed_covariance))
    np.testing.assert_allclose(sigmas, np.repeat([1e-6, 1e-6, 10.0, 0.5], 3))
    given = 0.3 * np.eye(12)
    np.testing.assert_array_equal(Start(covariance=given).assumed_covariance, given)


def test_a_start_owns_its_arrays():
    start = Start(position := np.array([1.0, 2.0, 3.0]))
    position[0] = 9.0
    assert start.position[0] == 1.0
    for array in (start.position, start.orientation, start.linear_velocity, start.assumed_covariance):
        assert not array.flags.writeable
