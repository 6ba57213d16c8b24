"""Writer of pictures to a video file."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np

from filters.contract.validation import positive
from stereo_slam_env.files.folders import unfinished_name
from stereo_slam_env.files.paths import checked_file
from stereo_slam_env.rendering.drawing import even_sides
from stereo_slam_env.rendering.images import Image

_CODEC = "mp4v"


class Recorder:
    """Writes pictures to an mp4 file; use it as a context manager.

    The file appears under its name when it is complete. Where the `with` block is left by an exception, or without a
    picture, there is none.

    Parameters
    ----------
    path : str or Path
        Ends in `.mp4`; a file of that name is replaced.
    fps : float
        Pictures a second.

    Raises
    ------
    ValueError
        Another ending, no such folder, a folder that cannot be written to, fps that is not positive, or an OpenCV that
        cannot encode mp4: known at once, before the first picture.
    """

    def __init__(self, path: str | Path, fps: float = 10.0) -> None:
        self.path, self._fps = checked_file("video file", path, ".mp4"), positive("fps", fps)
        self._partial = Path(f"{unfinished_name(self.path)}{self.path.suffix}")
        self._writer: cv2.VideoWriter | None = None
        self._size: tuple[int, int] | None = None
        self.pictures = 0
        try:
            self._partial.touch()
        except OSError as error:
            raise ValueError(f"video file {self.path} cannot be written ({error.strerror}): choose another") from error
        try:
            self._open((64, 64)).release()
        finally:
            self._partial.unlink(missing_ok=True)

    def write(self, picture: Image) -> None:
        """Add a picture.

        Parameters
        ----------
        picture : (H, W, 3) uint8
            RGB, all of one size. An odd width or height is made even by repeating the last column or row.

        Raises
        ------
        ValueError
            It is not of that form, has another size than the first one, or the recorder is closed.
        """
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
            raise ValueError(f"picture must be uint8 of shape (H, W, 3), got {picture.dtype} of shape {picture.shape}")
        height, width = picture.shape[:2]
        if self._size is None:
            self._size = width, height
            self._writer = self._open((width + width % 2, height + height % 2))
        if (width, height) != self._size:
            raise ValueError(f"picture must be {self._size[0]}x{self._size[1]} as the first one, got {width}x{height}")
        if self._writer is None:
            raise ValueError(f"the recorder of {self.path} is closed: make another one")
        self._writer.write(cv2.cvtColor(even_sides(picture), cv2.COLOR_RGB2BGR))
        self.pictures += 1

    def close(self) -> None:
        """Complete the file and give it its name; may be called twice."""
        if self._writer is not None:
            self._release()
            os.replace(self._partial, self.path)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        self._release()
        self._partial.unlink(missing_ok=True)

    def _open(self, size: tuple[int, int]) -> cv2.VideoWriter:
        writer = cv2.VideoWriter(str(self._partial), cv2.VideoWriter.fourcc(*_CODEC), self._fps, size)
        if not writer.isOpened():
            raise ValueError(
                f"video file {self.path} cannot be written: this OpenCV has no {_CODEC} encoder for mp4, "
                "install opencv-python-headless from the package index"
            )
        return writer

    def _release(self) -> None:
        if self._writer is not None:
            self._writer.release()
            self._writer = None
