"""The copy of KITTI 00 inside the gtsam wheel (1 s)."""

import re
import sys

import numpy as np
import pytest

from filters.contract.extras import install_command
from stereo_slam_env.datasets import load

from ..real_data import real_data


def test_the_wheel_holds_the_same_measurements_as_the_folder():
    pytest.importorskip("gtsam", reason="needs the extra gtsam")
    wheel, folder = load("gtsam"), load(real_data("kitti00_stereo_tracks"))
    assert len(wheel) == len(folder)
    for a, b in zip(wheel.frames, folder.frames, strict=True):
        np.testing.assert_array_equal(a.observation.ids, b.observation.ids)
        np.testing.assert_array_equal(a.observation.uvd, b.observation.uvd)
        assert a.timestamp - wheel.frames[0].timestamp == pytest.approx(b.timestamp, abs=0.05)


def test_its_reference_says_that_it_is_no_ground_truth():
    pytest.importorskip("gtsam", reason="needs the extra gtsam")
    assert load("gtsam").reference.kind == "odometry"


def test_without_gtsam_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(ImportError, match=re.escape(install_command("gtsam")) + "$"):
        load("gtsam")
