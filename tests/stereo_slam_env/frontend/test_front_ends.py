"""Front ends as plug-ins: ours keep the contract, faults are found, and each can be asked for by name (15 s)."""

import sys
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from filters import StereoObservation
from stereo_slam_env.cli import app as cli
from stereo_slam_env.datasets import load
from stereo_slam_env.frontend import (
    StereoTracker,
    TrackedPair,
    TrackerSettings,
    available_front_ends,
    check_front_end,
    make_front_end,
)
from stereo_slam_env.frontend.front_ends import CAMERA, DT, _pairs
from stereo_slam_env.frontend.other_front_ends import KLT_SIGMA, KLTFrontEnd

from ..datasets.small_image_folders import kitti_odometry


@pytest.mark.parametrize("name", ["active-search", "klt", pytest.param("sift", marks=pytest.mark.slow)])
def test_ours_keep_the_contract(name):
    assert str(check_front_end(name)).endswith("9 checks passed, 0 failed")


class Faulty(KLTFrontEnd):
    """A good front end with one fault, given as `spoilt(calls since the last reset, what was found)`."""

    calls = 0

    def reset(self):
        super().reset()
        self.calls = 0

    def track(self, left, right, dt=None, forecast=None):
        self.calls += 1
        return type(self).spoilt(self.calls, super().track(left, right, dt, forecast))

    @staticmethod
    def spoilt(calls, found):
        return found


class Credulous(Faulty):
    def track(self, left, right, dt=None, forecast=None):
        try:
            return super().track(left, right, dt, forecast)
        except ValueError:
            return TrackedPair(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))


class Borrower(Faulty):
    def track(self, left, right, dt=None, forecast=None):
        found = super().track(left, right, dt, forecast)
        self._left = left
        return found


def spoiling(spoilt):
    return type("Spoilt", (Faulty,), {"spoilt": staticmethod(spoilt)})


def moved(found, by):
    return replace(found, uvd=found.uvd + by)


MOODS = np.random.default_rng(0)
FAULTS = {
    "to parts of a pixel. the median error of (u, v, d) is": lambda calls, found: moved(found, np.array([0, 0, 0.15])),
    "ids must be int64 and ascend": lambda calls, found: replace(found, ids=found.ids[::-1].copy()),
    "symmetric and positive definite. pair 0 has one that is not": lambda calls, found: replace(found, R=0.0 * found.R),
    "half of them are measured in the next pair, too. pair 3 has 0%": lambda calls, found: replace(
        found, ids=found.ids + 1000 * calls
    ),
    "dropped does not come again. pair 1 has": lambda calls, found: replace(found, dropped=found.ids[:1]),
    "give the same bits, after `reset`": lambda calls, found: moved(found, MOODS.normal(0.0, 0.01, found.uvd.shape)),
    "a smaller image is taken": Credulous,
    "an image is kept that was overwritten": Borrower,
}


@pytest.mark.parametrize("failed", FAULTS)
def test_each_fault_is_found_and_named(failed):
    front_end = FAULTS[failed] if isinstance(FAULTS[failed], type) else spoiling(FAULTS[failed])
    report = check_front_end(front_end, raise_on_failure=False)
    assert any(failed in line for line in report.failed), report
    with pytest.raises(AssertionError, match=front_end.__name__):
        check_front_end(front_end)


def failures(spoilt):
    return list(check_front_end(spoiling(spoilt), raise_on_failure=False).failed)


def test_ten_landmarks_are_enough_and_nine_are_not():
    def first(count):
        return lambda _, found: replace(found, ids=found.ids[:count], uvd=found.uvd[:count], R=found.R[:count])

    assert failures(first(10)) == []
    assert any("has 9 landmarks, 10 are asked for" in line for line in failures(first(9)))


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_bias_of_a_tenth_of_a_pixel_is_the_limit_in_each_coordinate(axis, sign):
    """From the second pair on, so that landmarks do not begin where they are taken to be."""
    for size, fails in ((0.06, False), (0.14, True)):
        by = sign * size * np.eye(3)[axis]
        found = failures(lambda calls, found, by=by: moved(found, by * (calls > 1)))
        assert ([line for line in found if "the median error of (u, v, d) is" in line] != []) == fails
        assert (found != []) == fails


def test_a_tenth_of_the_measurements_may_be_wrong_by_more():
    """By 1.6 px of disparity."""

    def scattered(share):
        return lambda _, found: moved(
            found, np.outer((np.arange(len(found.ids)) + 0.5) / len(found.ids) < share, [0.0, 0.0, 1.6])
        )

    assert failures(scattered(0.07)) == []
    assert any("are wrong by more than 1.5 px" in line for line in failures(scattered(0.14)))


def test_a_tracked_pair_is_ids_measurements_and_covariances():
    found = TrackedPair(np.array([3, 7]), np.array([[10.0, 20, 5], [30, 40, 2]]), np.tile(np.eye(3), (2, 1, 1)))
    assert isinstance(found.observation, StereoObservation)
    np.testing.assert_array_equal(found.observation.ids, [3, 7])
    assert found.observation is found.observation
    assert len(found.dropped) == len(found.initialised) == len(found.search.ids) == 0


def test_klt_claims_one_constant_and_finds_the_disparity_offset():
    left, right = _pairs()[0]
    plain = KLTFrontEnd(CAMERA).track(left, right)
    np.testing.assert_allclose(
        plain.R, np.tile(KLT_SIGMA**2 * np.array([[1, 0, 1], [0, 1, 0], [1, 0, 2]]), (len(plain.ids), 1, 1))
    )
    moved = KLTFrontEnd(CAMERA, TrackerSettings(disparity_offset=0.25)).track(left, right)
    np.testing.assert_allclose(moved.uvd[:, 2], plain.uvd[:, 2] + 0.25)


def test_unknown_names_and_missing_networks_are_refused_in_one_line(tmp_path):
    with pytest.raises(
        ValueError, match=r"front end must be one of active-search, klt, .* got 'klp', did you mean 'klt'"
    ):
        make_front_end(CAMERA, TrackerSettings(method="klp"))
    for name in ("aliked", "disk"):
        with pytest.raises(ValueError, match=r"needs a network: give its ONNX file as model|needs OpenCV 5"):
            make_front_end(CAMERA, TrackerSettings(method=name))
        (tmp_path / "net.onnx").write_bytes(b"no network")
        with pytest.raises(ValueError, match=r"is no network that|needs OpenCV 5"):
            make_front_end(CAMERA, TrackerSettings(method=name, model=str(tmp_path / "net.onnx")))
    with pytest.raises(ValueError, match="front end must be one of"):
        gym.make("StereoSlam/Drive-v0", sensor="images", front_end_name="klp")
    with pytest.raises(ValueError, match=r"is no network that LightGlueMatcher takes|needs OpenCV 5"):
        make_front_end(CAMERA, TrackerSettings(method="sift", matcher_model=str(tmp_path / "net.onnx")))


def test_a_recording_is_measured_by_the_front_end_that_is_named(tmp_path, capsys):
    folder = kitti_odometry(tmp_path)
    recording = load(folder, front_end={"method": "klt", "disparity_offset": 0.0})
    assert recording.source["front_end"]["method"] == "klt"
    assert sum(len(frame.observation) for frame in recording.frames) > 30
    assert recording.start.covariance is not None  # the first two pairs show how it moves
    assert 2.0 < np.linalg.norm(recording.start.linear_velocity) < 6.0  # of 4 m/s, in pictures of 160x120
    assert cli.main(["replay", str(folder), "--front-end", "klp", "--out", str(tmp_path / "run")]) == 2
    assert "front end must be one of" in capsys.readouterr().err
    assert cli.main(["bench", "--preset", "turn", "--front-end", "klt", "--out", str(tmp_path / "run")]) == 2
    assert "--front-end needs images" in capsys.readouterr().err


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Two front ends of strangers, one of which cannot be loaded."""
    about = tmp_path / "fast_front_end-1.dist-info"
    about.mkdir()
    (tmp_path / "fast_front_end.py").write_text(
        "from stereo_slam_env.frontend import StereoTracker\n\n"
        'class Fast(StereoTracker):\n    """Somebody else\'s."""\n'
    )
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: fast-front-end\nVersion: 1\n")
    points = "[stereo_slam.front_ends]\nfast = fast_front_end:Fast\nbroken = nobody_has_this:It\n"
    (about / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("fast_front_end", None)


def test_front_ends_of_others_are_found_by_entry_point_and_a_broken_one_is_named(installed):
    listed = available_front_ends()
    assert listed["fast"] == "Somebody else's."
    assert listed["broken"].startswith("not available: ")
    made = make_front_end(CAMERA, TrackerSettings(method="fast"))
    ours = StereoTracker(CAMERA)
    for number, (left, right) in enumerate(_pairs()[:3]):
        dt = DT if number else None
        np.testing.assert_array_equal(made.track(left, right, dt).uvd, ours.track(left, right, dt).uvd)
    with pytest.raises(ValueError, match=r"front end 'broken' \(nobody_has_this:It\) cannot be loaded"):
        make_front_end(CAMERA, TrackerSettings(method="broken"))
