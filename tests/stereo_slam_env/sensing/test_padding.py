"""A StereoObservation through the fixed-shape arrays and back."""

import numpy as np
import pytest

from filters.contract.inputs import StereoObservation
from stereo_slam_env import stereo_observation
from stereo_slam_env.sensing.padding import padded, padded_extras

UVD = [[10.0, 20.0, 3.0], [11.5, 21.0, -0.5]]


def test_padding():
    arrays = padded(StereoObservation([3, 8], UVD), 4)
    assert arrays["ids"].tolist() == [3, 8, -1, -1]
    assert arrays["mask"].tolist() == [1, 1, 0, 0]
    assert (arrays["uvd"][2:] == 0).all()
    assert {k: a.dtype.name for k, a in arrays.items()} == {"uvd": "float32", "ids": "int64", "mask": "int8"}


@pytest.mark.parametrize("v_right", [None, [20.5, 21.5]])
def test_there_and_back(v_right):
    R = None if v_right else np.stack([np.diag([0.1, 0.2, 0.3]), np.diag([0.4, 0.5, 0.6])])
    original = StereoObservation([3, 8], UVD, v_right, R)
    arrays, info = padded(original, 5), padded_extras(original, 5)
    back, bare = stereo_observation(arrays, info), stereo_observation(arrays)
    np.testing.assert_array_equal(back.ids, [3, 8])
    np.testing.assert_allclose(back.uvd, UVD, rtol=1e-6)
    assert back.uvd.dtype == np.float64
    assert bare.v_right is None
    assert (back.v_right is None, back.R is None) == (v_right is None, R is None)
    np.testing.assert_array_equal(back.v_right, v_right)
    np.testing.assert_array_equal(back.R, R)
    if R is not None:
        assert info["R"].shape == (5, 3, 3)
        assert (info["R"][2:] == 0).all()
    assert len(stereo_observation(padded(StereoObservation([], np.zeros((0, 3))), 3))) == 0
