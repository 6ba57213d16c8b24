"""Bags whose fields say one thing and whose images another: read as they are, or refused with the reason (40 s)."""

import logging
import struct
import tracemalloc

import cv2
import numpy as np
import pytest

from stereo_slam_env.datasets import open_for_front_end, open_image_sequence
from stereo_slam_env.datasets.bag_images import shift_of_messages
from stereo_slam_env.frontend.track_recorder import record_tracks
from stereo_slam_env.recording.trajectory_files import load_trajectory

from ..frontend.drawn_street import CAMERA, DT
from .small_bags import COUNT, EPOCH_NS, HEIGHT, RAW, RECT, TURNS, WIDTH, K, P, raw_info, raw_street, street, write_bag

pytest.importorskip("rosbags", reason="the extra bags is not installed")


def bag_with(tmp_path, **given):
    return open_image_sequence(write_bag(tmp_path / "bag", **given))


def assert_the_street(sequence, images=None, camera=CAMERA, atol=0):
    pairs = list(sequence.pairs())
    assert len(pairs) == COUNT
    for name in ("fx", "fy", "cx", "cy", "baseline", "width", "height"):
        assert getattr(sequence.camera, name) == pytest.approx(getattr(camera, name), rel=1e-9)
    np.testing.assert_allclose([pair.timestamp for pair in pairs], DT * np.arange(COUNT), atol=1e-6)
    for pair, left, right in zip(pairs, *(street() if images is None else images), strict=True):
        for found, wanted in ((pair.left, left), (pair.right, right)):
            assert np.abs(found.astype(int) - wanted).max() <= atol


def notes_of(sequence):
    return " / ".join(sequence.source.get("notes", []))


# --- rectified or raw ------------------------------------------------------------------------------------------------

KITTI_RAW = np.array([[1.36 * CAMERA.fx, 0, CAMERA.cx + 13], [0, 1.36 * CAMERA.fx, CAMERA.cy + 9], [0, 0, 1.0]])


def as_kitti2bag(eye, k=0):
    return {"K": KITTI_RAW, "D": (-0.37, 0.2, 0.0012, 0.0009, -0.07), "R": TURNS[eye], "P": P(eye)}


@pytest.mark.parametrize(
    ("topics", "said"),
    [(RAW, "raw"), ((RECT[0], RAW[1]), "raw on the right alone"), ((RAW[0], RECT[1]), "raw on the left alone")],
)
def test_rectified_images_beside_raw_cameras_are_left_alone(tmp_path, caplog, topics, said):
    with caplog.at_level(logging.WARNING):
        sequence = bag_with(tmp_path, topics=topics, info=as_kitti2bag)
    assert_the_street(sequence)
    np.testing.assert_array_equal(sequence.R_left, np.eye(3))
    wanted = f"are rectified, although their calibration or name says {said}: rows agree to 0.0"
    assert wanted in notes_of(sequence)
    assert wanted in caplog.text
    open_for_front_end(tmp_path / "bag")


@pytest.mark.parametrize("topics", [RECT, RAW])
def test_raw_images_are_rectified_whatever_their_name_is(tmp_path, topics):
    sequence = bag_with(tmp_path, topics=topics, images=raw_street(), info=lambda eye, k: raw_info(eye))
    np.testing.assert_allclose(sequence.R_left, TURNS[0])
    pair = next(sequence.pairs())
    inside = np.s_[40:-40, 60:-60]
    assert np.median(np.abs(pair.left[inside].astype(int) - street()[0][0][inside])) <= 4
    assert ("raw, although" in notes_of(sequence)) == (topics == RECT)
    open_for_front_end(tmp_path / "bag")


def test_one_raw_and_one_rectified_camera_are_read_as_their_names_say(tmp_path):
    topics, images = (RECT[0], RAW[1]), (street()[0], raw_street()[1])
    sequence = bag_with(tmp_path, topics=topics, images=images, info=lambda eye, k: raw_info(eye))
    pair = next(sequence.pairs())
    np.testing.assert_array_equal(pair.left, street()[0][0])
    assert (pair.right != raw_street()[1][0]).any()
    open_for_front_end(tmp_path / "bag")


def test_raw_images_without_a_calibration_of_the_raw_cameras_are_refused_with_the_remedy(tmp_path):
    path = write_bag(tmp_path / "bag", images=raw_street())
    with pytest.raises(ValueError, match=r"no rectified pair .*yaw -17.*: calibrate the pair again"):
        open_for_front_end(path)


def test_where_both_readings_agree_that_which_is_stated_is_taken_and_said(tmp_path):
    little = lambda eye, k: {"D": (-0.002, 0, 0, 0, 0), "P": P(eye)}  # noqa: E731
    sequence = bag_with(tmp_path, topics=RAW, info=little)
    assert "are read as stated, raw, which their rows do not decide" in notes_of(sequence)


def test_images_that_show_nothing_are_read_as_stated(tmp_path):
    flat = [np.zeros((HEIGHT, WIDTH), np.uint8)] * COUNT
    sequence = bag_with(tmp_path, topics=RAW, images=(flat, flat), info=as_kitti2bag)
    assert "too few corners" in notes_of(sequence)
    np.testing.assert_allclose(sequence.R_left, TURNS[0])


# --- fields of CameraInfo --------------------------------------------------------------------------------------------


def p_alone(eye, k=0):
    return {"K": np.zeros((3, 3)), "R": np.zeros((3, 3)), "size": (0, 0), "P": P(eye)}


def test_p_alone_says_all(tmp_path):
    assert_the_street(bag_with(tmp_path, topics=RAW, info=p_alone))


def smaller(images, x=0, y=0, width=WIDTH, height=HEIGHT, bins=1):
    cut = [image[y : y + height, x : x + width] for image in images]
    size = width // bins, height // bins
    return [cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in cut] if bins > 1 else cut


def of_binned(bins):
    """K of images that are binned: integer pixels are centres."""
    binned = K.copy() / bins
    binned[:2, 2], binned[2, 2] = (K[:2, 2] + 0.5) / bins - 0.5, 1.0
    return binned


@pytest.mark.parametrize(
    ("given", "region"),
    [
        ({"binning": 2}, {"bins": 2}),
        ({"roi": (20, 16, 200, 400, True)}, {"x": 20, "y": 16, "width": 400, "height": 200}),
        ({"roi": (20, 16, 200, 400, True), "binning": 2}, {"x": 20, "y": 16, "width": 400, "height": 200, "bins": 2}),
        ({"roi": (0, 0, HEIGHT, WIDTH, False)}, {}),
    ],
)
def test_region_and_binning_are_those_of_rep_104(tmp_path, given, region):
    images = tuple(smaller(one, **region) for one in street())
    bins, width, height = region.get("bins", 1), region.get("width", WIDTH), region.get("height", HEIGHT)
    sequence = bag_with(tmp_path, images=images, info=lambda eye, k: {**given, "P": P(eye)})
    camera, wanted = sequence.camera, of_binned(bins)
    wanted[:2, 2] -= np.array([region.get("x", 0), region.get("y", 0)]) / bins
    found = [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    assert (camera.width, camera.height) == (width // bins, height // bins)
    assert camera.baseline == pytest.approx(CAMERA.baseline)
    assert np.array_equal(next(sequence.pairs()).left, images[0][0])
    assert bool(notes_of(sequence)) == bool(region)


@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (WIDTH // 2, HEIGHT // 2)])
def test_a_k_of_the_binned_images_contradicts_and_is_said(tmp_path, size):
    images, binned = tuple(smaller(one, bins=2) for one in street()), of_binned(2)
    info = {"binning": 2, "K": binned, "size": size}
    sequence = bag_with(tmp_path, images=images, info=lambda eye, k: {**info, "P": P(eye, binned)})
    assert sequence.camera.fx == CAMERA.fx / 2
    assert sequence.camera.cx == pytest.approx(binned[0, 2])
    assert "binning" in notes_of(sequence)


def test_images_of_no_such_region_are_refused(tmp_path):
    images = tuple(smaller(one, bins=2) for one in street())
    with pytest.raises(ValueError, match=r"images of 240x120 where CameraInfo says 160x80 \(roi .*binning 3x3\)"):
        bag_with(tmp_path, images=images, info=lambda eye, k: {"binning": 3, "P": P(eye)})


OLD = 1.1 * K
OLD[2, 2] = 1.0


@pytest.mark.parametrize(
    ("stale", "complaint"),
    [
        ((0, 1), None),
        ((11, 12), "says .* in 22 of 24 messages and .* in others: the calibration changes"),
        ((22, 23), "in 22 of 24 messages"),
        (range(5), "in 19 of 24 messages"),
        (range(12), "in 12 of 24 messages"),
    ],
)
def test_all_messages_of_a_topic_are_compared(tmp_path, stale, complaint):
    def info(eye, k):
        return {"K": OLD, "P": P(eye, OLD)} if k in stale else {"P": P(eye)}

    if complaint is not None:
        with pytest.raises(ValueError, match=complaint) as error:
            bag_with(tmp_path, info=info)
        assert "\n" not in str(error.value)
        return
    sequence = bag_with(tmp_path, info=info)
    assert_the_street(sequence)
    assert "22 of 24 messages" in notes_of(sequence)


@pytest.mark.parametrize("empty", [(0, 1), (11, 12), (22, 23), range(5), range(20)])
def test_empty_messages_say_nothing(tmp_path, empty):
    nothing = {"K": np.zeros((3, 3)), "P": np.zeros((3, 4))}
    sequence = bag_with(tmp_path, info=lambda eye, k: nothing if k in empty else {"P": P(eye)})
    assert_the_street(sequence)
    assert f"{len(empty)} of 24 messages are empty: left out" in notes_of(sequence)


@pytest.mark.parametrize("given", [{}, {"binning": 2}])
def test_a_calibration_of_larger_images_is_refused(tmp_path, given):
    """Their size is stated as it is; K and P are those of images twice as large."""
    images = tuple(smaller(one, bins=2) for one in street())
    info = {**given, "size": (WIDTH // 2, HEIGHT // 2)}
    with pytest.raises(ValueError, match=r"the principal point .* is not in the middle of images of 240x120: the"):
        bag_with(tmp_path, images=images, info=lambda eye, k: {**info, "P": P(eye)})


def test_a_k_of_the_region_contradicts_and_is_said(tmp_path):
    region = {"x": 240, "y": 0, "width": 240, "height": HEIGHT}
    of_region = K - [[0, 0, 120], [0, 0, 0], [0, 0, 0]]
    info = {"roi": (240, 0, HEIGHT, 240, True), "K": of_region}
    images = tuple(smaller(one, **region) for one in street())
    sequence = bag_with(tmp_path, images=images, info=lambda eye, k: {**info, "P": P(eye, of_region)})
    assert sequence.camera.cx == pytest.approx(of_region[0, 2])
    assert "the region is (240, 0, 240, " in notes_of(sequence)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("equidistant", 4), ("equidistant", 5), ("fisheye", 4), ("kannala_brandt4", 5), ("equidistant", 8)],
)
def test_a_fisheye_has_four_coefficients_whatever_the_driver_fills_up(tmp_path, model, coefficients):
    lens = np.zeros(coefficients)
    lens[:4] = -0.02, 0.03, -0.03, 0.005
    info = {"model": model, "D": lens}
    stripes = [np.tile(np.arange(WIDTH, dtype=np.uint8), (HEIGHT, 1))] * COUNT  # without a corner: read as stated
    images = (stripes, stripes)
    found = bag_with(tmp_path, topics=RAW, images=images, info=lambda eye, k: {**info, "P": P(eye), "R": TURNS[eye]})
    maps = cv2.fisheye.initUndistortRectifyMap(K, lens[:4], TURNS[0], K, (WIDTH, HEIGHT), cv2.CV_16SC2)
    wanted = cv2.remap(stripes[0], *maps, cv2.INTER_LINEAR)
    np.testing.assert_array_equal(next(found.pairs()).left, wanted)


@pytest.mark.parametrize(
    ("right", "complaint"),
    [
        (P(1) * [1, 1, 1, 1000], r"the baseline is 600 m: .*is it in mm \(0\.6 m\)"),
        (P(1) * [1, 1, 1, 100], r"the baseline is 60 m: .*cm \(0\.6 m\)"),
        (P(1) * [1, 1, 1, 1 / 300], r"the baseline is 0\.002 m: .* -fx b, in px m"),
        (np.column_stack([K, [-0.01, -180, 0]]), r"0\.6 m below the left one: a vertical pair"),
    ],
)
def test_baselines_of_no_real_rig_ask_for_their_unit(tmp_path, right, complaint):
    with pytest.raises(ValueError, match=complaint):
        bag_with(tmp_path, info=lambda eye, k: {"P": right if eye else P(0)})


# --- encodings -------------------------------------------------------------------------------------------------------


def mosaic(image, pattern, dtype=np.uint8):
    """A grey scene behind the colours of a sensor, whose pixels differ in gain."""
    found, gain = np.zeros_like(image, dtype), {"r": 0.5, "g": 1.0, "b": 0.7}
    for colour, at in zip(pattern, ((0, 0), (0, 1), (1, 0), (1, 1)), strict=True):
        found[at[0] :: 2, at[1] :: 2] = gain[colour] * image[at[0] :: 2, at[1] :: 2]
    return found


def png(image):
    return cv2.imencode(".png", image)[1].tobytes()


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("packed", [True, False])
def test_the_mosaic_of_a_colour_sensor_becomes_grey(tmp_path, pattern, packed):
    def encoded(image, k, eye):
        raw = mosaic(image, pattern)
        return (f"bayer_{pattern}8; png compressed ", png(raw)) if packed else (f"bayer_{pattern}8", raw)

    pair = next(bag_with(tmp_path, encoded=encoded).pairs())
    inside = np.s_[2:-2, 2:-2]
    grey = (0.299 * 0.5 + 0.587 + 0.114 * 0.7) * street()[0][0]
    assert np.mean(np.abs(pair.left[inside] - grey[inside])) < 4.0
    stripes = pair.left[inside].astype(float)
    assert abs(stripes[:, ::2].mean() - stripes[:, 1::2].mean()) < 0.5


def colours(image):
    return np.repeat(image[..., None], 3, axis=2)


def yuv(image, at):
    found = np.full((*image.shape, 2), 128, np.uint8)
    found[..., at] = image
    return found


ENCODED = {
    "bgr8, packed": lambda image: ("bgr8; png compressed bgr8", png(colours(image))),
    "rgb8, packed": lambda image: ("rgb8; png compressed bgr8", png(colours(image))),
    "png": lambda image: ("png", png(image)),
    "8UC1": lambda image: ("8UC1", image),
    "yuv422": lambda image: ("yuv422", yuv(image, 1)),
    "yuyv": lambda image: ("yuv422_yuy2", yuv(image, 0)),
    "rgb16": lambda image: ("rgb16", colours(image).astype("<u2") << 8),
    **{
        f"mono16, {bits} bits": lambda image, bits=bits: ("mono16", image.astype("<u2") << (bits - 8))
        for bits in (10, 12, 14, 16)
    },
    "mono16, 12 bits, packed": lambda image: ("mono16; png compressed ", png(image.astype(np.uint16) << 4)),
    "mono16, 12 bits, big end first": lambda image: ("mono16", (image.astype("<u2") << 4).astype(">u2")),
}


@pytest.mark.parametrize("name", ENCODED)
def test_every_encoding_gives_the_same_grey(tmp_path, name):
    # A white pixel: with it, and in the sample, values have all their bits.
    images = tuple([np.where(np.arange(WIDTH) == 0, 255, a).astype(np.uint8) for a in one] for one in street())
    sequence = bag_with(tmp_path, images=images, encoded=lambda image, k, eye: ENCODED[name](image))
    assert_the_street(sequence, images, atol=1)


def test_dark_images_of_a_bright_recording_stay_dark_in_both_eyes(tmp_path):
    """One scale for all: not that of each image, which would flicker."""

    def encoded(image, k, eye):
        return "mono16", (image.astype("<u2") >> (3 if k % 2 else 0)) << 4

    pairs = list(bag_with(tmp_path, encoded=encoded).pairs())
    np.testing.assert_array_equal(pairs[1].left, street()[0][1] >> 3)
    np.testing.assert_array_equal(pairs[2].right, street()[1][2])


def test_values_above_the_sampled_ones_saturate():
    class Message:
        encoding, width, height, step, is_bigendian = "mono16", 2, 1, 4, 0
        data = np.array([1000, 4], "<u2").view(np.uint8)

    assert shift_of_messages([Message], "an image") == 2


# --- stamps ----------------------------------------------------------------------------------------------------------


def due(k):
    return EPOCH_NS + round(1e9 * DT) * k


@pytest.mark.parametrize("eyes", [(0, 1), (0,), (1,)])
def test_images_without_stamps_have_the_times_of_the_log(tmp_path, eyes):
    sequence = bag_with(tmp_path, stamp=lambda eye, k: 0 if eye in eyes else due(k), logged=lambda eye, k: due(k) + eye)
    assert_the_street(sequence)
    assert sequence.source["epoch_s"] == pytest.approx(1e-9 * EPOCH_NS, abs=1e-6)
    assert "the times of the log are taken" in notes_of(sequence)


@pytest.mark.parametrize("wild", [0, 9, 23])
@pytest.mark.parametrize("off", [-50, 50])
def test_a_stamp_that_is_50_s_off_costs_one_pair(tmp_path, wild, off):
    sequence = bag_with(tmp_path, stamp=lambda eye, k: due(k) + (off * 1_000_000_000 if k == wild else 0))
    assert len(list(sequence.pairs())) == COUNT - 1
    assert np.diff([pair.timestamp for pair in sequence.pairs()]).max() < 2.5 * DT
    assert "1 of 24 stamps" in notes_of(sequence)


def test_stamps_of_zero_beside_others_are_none(tmp_path):
    sequence = bag_with(tmp_path, stamp=lambda eye, k: 0 if k < 10 else due(k))
    np.testing.assert_allclose([pair.timestamp for pair in sequence.pairs()], DT * np.arange(14), atol=1e-6)
    assert "10 of 24 stamps" in notes_of(sequence)


def test_a_clock_that_begins_at_zero_is_one(tmp_path):
    assert_the_street(bag_with(tmp_path, stamp=lambda eye, k: due(k) - EPOCH_NS))


def test_a_clock_that_jumps_is_named_with_the_pair(tmp_path):
    sequence = bag_with(tmp_path, stamp=lambda eye, k: due(k) + (3_600_000_000_000 if k > 12 else 0))
    with pytest.raises(ValueError, match=r"bag: pair 13 comes 3600\.\d+ s after the one before"):
        record_tracks(sequence)


def test_repeated_stamps_are_counted(tmp_path):
    sequence = bag_with(tmp_path, stamp=lambda eye, k: due(8 if k == 9 else k))
    assert len(list(sequence.pairs())) == COUNT - 1
    assert "1 of 24 images repeat a stamp" in notes_of(sequence)


def test_logs_without_times_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"its times are .* s apart"):
        bag_with(tmp_path, stamp=lambda eye, k: 0, logged=lambda eye, k: EPOCH_NS + k)


def test_a_few_images_that_are_logged_late_are_put_where_they_belong(tmp_path):
    assert_the_street(bag_with(tmp_path, logged=lambda eye, k: due(k) + (350_000_000 if k == 5 else 0)))


def test_left_images_do_not_wait_in_memory_for_the_first_right_one(tmp_path):
    sequence = bag_with(tmp_path, logged=lambda eye, k: due(k) + eye * 3_600_000_000_000)
    assert_the_street(sequence)
    pairs = sequence.pairs()
    next(pairs)
    tracemalloc.start()
    for _ in pairs:
        pass
    assert tracemalloc.get_traced_memory()[1] < 0.5 * 2 * COUNT * WIDTH * HEIGHT
    tracemalloc.stop()


# --- not ROS ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("encoding", [b"protobuf", b"jsonschema", b"ros1msg"])
def test_an_mcap_of_another_world_is_not_called_damaged(tmp_path, encoding):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/image", "std_msgs/msg/String", typestore=store)
        message = store.types["std_msgs/msg/String"]("no image")
        writer.write(connection, 1, store.serialize_cdr(message, "std_msgs/msg/String"))
    data = next((tmp_path / "bag").glob("*.mcap")).read_bytes()
    other = tmp_path / "other.mcap"
    other.write_bytes(_with_schema_encoding(data, encoding))
    for read in (open_image_sequence, lambda path: load_trajectory(f"{path}:/image")):
        with pytest.raises(ValueError, match=f"other.mcap is .* schemas are {encoding.decode()}, not ROS") as error:
            read(other)
        assert "damaged" not in str(error.value)


def _with_schema_encoding(data, encoding):
    """An MCAP file in parts: its chunks, and its summary, with other schemas; nothing else refers to places."""
    out, at, summary = bytearray(data[:8]), 8, 0
    while at < len(data) - 8:
        kind, size = data[at], struct.unpack_from("<Q", data, at + 1)[0]
        body = data[at + 9 : at + 9 + size]
        if kind == 3:
            body = body.replace(struct.pack("<I", 7) + b"ros2msg", struct.pack("<I", len(encoding)) + encoding)
        if kind == 2:  # footer: where the summary begins
            body = struct.pack("<QQI", summary, 0, 0)
        out += bytes([kind]) + struct.pack("<Q", len(body)) + body
        at += 9 + size
        if kind == 15:  # the end of the data
            summary = len(out)
    return bytes(out) + data[-8:]
