"""The still and the film of a drive (12 s)."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from filters import InverseDepthStereoEKF
from stereo_slam_env.viewer.drive_picture import DrivePicture, save_film, save_still, style_context
from stereo_slam_env.viewer.watched_drive import Drive

from ..benchmark.small_recordings import small_recording


@pytest.fixture(scope="module")
def drive():
    return Drive.of(small_recording(frames=9), InverseDepthStereoEKF, label="inverse-depth")


def panels(drive, frame=-1):
    history = list(drive.moments())
    with style_context():
        return DrivePicture(drive, history).at(range(len(history))[frame]).axes


def test_a_still_is_a_picture_of_film_shape_and_that_of_an_early_moment_runs_no_further(drive, tmp_path):
    told = []
    save_still(drive, tmp_path / "still.png", progress=lambda done, of: told.append((done, of)))
    assert cv2.imread(str(tmp_path / "still.png")).shape[:2] == (1152, 2048)
    assert told[-1] == (9, 9)
    told.clear()
    save_still(drive, tmp_path / "still.png", 2, lambda done, of: told.append((done, of)))
    assert told == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize(("most", "options"), [(9, {}), (3, {"most_pictures": 4})])
def test_a_film_has_a_picture_a_frame_up_to_the_most_and_the_speed_of_the_drive(drive, tmp_path, most, options):
    save_film(drive, tmp_path / "film.mp4", **options)
    film = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == most
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(10.0 * most / drive.frames, rel=1e-3)
    assert (film.get(cv2.CAP_PROP_FRAME_WIDTH), film.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (1280, 720)


def test_the_curve_is_the_nees_over_its_degrees_of_freedom_and_without_truth_the_nis(drive):
    strip = panels(drive)[3]
    np.testing.assert_array_equal(strip.lines[-2].get_ydata()[1:], [moment.nees / 6 for moment in drive.moments()][1:])
    assert "NEES" in strip.get_title(loc="left")
    _, way, _, strip = panels(Drive.of(small_recording(truth=False), InverseDepthStereoEKF))
    assert "NIS" in strip.get_title(loc="left")
    assert way.get_title(loc="left") == "Path (m)"


def test_the_close_view_has_its_heading_up_and_the_car_in_the_origin(drive):
    """What is straight ahead of the turned camera is straight up; the way so far ends in the origin."""
    close = panels(drive)[0]
    way = close.lines[2]
    np.testing.assert_allclose([way.get_xdata()[-1], way.get_ydata()[-1]], 0.0, atol=1e-12)
    speed = np.array([way.get_xdata()[-1] - way.get_xdata()[-2], way.get_ydata()[-1] - way.get_ydata()[-2]])
    assert abs(np.arctan2(speed[0], speed[1])) < 0.05
    assert np.linalg.norm(speed) == pytest.approx(0.5, rel=0.1)


def test_each_landmark_in_view_has_its_ellipse(drive):
    *_, last = drive.moments()
    near = np.isfinite(last.landmarks.covariances).all(axis=(1, 2))
    close = panels(drive)[0]
    drawn = sum(len(collection.get_offsets()) for collection in close.collections)
    assert 1 < drawn <= near.sum() + 1  # and that of the position


@pytest.mark.parametrize("scale", [0.05, 1.0, 10.0])
def test_the_scale_is_that_of_what_is_measured(scale):
    """The same drive in a room, in a street and in the open: the picture is the same but for its numbers."""
    limits = {}
    for size in (1.0, scale):
        close, way, *_ = panels(Drive.of(of_size(small_recording(frames=9), size), InverseDepthStereoEKF))
        limits[size] = np.array([*close.get_xlim(), *close.get_ylim(), *way.get_xlim(), *way.get_ylim()]) / size
    np.testing.assert_allclose(limits[scale], limits[1.0], rtol=0.02)
    recording = small_recording(frames=9)
    disparities = np.concatenate([frame.observation.uvd[:, 2] for frame in recording.frames])
    depths = recording.camera.fx * recording.camera.baseline / disparities
    assert limits[1.0][3] == pytest.approx(np.quantile(depths, 0.8), rel=0.05)


def of_size(recording, scale):
    """The same pictures from a world that is larger by a factor, rig included."""

    def scaled(truth):
        return truth and replace(truth, position=scale * truth.position)

    start = recording.start
    if start.linear_velocity is not None:
        start = replace(start, linear_velocity=scale * start.linear_velocity)
    return replace(
        recording,
        camera=replace(recording.camera, baseline=scale * recording.camera.baseline),
        frames=tuple(replace(frame, truth=scaled(frame.truth), odometry=None) for frame in recording.frames),
        start=start,
        landmarks=None,
    )


@pytest.mark.parametrize(
    ("path", "frame", "message"),
    [
        ("still.jpg", None, "must end in .png"),
        ("nowhere/still.png", None, "nowhere does not exist"),
        ("still.png", 9, "frame must be 0 to 8, got 9"),
    ],
)
def test_a_wrong_file_or_frame_is_known_before_any_work(drive, tmp_path, path, frame, message):
    with pytest.raises(ValueError, match=message):
        save_still(drive, tmp_path / path, frame)
    assert list(tmp_path.iterdir()) == []
