"""Calibration by `CameraInfo`: regions and binned images of a sensor, empty and changing messages (1 s)."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import StereoCamera
from stereo_slam_env.sensing.camera_info import CameraInfo, agreed, calibration_of_images
from stereo_slam_env.sensing.lenses import Lens, Rectification

SENSOR = (1280, 800)
F, CX, CY, B = 600.0, 642.0, 397.0, 0.12


def info(*, right=False, **changes):
    """Rectified images of a whole sensor, seen by a pinhole."""
    K = (F, 0.0, CX, 0.0, F, CY, 0.0, 0.0, 1.0)
    P = (F, 0.0, CX, -F * B if right else 0.0, 0.0, F, CY, 0.0, 0.0, 0.0, 1.0, 0.0)
    whole = CameraInfo(K, (0.0,) * 5, tuple(np.eye(3).ravel()), P, "plumb_bob", SENSOR, (1, 1), (0, 0, 0, 0))
    return replace(whole, **changes)


def read(size=SENSOR, mapped=(False, False), **changes):
    """Numbers of the rig, and the notes."""
    both = info(**changes), info(right=True, **changes)
    calibration, notes = calibration_of_images(both, (size, size), "here", mapped=mapped)
    camera = calibration.camera if isinstance(calibration, Rectification) else calibration
    return (camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline, camera.width, camera.height), notes


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, None),
        ({"binning": (2, 2)}, "roi and binning contradict the images"),
        ({"K": (0.0,) * 9}, "here: K is not filled in, P alone is used"),
    ],
)
def test_images_of_the_whole_sensor_have_its_numbers(changes, said):
    numbers, notes = read(**changes)
    assert numbers == (F, F, CX, CY, B, *SENSOR)
    assert len(notes) == (said is not None)
    assert (said or "") in "".join(notes)


def test_a_size_that_is_not_stated_is_that_of_the_images():
    both = info(size=(0, 0), binning=(2, 2)), info(right=True, size=(0, 0))
    calibration, notes = calibration_of_images(both, (SENSOR, SENSOR), "here", mapped=(False, False))
    camera = getattr(calibration, "camera", calibration)
    assert (camera.fx, camera.cx, camera.width, camera.height) == (F, CX, *SENSOR)
    assert notes == ()


@pytest.mark.parametrize(
    ("binning", "roi", "size"),
    [
        ((2, 2), (0, 0, 0, 0), (640, 400)),
        ((2, 1), (0, 0, 0, 0), (640, 800)),
        ((1, 1), (100, 60, 1000, 700), (1000, 700)),
        ((1, 1), (100, 0, 1000, 800), (1000, 800)),
        ((1, 1), (0, 60, 1280, 700), (1280, 700)),
        ((2, 2), (100, 60, 1000, 700), (500, 350)),
        ((1, 1), (100, 60, 0, 0), (1180, 740)),
    ],
)
def test_images_of_a_region_and_joined_pixels_have_the_rays_of_the_sensor(binning, roi, size):
    """The centre of joined pixels is between theirs; the note names what was done."""
    (fx, fy, cx, cy, b, *shown), (note,) = read(size, binning=binning, roi=roi)
    assert (fx, fy, b, tuple(shown)) == (F / binning[0], F / binning[1], pytest.approx(B), size)
    joined = roi[0] + (binning[0] - 1) / 2, roi[1] + (binning[1] - 1) / 2  # of the sensor, at pixel (0, 0)
    assert (cx * binning[0] + joined[0], cy * binning[1] + joined[1]) == (pytest.approx(CX), pytest.approx(CY))
    assert ("binning" in note, "region" in note) == (binning != (1, 1), any(roi))
    assert f"fx is {fx:.6g} px" in note


def test_numbers_of_binned_images_are_told_by_their_principal_point():
    """K in the middle of the images of 640x400 that were joined, not of the sensor."""
    K = (300.0, 0.0, 321.0, 0.0, 300.0, 198.0, 0.0, 0.0, 1.0)
    both = [info(K=K, P=(*K[:3], shift, *K[3:6], 0.0, *K[6:], 0.0), binning=(2, 2)) for shift in (0.0, -300.0 * B)]
    calibration, (note,) = calibration_of_images(tuple(both), ((640, 400),) * 2, "here", mapped=(False, False))
    camera = getattr(calibration, "camera", calibration)
    assert (camera.fx, camera.cx, camera.cy, camera.baseline) == (300.0, 321.0, 198.0, pytest.approx(B))
    assert "binning is 2x2, but K has its principal point in the middle of the binned images" in note


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "^here: images of 640x480 where CameraInfo says 1280x800: calibrate for these"),
        ({"binning": (2, 1)}, r"where CameraInfo says 640x800 \(roi \(0, 0, 0, 0\), binning 2x1\)"),
    ],
)
def test_images_of_another_size_are_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        read(size=(640, 480), **changes)


def test_each_camera_is_turned_by_its_own_rotation():
    turn = Rotation.from_rotvec([0.0, 0.01, 0.0]).as_matrix()
    both = info(R=tuple(turn.ravel())), info(right=True)
    rectify, _ = calibration_of_images(both, (SENSOR, SENSOR), "here", mapped=(True, True))
    np.testing.assert_allclose(rectify.turns, [turn, np.eye(3)], atol=1e-12)


def test_rectified_images_without_a_lens_are_left_alone_and_raw_ones_with_one_are_not():
    images = np.random.default_rng(0).integers(0, 255, (2, *SENSOR[::-1]), dtype=np.uint8)
    for D, mapped, needed in (
        *(((0.0,) * 5, (True, True), False), ((-0.1, 0.0, 0.0, 0.0, 0.0), (True, True), True)),
        *(((-0.1, 0.0, 0.0, 0.0, 0.0), (False, False), False), ((-0.1, 0.0, 0.0, 0.0, 0.0), (False, True), True)),
    ):
        both = info(D=D), info(right=True, D=D)
        rectify, _ = calibration_of_images(both, (SENSOR, SENSOR), "here", mapped=mapped)
        assert rectify.needed == needed
        raw = tuple(images)
        left, right = rectify(*raw)
        assert (left is raw[0]) == (not (needed and mapped[0]))
        assert (right is raw[1]) == (not (needed and mapped[1]))


@pytest.mark.parametrize("capitals", [True, False])
def test_a_message_is_read_by_the_names_of_ros_1_and_of_ros_2(capitals):
    numbers = {"K": np.arange(9.0), "D": [0.1], "R": np.eye(3).ravel(), "P": np.arange(12.0)}
    named = {name if capitals else name.lower(): values for name, values in numbers.items()}
    roi = SimpleNamespace(x_offset=1, y_offset=2, width=3, height=4)
    found = CameraInfo.of_message(
        SimpleNamespace(**named, distortion_model="rational", width=5, height=6, binning_x=0, binning_y=2, roi=roi)
    )
    assert found == CameraInfo(
        *(tuple(np.asarray(values, dtype=float).tolist()) for values in numbers.values()),
        model="rational", size=(5, 6), binning=(1, 2), roi=(1, 2, 3, 4),
    )  # fmt: skip
    assert found.shift == 3.0


def test_messages_that_agree_are_one_and_a_few_others_at_the_start_are_left_out():
    usual, other, empty = info(), info(K=(1.0,) * 9), info(K=(0.0,) * 9, P=(0.0,) * 12)
    assert agreed([usual] * 3, "topic") == (usual, ())
    assert agreed([empty], "topic") == (empty, ())
    assert agreed([empty] * 2 + [usual] * 3, "topic") == (usual, ("topic: 2 of 5 messages are empty: left out",))
    found, (note,) = agreed([other] * 2 + [usual] * 18, "topic")
    assert found == usual
    assert note.startswith("topic says 1280x800, K fx 600, P fx 600, P[3] 0 in 18 of 20 messages and 1280x800, K fx 1,")
    assert note.endswith("the first 2 are taken for those of a calibration before")
    for messages in ([other] * 3 + [usual] * 17, [usual] * 9 + [other] + [usual] * 10):
        with pytest.raises(ValueError, match="the calibration changes, so cut the bag where it does"):
            agreed(messages, "topic")


def test_what_a_lens_changes_is_seen_by_its_distortion_turn_and_matrix():
    lens = Lens(F, F, CX, CY, *SENSOR)
    P, same = np.column_stack([lens.K, np.zeros(3)]), np.eye(3)
    much, nothing = (Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix() for angle in (1e-3, 1e-12))
    bent = replace(lens, distortion=(0.1, 0.0, 0.0, 0.0))
    for one, turn, left, changed in (
        *((lens, same, P, False), (bent, same, P, True), (lens, much, P, True), (lens, nothing, P, False)),
        (lens, same, P * [[1.001], [1.0], [1.0]], True),
    ):
        rectify = Rectification((one, lens), (turn, same), (left, P), StereoCamera(F, F, CX, CY, B, *SENSOR))
        assert rectify.changes == (changed, False)
        assert rectify.needed == changed
        np.testing.assert_array_equal(rectify.R_left, turn)
        assert not replace(rectify, mapped=(False, True)).needed
        np.testing.assert_array_equal(replace(rectify, mapped=(False, True)).R_left, same)
