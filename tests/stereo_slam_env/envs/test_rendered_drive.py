"""A scripted drive as images, and through a folder back again. About 8 s."""

import json
from contextlib import closing

import numpy as np
import pytest

from filters import StereoNoise, make_filter
from stereo_slam_env.datasets import load, open_for_front_end, write_recording
from stereo_slam_env.datasets.written_frame import KINDS
from stereo_slam_env.envs.drive import StereoDriveEnv
from stereo_slam_env.envs.recorder import RenderedDrive
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.track_recorder import ActiveSearch, record_tracks
from stereo_slam_env.rendering.pinhole import grey
from stereo_slam_env.rendering.renderers import image_quality, renderer_identity

from ..rendering.planes import skip_where_missing

DRIVE = {"route": "right-turn", "rig": "qvga"}
FRAMES = 6


@pytest.fixture(scope="module")
def drive():
    return RenderedDrive(DRIVE, seed=2, frames=FRAMES)


@pytest.fixture(scope="module")
def pairs(drive):
    return list(drive.pairs())


def test_it_is_what_the_environment_sees(drive, pairs):
    env = StereoDriveEnv(**DRIVE, policy="route", render_images=True)
    try:
        observation, _ = env.reset(seed=2)
        np.testing.assert_array_equal(drive.start.linear_velocity, env.start.linear_velocity)
        np.testing.assert_array_equal(drive.start.covariance, env.start.covariance)
        assert drive.camera == env.camera
        for pair in pairs:
            np.testing.assert_array_equal(pair.left, grey(observation["left"]))
            np.testing.assert_array_equal(pair.right, grey(observation["right"]))
            assert pair.timestamp == env.frame.timestamp
            np.testing.assert_array_equal(pair.truth.position, env.frame.truth.position)
            if pair.odometry is not None:
                np.testing.assert_array_equal(pair.odometry.linear, env.frame.odometry.linear)
            observation = env.step(np.zeros(2, dtype=np.float32))[0]
    finally:
        env.close()


def test_the_source_says_how_to_make_it_again_and_who_drew_it(drive):
    assert len(drive) == len(list(drive.pairs())) == FRAMES
    source = json.loads(json.dumps(drive.source))
    assert source["renderer"] == renderer_identity("tiny")
    assert (source["seed"], source["frames"]) == (2, FRAMES)
    again = RenderedDrive(source["arguments"], source["seed"], 2)
    np.testing.assert_array_equal(next(again.pairs()).left, next(drive.pairs()).left)


@pytest.mark.parametrize("frames", [0, 81])
def test_frames_beyond_the_route_are_refused(frames):
    assert len(RenderedDrive(DRIVE)) == 80
    with pytest.raises(ValueError, match=rf"frames must be from 1 to 80 on route 'right-turn', got {frames}"):
        RenderedDrive(DRIVE, frames=frames)


def test_settings_of_the_sensor_do_no_harm():
    """The arguments of an environment that tracks landmarks are those of its drive, too."""
    drive = RenderedDrive({**DRIVE, "sensor": "images", "refill_below": 50, "render_images": True}, seed=2, frames=1)
    assert len(list(drive.pairs())) == 1


def test_through_a_kitti_folder_the_tracks_stay_the_same(drive, tmp_path):
    """Of a perfect rig no offset is found that its error would not explain, and without one no bit changes."""
    write_recording(drive, tmp_path, "kitti", name="00", may_lose=KINDS)
    found = load(tmp_path).source["front_end"]
    assert abs(found["disparity_offset"]) < 3.0 * found["disparity_offset_sigma"]
    direct = record_tracks(drive, TrackerSettings())
    replayed = load(tmp_path, front_end={"disparity_offset": 0.0})
    assert len(replayed) == FRAMES
    for one, two in zip(direct.frames, replayed.frames, strict=True):
        np.testing.assert_array_equal(one.observation.ids, two.observation.ids)
        np.testing.assert_allclose(one.observation.uvd, two.observation.uvd, atol=1e-9)
        np.testing.assert_allclose(one.truth.position, two.truth.position, atol=1e-9)


@pytest.mark.parametrize("renderer", ["tiny", "gl"])
def test_the_front_end_is_told_what_the_renderer_says_of_its_images(renderer):
    skip_where_missing(renderer)
    quality = image_quality(renderer)
    drive = RenderedDrive({**DRIVE, "renderer": renderer, "max_landmarks": 40})
    assert drive.front_end.image_blur == quality.blur
    assert drive.front_end.sigma_floor == max(quality.texture_sigma, TrackerSettings.sigma_floor)
    assert drive.front_end.max_landmarks == 40
    with closing(StereoDriveEnv(**DRIVE, renderer=renderer, sensor="images", max_landmarks=40)) as env:
        assert env.options.front_end == drive.front_end


@pytest.mark.parametrize("renderer", ["tiny", "gl"])
def test_without_settings_tracks_are_recorded_with_those_of_who_drew_the_pictures(renderer, drive):
    skip_where_missing(renderer)
    quality = image_quality(renderer)
    drawn = _Drawn(drive, RenderedDrive({**DRIVE, "renderer": renderer}, seed=2, frames=2).front_end)
    settings = record_tracks(drawn, frames=2).source["front_end"]
    assert settings["image_blur"] == quality.blur
    assert settings["sigma_floor"] == max(quality.texture_sigma, TrackerSettings.sigma_floor)
    given = record_tracks(drawn, TrackerSettings(image_blur=0.3), frames=2).source["front_end"]
    assert given["image_blur"] == 0.3


class _Drawn:
    """The pictures of a drive, said to be drawn by another renderer: so no test needs EGL."""

    def __init__(self, drive, front_end):
        self._drive, self.front_end = drive, front_end

    def __getattr__(self, name):
        return getattr(self._drive, name)

    def __len__(self):
        return len(self._drive)


def test_a_guided_search_without_settings_is_that_of_who_drew_the_pictures(drive):
    """The same measurements as with the settings given."""
    coarse = _Drawn(drive, TrackerSettings(max_landmarks=12, refill_below=10))
    camera, noise = drive.camera, StereoNoise.independent_pixels(0.5)
    seen = []
    for arguments in [(coarse,), (coarse, coarse.front_end)]:
        search, slam = ActiveSearch(*arguments), make_filter("inverse-depth", camera=camera, noise=noise)
        seen.append(search.observe(0, slam))
    np.testing.assert_array_equal(seen[0].ids, seen[1].ids)
    assert len(seen[0].ids) <= 12


def test_nothing_is_said_of_a_camera_that_nobody_has_measured(tmp_path):
    write_recording(RenderedDrive(DRIVE, seed=2, frames=2), tmp_path, "kitti", may_lose=KINDS)
    assert open_for_front_end(tmp_path)[1].image_blur == 0.0
    assert open_for_front_end(tmp_path, front_end={"image_blur": 0.5})[1].image_blur == 0.5
