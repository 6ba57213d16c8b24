"""What a bag states beside its messages is held against them: noise of the unit, true poses, the place of the body."""

import numpy as np
import pytest

from stereo_slam_env.datasets import open_image_sequence
from stereo_slam_env.sensing.imu import DATA_SHEETS

from .test_round_trips import full_drive, place_of

pytest.importorskip("rosbags")


def altered(tmp_path, topic, change):
    """The full drive as a bag in which the messages of a topic are changed; None leaves them out."""
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    drive = place_of(tmp_path, "mcap", full_drive()) / "drive.mcap"
    plugin, connections = StoragePlugin.MCAP, {}
    with Writer(tmp_path / "altered", version=9, storage_plugin=plugin) as writer, AnyReader([drive]) as reader:
        for connection, stamp, raw in reader.messages():
            data = bytes(raw)
            if connection.topic == topic:
                message = change(reader.deserialize(raw, connection.msgtype))
                if message is None:
                    continue
                data = types.serialize_cdr(message, connection.msgtype)
            if connection.topic not in connections:
                added = writer.add_connection(connection.topic, connection.msgtype, typestore=types)
                connections[connection.topic] = added
            writer.write(connections[connection.topic], stamp, data)
    return tmp_path / "altered"


def unit_of(bag):
    sequence = open_image_sequence(bag)
    return list(sequence.pairs())[1].inertial.unit, sequence.source["imu_assumed"]


def with_numbers(*numbers):
    def change(message):
        message.data = np.array(numbers)
        return message

    return change


def test_the_noise_beside_the_samples_is_theirs(tmp_path):
    unit, assumed = unit_of(altered(tmp_path, "/none", None))
    assert (unit.gyro_walk, unit.accelerometer_walk, assumed) == (4e-5, 5e-3, "nothing")


@pytest.mark.parametrize(
    "numbers",
    [
        (0.1, 0.2, 0.3, 0.4),
        (0.1, 0.2, 0.3, 0.4, 0.5),
        (2.4e-4, 1.8e-3),
        (2.4e-4, 1.8e-3, np.nan, 1e-3),
        (2.4e-4, 1.8e-3, -1e-5, 1e-3),
    ],
)
def test_four_other_numbers_of_that_name_are_no_noise(tmp_path, numbers):
    unit, assumed = unit_of(altered(tmp_path, "/imu/noise", with_numbers(*numbers)))
    assert unit.gyro_density == pytest.approx(2.4e-4, rel=1e-9)
    assert (unit.gyro_walk, assumed) == (DATA_SHEETS["bmi088"].gyro_walk, "walks of the biases of bmi088")


def test_a_truth_whose_body_is_nowhere_is_left_out_and_said(tmp_path, caplog):
    def elsewhere(message):
        message.child_frame_id = "drone"
        return message

    pairs = list(open_image_sequence(altered(tmp_path, "/ground_truth", elsewhere)).pairs())
    assert all(pair.truth is None for pair in pairs)
    assert "no truth is taken from /ground_truth: " in caplog.text
    assert "no static transform links 'drone' with the camera's frame" in caplog.text


def test_without_a_truth_there_is_none(tmp_path):
    sequence = open_image_sequence(altered(tmp_path, "/ground_truth", lambda message: None))
    assert all(pair.truth is None for pair in sequence.pairs())
    assert sequence.truth_from.kind == "none"


def test_a_truth_of_a_bag_that_does_not_say_is_of_unknown_origin(tmp_path):
    bag = altered(tmp_path, "/ground_truth/reference", lambda message: None)
    assert open_image_sequence(bag).truth_from.kind == "unknown"


@pytest.mark.parametrize("text", ["", "[]", '{"kind": "divine", "description": ""}', '{"kind": "simulation"}'])
def test_a_reference_that_is_none_is_named(tmp_path, text):
    def change(message):
        message.data = text
        return message

    with pytest.raises(ValueError, match="/ground_truth/reference is no reference"):
        open_image_sequence(altered(tmp_path, "/ground_truth/reference", change))


def test_steps_have_the_covariance_of_their_own_message(tmp_path):
    def doubtful(message):
        if message.header.stamp.nanosec == 300_000_000:
            message.twist.covariance = 4.0 * message.twist.covariance
        return message

    bag = altered(tmp_path, "/wheel/odometry", doubtful)
    steps = [pair.odometry for pair in open_image_sequence(bag, odometry="/wheel/odometry").pairs()]
    for k, (step, original) in enumerate(zip(steps[1:], list(full_drive().pairs())[1:], strict=True), start=1):
        factor = 4.0 if k == 3 else 1.0
        np.testing.assert_allclose(step.covariance, factor * original.odometry.covariance, atol=1e-12)
