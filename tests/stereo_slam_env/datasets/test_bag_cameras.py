"""Which `CameraInfo` belongs to which images of a bag (1 s)."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from stereo_slam_env.datasets.bag_images import INFO, calibration_of_topics, first_infos

SIZE = (640, 480)


def message(shift=0.0, fx=400.0):
    P = np.array([[fx, 0.0, 319.5, shift], [0.0, fx, 239.5, 0.0], [0.0, 0.0, 1.0, 0.0]])
    none = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
    return SimpleNamespace(
        k=P[:, :3].ravel(), d=np.zeros(5), r=np.eye(3).ravel(), p=P.ravel(), distortion_model="plumb_bob",
        width=SIZE[0], height=SIZE[1], binning_x=0, binning_y=0, roi=none,
    )  # fmt: skip


EMPTY = message(fx=0.0)
EMPTY.k, EMPTY.p = np.zeros(9), np.zeros(12)


class Bag:
    """A reader of a bag with these messages, by topic."""

    def __init__(self, messages):
        self.messages_of = messages
        self.connections = [SimpleNamespace(topic=topic, msgtype=INFO) for topic in messages]

    def messages(self, connections):
        for connection in connections:
            for number, each in enumerate(self.messages_of[connection.topic]):
                yield connection, number, each

    def deserialize(self, raw, kind):
        assert kind == INFO
        return raw


def baseline_of(bag, eyes):
    found, notes = calibration_of_topics(bag, Path("bag"), eyes, first_infos(bag), (SIZE, SIZE))
    return getattr(found, "camera", found).baseline, notes


@pytest.mark.parametrize(
    ("left", "right", "info_left", "info_right"),
    [
        ("/left/image_rect", "/right/image_rect", "/left/camera_info", "/right/camera_info"),
        ("/left/rect/image", "/right/rect/image/compressed", "/left/camera_info", "/right/camera_info"),
        ("/image_rect", "/right/image_rect", "/camera_info", "/right/camera_info"),
        ("/rig/left/image_rect", "/rig/right/image_rect", "/rig/camera_info", "/rig/right/camera_info"),
    ],
)
def test_it_is_the_nearest_one_above_the_images(left, right, info_left, info_right):
    """Others of the rig, farther away or beside, are not."""
    others = {"/elsewhere/camera_info": [message(-400.0)], "/left/rect/deeper/camera_info": [message(-400.0)]}
    bag = Bag({**others, info_left: [message()], info_right: [message(-48.0)]})
    assert baseline_of(bag, (left, right)) == (pytest.approx(0.12), ())


def test_messages_that_say_nothing_yet_are_passed_over_and_counted():
    infos = {"/left/camera_info": [EMPTY, message(), message()], "/right/camera_info": [EMPTY] + [message(-48.0)] * 3}
    bag = Bag(infos)
    assert {name: info.shift for name, (_, info) in first_infos(bag).items()} == {"/left": 0.0, "/right": -48.0}
    baseline, notes = baseline_of(bag, ("/left/image_rect", "/right/image_rect"))
    assert baseline == pytest.approx(0.12)
    assert notes == (
        "bag, /left/camera_info: 1 of 3 messages are empty: left out",
        "bag, /right/camera_info: 1 of 4 messages are empty: left out",
    )


def test_images_without_any_are_named():
    bag = Bag({"/left/camera_info": [message()]})
    with pytest.raises(
        ValueError, match="bag has no CameraInfo of /left/image_rect and /right/image_rect: give the cal"
    ):
        baseline_of(bag, ("/left/image_rect", "/right/image_rect"))
