"""A world that loses its texture: the front end measures what is left to see (8 s)."""

import numpy as np
import pytest

from stereo_slam_env.envs.drive import StereoDriveEnv
from studies.faults import FAULTS
from studies.faults.catalogue import rendered_drive

FRAMES, BLANK = 9, 6


def counts(recording):
    return np.array([len(frame.observation) for frame in recording.frames])


@pytest.fixture(scope="module")
def street():
    """A street, and the same one that turns blank."""
    return rendered_drive("street", 1, FRAMES, None), rendered_drive("street", 1, FRAMES, 0.1 * BLANK)


def test_until_then_the_drive_is_as_it_should_be_to_the_bit(street):
    good, blank = (recording.frames for recording in street)
    for a, b in zip(good[:BLANK], blank[:BLANK], strict=True):
        assert np.array_equal(a.observation.ids, b.observation.ids)
        assert np.array_equal(a.observation.uvd, b.observation.uvd)
        assert np.array_equal(a.observation.R, b.observation.R)


def test_from_then_on_hardly_anything_is_left_to_see_on_the_same_way(street):
    good, blank = (counts(recording)[BLANK:] for recording in street)
    assert good.min() > 40
    assert (blank < 0.4 * good).all()
    ways = [np.array([frame.truth.position for frame in recording.frames]) for recording in street]
    assert np.array_equal(*ways)


def test_nobody_tells_the_filter_how_the_car_moves(street):
    assert all(frame.odometry is None for recording in street for frame in recording.frames)


def test_the_walls_are_blank_in_the_images_and_shapes_are_where_they_were():
    env = StereoDriveEnv(
        policy="route", route="right-turn", rig="qvga", render_images=True, blank_from=0.1, max_landmarks=1
    )
    twin = StereoDriveEnv(policy="route", route="right-turn", rig="qvga", render_images=True, max_landmarks=1)
    try:
        first = [one.reset(seed=0)[0]["left"] for one in (env, twin)]
        blank, good = (one.step(np.zeros(2, dtype=np.float32))[0]["left"].astype(float) for one in (env, twin))
        again = env.reset(seed=0)[0]["left"]
    finally:
        env.close()
        twin.close()
    assert np.array_equal(*first)
    assert np.array_equal(again, first[0])  # a new episode has its texture back
    ground = np.s_[200:, 100:220]
    assert good[ground].std(axis=(0, 1)).max() > 3.0
    assert blank[ground].std(axis=(0, 1)).max() < 1.0
    sky = good[:40, 140:180]
    assert np.abs(blank[:40, 140:180] - sky).max() < 1.0


@pytest.mark.parametrize(("name", "surroundings"), [("no-texture", "street"), ("blank-corridor", "corridor")])
def test_the_catalogue_has_them(name, surroundings):
    fault = FAULTS[name]
    source = fault.driven(7, 1).source
    assert (source["seed"], source["frames"]) == (7, 1)
    wanted = {"surroundings": surroundings, "blank_from": fault.begins, "sensor": "images", "renderer": "tiny"}
    assert wanted.items() <= source["arguments"].items()
