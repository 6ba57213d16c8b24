"""The drive in Rerun: written to a file and read back (6 s)."""

import numpy as np
import pytest

from filters import EuclideanEKF, InverseDepthStereoEKF
from stereo_slam_env.recording.recording import Frame, Recording
from stereo_slam_env.viewer.rerun_view import FARTHEST, RerunView, ellipsoids
from stereo_slam_env.viewer.watched_drive import Drive

from ...filters.bodies.street import CARS, NOISE, street
from ...filters.drives import CAMERA as STREET_CAMERA
from ...filters.drives import DT
from ..benchmark.small_recordings import CAMERA, small_recording

NAME = "inverse-depth"


@pytest.fixture(scope="module")
def drive():
    return Drive.of(small_recording(frames=6), InverseDepthStereoEKF, label=NAME)


@pytest.fixture(scope="module")
def written(drive, tmp_path_factory):
    """What is in the file, by entity: columns of what changes, then of what does not."""
    pytest.importorskip("rerun", reason="needs the extra viewer")
    path = tmp_path_factory.mktemp("rerun") / "drive.rrd"
    left = np.full((CAMERA.height, CAMERA.width, 3), 90, dtype=np.uint8)
    with RerunView(drive.camera, [NAME], save=path, landmarks=drive.landmarks) as view:
        for moment in drive.moments():
            view.show(NAME, moment, left)
    return read_back(path)


def read_back(path):
    reader = pytest.importorskip("rerun.chunk", reason="reads files with Rerun 0.41 or later").RrdReader
    content = {}
    for chunk in reader(path).stream():
        batch = chunk.to_record_batch()
        columns = content.setdefault(str(chunk.entity_path), {})
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            columns.setdefault(name, []).extend(column.to_pylist())
    return content


def rows(written, entity, column):
    return [np.array(row) for row in written[entity][column]]


def test_every_moment_is_in_it_at_its_time(written, drive):
    times = [time.total_seconds() for time in written[f"/consistency/{NAME}"]["time"] if time is not None]
    np.testing.assert_allclose(times, [moment.time for moment in drive.moments()], atol=1e-6)


def test_the_curves_are_those_of_the_filter(written, drive):
    moments = list(drive.moments())
    expected = {
        f"/consistency/{NAME}": [moment.nees / 6 for moment in moments],
        f"/error/{NAME}": [moment.position_error for moment in moments],
        f"/error/{NAME}\\ claims": [
            3.0 * float(np.sqrt(np.trace(moment.pose.covariance[:3, :3]))) for moment in moments
        ],
        f"/map/{NAME}": [len(moment.landmarks.ids) for moment in moments],
    }
    for entity, values in expected.items():
        np.testing.assert_allclose(np.ravel(written[entity]["Scalars:scalars"]), values)


def test_the_camera_is_where_the_filter_believes_it_is(written, drive):
    entity = f"/world/{NAME}/camera"
    moments = list(drive.moments())
    places = np.concatenate(rows(written, entity, "Transform3D:translation"))
    turns = np.concatenate(rows(written, entity, "Transform3D:quaternion"))
    np.testing.assert_allclose(places, [m.pose.position for m in moments], atol=1e-5)
    np.testing.assert_allclose(turns, [m.pose.orientation for m in moments], atol=1e-6)


def test_the_right_eye_is_a_baseline_to_the_right(written):
    np.testing.assert_allclose(
        rows(written, f"/world/{NAME}/camera/right", "Transform3D:translation")[0], [[CAMERA.baseline, 0, 0]]
    )


def test_the_ellipsoids_are_the_covariances_of_the_map(written, drive):
    entity = f"/world/{NAME}/ellipsoids"
    stored = rows(written, entity, "Ellipsoids3D:half_sizes")
    for moment, half_sizes in zip(drive.moments(), stored, strict=True):
        shape = ellipsoids(moment.landmarks.covariances)
        assert len(half_sizes) == shape.drawn.sum() > 5
        np.testing.assert_allclose(half_sizes, shape.half_sizes[shape.drawn], rtol=1e-5)


def test_landmarks_and_measurements_are_points(written, drive):
    *_, last = drive.moments()
    distance = np.linalg.norm(last.landmarks.positions - last.pose.position, axis=1)
    points = rows(written, f"/world/{NAME}/landmarks", "Points3D:positions")[-1]
    np.testing.assert_allclose(points, last.landmarks.positions[distance < FARTHEST], rtol=1e-5, atol=1e-4)
    pixels = rows(written, f"/world/{NAME}/camera/left/measured", "Points2D:positions")[-1]
    np.testing.assert_allclose(pixels, last.observation.uvd[:, :2] + 0.5, rtol=1e-5)


def test_the_paths_are_pieces_end_to_end(written, drive):
    for entity in (f"/world/{NAME}/path", "/world/truth/path"):
        pieces = np.concatenate(rows(written, entity, "LineStrips3D:strips"))
        assert pieces.shape == (drive.frames, 2, 3)
        np.testing.assert_array_equal(pieces[1:, 0], pieces[:-1, 1])


def test_what_the_left_eye_saw_is_there(written):
    assert any(name.startswith("EncodedImage") for name in written[f"/world/{NAME}/camera/left"])


def test_two_filters_share_a_recording(tmp_path):
    pytest.importorskip("rerun", reason="needs the extra viewer")
    recording = small_recording(frames=3)
    with RerunView(recording.camera, ["a", "b"], save=tmp_path / "two.rrd") as view:
        for name, make in (("a", InverseDepthStereoEKF), ("b", EuclideanEKF)):
            for moment in Drive.of(recording, make).moments():
                view.show(name, moment)
        with pytest.raises(ValueError, match="one of a, b, got 'c'"):
            view.show("c", next(Drive.of(recording, EuclideanEKF).moments()))
        view.close()
    found = read_back(tmp_path / "two.rrd")
    assert {"/world/a/path", "/world/b/path", "/world/truth/path"} <= found.keys()


def test_moving_bodies_are_ellipsoids_with_arrows(tmp_path):
    pytest.importorskip("rerun", reason="needs the extra viewer")
    sights = street(0, CARS, frames=20)
    frames = [Frame(DT * k, sight.observation, truth=sight.camera) for k, sight in enumerate(sights)]
    recording = Recording("street", STREET_CAMERA, tuple(frames), NOISE)
    beliefs = []
    with RerunView(recording.camera, ["bodies"], save=tmp_path / "street.rrd") as view:
        for moment in Drive.of(recording, "moving-bodies", label="bodies").moments():
            view.show("bodies", moment)
            beliefs.append(moment.bodies)
    written = read_back(tmp_path / "street.rrd")
    assert len(beliefs[-1]) == 3
    np.testing.assert_allclose(
        rows(written, "/world/bodies/velocities", "Arrows3D:vectors")[-1], beliefs[-1].linear, rtol=1e-5
    )
    shape = ellipsoids(beliefs[-1].covariances[:, :3, :3])
    stored = rows(written, "/world/bodies/bodies", "Ellipsoids3D:half_sizes")[-1]
    np.testing.assert_allclose(stored, shape.half_sizes, rtol=1e-5)


def test_there_must_be_something_to_show():
    pytest.importorskip("rerun", reason="needs the extra viewer")
    with pytest.raises(ValueError, match="labels must name"):
        RerunView(CAMERA, [])
