"""What goes in and out of a filter: value types that refuse what makes no sense, with one line that says why."""

from __future__ import annotations

import numpy as np
import pytest

from filters import BodyVelocity, StereoObservation

NAN = float("nan")
UVD = [[100.0, 50.0, 3.0], [200.0, 60.0, -0.5]]
R = np.tile(np.eye(3), (2, 1, 1))


def test_an_observation_keeps_read_only_copies() -> None:
    uvd = np.array(UVD)
    observation = StereoObservation([3, 1], uvd, v_right=[50.0, 61.0], R=R)
    uvd[0, 0] = 7.0
    assert observation.ids.dtype == np.int64
    assert observation.ids.tolist() == [3, 1]
    assert observation.uvd[0, 0] == 100.0
    assert len(observation) == 2
    for array in (observation.ids, observation.uvd, observation.v_right, observation.R):
        assert not array.flags.writeable


@pytest.mark.parametrize("ids", [[], np.zeros(0), np.zeros(0, dtype=np.int64)])
def test_an_empty_observation_is_legal(ids: object) -> None:
    observation = StereoObservation(ids, np.zeros((0, 3)), v_right=[], R=[])
    assert len(observation) == 0
    assert observation.uvd.shape == (0, 3)
    assert observation.R.shape == (0, 3, 3)


def test_select_takes_positions_or_a_mask_in_their_order() -> None:
    observation = StereoObservation([3, 1], UVD, v_right=[50.0, 61.0], R=R * [[[1.0]], [[2.0]]])
    turned = observation.select([1, 0])
    assert turned.ids.tolist() == [1, 3]
    assert turned.v_right.tolist() == [61.0, 50.0]
    assert turned.R[0, 0, 0] == 2.0
    assert observation.select([False, True]).uvd.tolist() == UVD[1:]
    assert StereoObservation([3, 1], UVD).select([0]).R is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"ids": [1, 1]}, r"ids must be unique, repeated: \[1\]"),
        ({"ids": [1.0, 2.0]}, "ids must be integers"),
        ({"ids": [[1, 2]]}, r"ids must have shape \(M,\)"),
        ({"ids": [1]}, "uvd must have one row per id: 1 ids, 2 rows"),
        ({"uvd": [[1.0, 2.0]] * 2}, r"uvd must have shape \(M, 3\)"),
        ({"uvd": [1.0, 2.0, 3.0]}, r"uvd must have shape \(M, 3\)"),
        ({"uvd": [[1.0, 2.0, 3.0], [1.0, NAN, 3.0]]}, "uvd must be finite"),
        ({"uvd": [[1.0, 2.0, 3.0], [np.inf, 2.0, 3.0]]}, "uvd must be finite"),
        ({"uvd": "pixels"}, "uvd must be numeric"),
        ({"v_right": [1.0]}, "v_right must have one entry per id"),
        ({"v_right": [1.0, NAN]}, "v_right must be finite"),
        ({"v_right": [[1.0, 2.0]]}, r"v_right must have shape \(M,\)"),
        ({"R": np.eye(3)}, r"R must have shape \(2, 3, 3\)"),
        ({"R": R[:1]}, r"R must have shape \(2, 3, 3\)"),
        ({"R": R * [[[1.0]], [[-1.0]]]}, "R must be positive definite"),
        ({"R": R * [[[1.0]], [[0.0]]]}, "R must be positive definite"),
        ({"R": R + np.eye(3, k=1)}, "R must be symmetric"),
        ({"R": R * NAN}, "R must be finite"),
    ],
)
def test_an_observation_that_makes_no_sense_is_refused(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        StereoObservation(**{"ids": [1, 2], "uvd": UVD, **arguments})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"linear": [1.0, 2.0]}, r"odometry.linear must have shape \(3,\)"),
        ({"angular": [1.0, NAN, 0.0]}, "odometry.angular must be finite"),
        ({"covariance": np.eye(3)}, r"odometry.covariance must have shape \(6, 6\)"),
        ({"covariance": -np.eye(6)}, "odometry.covariance must be positive semi-definite"),
        ({"covariance": np.eye(6) + np.eye(6, k=2)}, "odometry.covariance must be symmetric"),
    ],
)
def test_odometry_that_makes_no_sense_is_refused(arguments: dict, message: str) -> None:
    exact = {"linear": np.zeros(3), "angular": np.zeros(3), "covariance": np.zeros((6, 6))}
    assert not BodyVelocity(**exact).covariance.any()
    with pytest.raises(ValueError, match=message):
        BodyVelocity(**{**exact, **arguments})
