"""Videos are whole or not there (1 s)."""

import cv2
import numpy as np
import pytest

from stereo_slam_env.viewer.watched_drive import Recorder


def pictures(count=5, size=(120, 160)):
    for k in range(count):
        picture = np.full((*size, 3), 60, dtype=np.uint8)
        picture[:, : 20 * (k + 1), 0] = 220  # red grows from the left
        yield picture


def frames_of(path):
    video, frames = cv2.VideoCapture(str(path)), []
    while (read := video.read())[0]:
        frames.append(read[1])
    rate = video.get(cv2.CAP_PROP_FPS)
    video.release()
    return frames, rate


def recorded(path, shown=(), **options):
    with Recorder(path, **options) as recorder:
        for picture in shown:
            recorder.write(picture)
            assert not path.exists()
    return recorder


def test_pictures_come_back_in_order_and_colour_and_odd_sizes_are_made_even(tmp_path):
    made = recorded(tmp_path / "out.mp4", pictures(), fps=8)
    frames, rate = frames_of(tmp_path / "out.mp4")
    assert len(frames) == made.pictures == 5
    assert rate == pytest.approx(8)
    for frame, picture in zip(frames, pictures(), strict=True):
        assert np.abs(frame[:, :, ::-1].astype(int) - picture).mean() < 12
    recorded(tmp_path / "none.mp4")
    assert [path.name for path in tmp_path.iterdir()] == ["out.mp4"]
    recorded(tmp_path / "odd.mp4", pictures(size=(121, 161)))
    assert frames_of(tmp_path / "odd.mp4")[0][0].shape == (122, 162, 3)


def test_an_interrupted_recording_leaves_nothing_and_spares_the_older_one(tmp_path):
    (tmp_path / "out.mp4").write_text("older")

    def interrupted():
        with Recorder(tmp_path / "out.mp4") as recorder:
            for picture in pictures():
                recorder.write(picture)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert (tmp_path / "out.mp4").read_text() == "older"
    assert [path.name for path in tmp_path.iterdir()] == ["out.mp4"]


@pytest.mark.parametrize(
    ("name", "message"),
    [("out.avi", r"out\.avi must end in \.mp4"), ("no/out.mp4", "no does not exist"), ("folder.mp4", "it is a folder")],
)
def test_what_cannot_be_written_is_said_before_the_first_picture(tmp_path, name, message):
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(ValueError, match=message):
        Recorder(tmp_path / name)


def test_a_folder_without_permission_is_named(tmp_path, monkeypatch):
    def refuse(self, *_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.touch", refuse)
    with pytest.raises(ValueError, match=r"out\.mp4 cannot be written \(Permission denied\): choose another"):
        Recorder(tmp_path / "out.mp4")


def test_a_missing_encoder_is_named(tmp_path, monkeypatch):
    class Closed:
        def __init__(self, *_):
            pass

        fourcc = staticmethod(lambda *_: 0)

        def isOpened(self):
            return False

    monkeypatch.setattr(cv2, "VideoWriter", Closed)
    with pytest.raises(ValueError, match="this OpenCV has no mp4v encoder"):
        Recorder(tmp_path / "out.mp4")
    assert not any(tmp_path.iterdir())


def test_wrong_pictures_are_refused(tmp_path):
    with pytest.raises(ValueError, match="fps must be a finite number > 0"):
        Recorder(tmp_path / "out.mp4", fps=0)
    with Recorder(tmp_path / "out.mp4") as recorder:
        with pytest.raises(
            ValueError, match=r"picture must be uint8 of shape \(H, W, 3\), got uint8 of shape \(5, 5\)"
        ):
            recorder.write(np.zeros((5, 5), dtype=np.uint8))
        recorder.write(np.zeros((120, 160, 3), dtype=np.uint8))
        with pytest.raises(ValueError, match="picture must be 160x120 as the first one, got 100x120"):
            recorder.write(np.zeros((120, 100, 3), dtype=np.uint8))
    with pytest.raises(ValueError, match="is closed"):
        recorder.write(np.zeros((120, 160, 3), dtype=np.uint8))
    recorder.close()
