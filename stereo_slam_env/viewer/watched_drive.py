"""A drive to watch: a filter over a recording, or over that of a finished run, and the video file it becomes.

A run keeps recordings and poses, not maps; filters are deterministic, so they are run again.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from filters.catalogue.registry import FilterFactory, label_of
from filters.contract.validation import positive
from filters.geometry.camera import StereoCamera
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice
from stereo_slam_env.benchmark.scenarios.streams import make_sequence, without_measurements
from stereo_slam_env.benchmark.storage.run_files import load_run
from stereo_slam_env.benchmark.storage.store import RunDirectory, read_study
from stereo_slam_env.files.folders import unfinished_name
from stereo_slam_env.files.opening import checked_file
from stereo_slam_env.frontend.track_recorder import ActiveSearch
from stereo_slam_env.loop import Moment, Observe, run
from stereo_slam_env.recording.archive import load_recording
from stereo_slam_env.recording.recording import LandmarkTruth, Recording
from stereo_slam_env.rendering.overlay import even_sides
from stereo_slam_env.rendering.pinhole import Image


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive to watch: the filter runs as its moments are asked for."""

    title: str
    """One line."""
    label: str
    """The filter's name in legends."""
    camera: StereoCamera
    """The rig."""
    frames: int
    """Number of moments."""
    moments: Callable[[], Iterator[Moment]]
    """Runs the filter from the start, yields a `Moment` a frame; they may be kept."""
    landmarks: LandmarkTruth | None = None
    """The true map."""

    @classmethod
    def of(
        cls,
        recording: Recording,
        slam: str | FilterFactory,
        *,
        label: str | None = None,
        title: str | None = None,
        **settings: Any,
    ) -> Drive:
        """A filter's drive over a recording.

        Parameters
        ----------
        recording : Recording
            The stream.
        slam : str or callable
            As of `stereo_slam_env.run`.
        label, title : str, optional
            None: the name of the filter; that and the name of the recording.
        **settings
            The other arguments of `stereo_slam_env.run`.

        Raises
        ------
        ValueError
            See `stereo_slam_env.run`.
        """
        run(slam, recording, **settings)  # impossible settings are refused now
        label = label or label_of(slam)

        def moments() -> Iterator[Moment]:
            return (moment.hold() for moment in run(slam, recording, **settings))

        title = title or f"{label} on {recording.name}"
        return cls(title, label, recording.camera, len(recording), moments, recording.landmarks)


def revisit(directory: Path, filter_name: str | None = None, seed: int | None = None) -> Drive:
    """The drive of one filter in a run.

    Parameters
    ----------
    directory : Path
        Of a run, or of a cell of a grid.
    filter_name : str, optional
        Its label in the report; None takes the first.
    seed : int, optional
        Which recording; None takes the first.

    Raises
    ------
    ValueError
        No run there, a grid of several, no such filter or seed, or a trial that is not finished or whose recording is
        missing: one line.
    """
    cell = _only_cell(directory)
    choice = _chosen(cell, filter_name)
    which = cell.seeds[0] if seed is None else seed
    if which not in cell.seeds:
        seeds_words = "none, it is one real recording" if cell.seeds == (None,) else ", ".join(map(str, cell.seeds))
        raise ValueError(f"seed must be one of the run's ({seeds_words}), got {seed}")
    scenario = cell.scenario
    path = cell.trial_path(which, choice)
    if not path.exists():
        raise ValueError(f"{path} is missing: the run is not finished, run the same command again")
    done = load_run(path).run
    recording = load_recording(cell.recording_path(which, choice))
    failed = ""
    if done.failure is not None:
        frames = int(np.isfinite(done.positions).all(axis=1).sum())
        if frames == 0:
            raise ValueError(f"{done.filter_name} has nothing to show, it failed in {done.failure}")
        recording = dataclasses.replace(recording, frames=recording.frames[:frames])
        failed = f", until it failed in {done.failure}"
    observe: Observe | None = None
    if scenario.search == "forecast":
        observe = ActiveSearch(*make_sequence(scenario, which)).observe
        recording = without_measurements(recording)

    about = "" if which is None else f", seed {which}"
    return Drive.of(
        recording,
        choice.name,
        label=choice.label,
        title=f"{choice.label}: {scenario.name}{about}{failed}",
        noise=scenario.assumed_noise(recording.noise),
        use_odometry=scenario.use_odometry,
        observe=observe,
        **done.options,
    )


def _only_cell(directory: Path) -> RunDirectory:
    cells = read_study(directory).cells
    if len(cells) > 1:
        places = ", ".join(str(run.out) for run in cells[:3])
        raise ValueError(f"{directory} holds a grid of {len(cells)} cells: give one of them, such as {places}")
    return cells[0]


def _chosen(run: RunDirectory, name: str | None) -> FilterChoice:
    competitors = run.scenario.competitors
    for choice in competitors:
        if name in (None, choice.label):
            return choice
    raise ValueError(f"filter must be one of {', '.join(c.label for c in competitors)}, got {name!r}")


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
